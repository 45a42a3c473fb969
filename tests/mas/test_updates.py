"""Matches that come after an optimisation, among those whom it solved for: updates instead of new optimisations."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import msgspec
import numpy as np
import pytest
from factory import town
from garbler import Garbler
from saboteurs import Saboteur, Sleeper, live

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig
from maslam.backend.distributed.update_messages import UpdateKind, UpdateMessage
from maslam.backend.distributed.wire import pack, unpack
from maslam.backend.errors import BackendError
from maslam.backend.pose_graph.graph import PoseGraph
from maslam.mas.agent import Agent
from maslam.mas.config import FaultsConfig, MasConfig
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.messages import Message
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.simulation import Environment
from maslam.mas.state.pose_graph import own_graph


def settings(updates: bool = True, period: int = 8, seed: int = 0, **faults: float) -> MasConfig:
    """Without lengths of odometry: where they are found, the optimum is another one, and updates end."""
    config = preset("maslam")
    solver = config.optimisation.solver.model_copy(update={"length_sigma": 0.0})
    changes = {"updates": updates, "period_keyframes": period, "solver": solver}
    optimisation = config.optimisation.model_copy(update=changes)
    changes = {"optimisation": optimisation, "faults": FaultsConfig.model_validate(faults), "seed": seed}
    return MasConfig.model_validate(config.model_copy(update=changes).model_dump())


def lived(config: MasConfig, saboteurs: dict[int, type[Agent]] | None = None) -> SimpleNamespace:
    """A run of three agents: environment, evaluator, and by kind how many solver messages and bytes were sent."""
    manifest, sequences = town(3, 40, spacing_m=6.0, drifting=0.02)
    count: Counter[str] = Counter()

    def listen(message: Message, size: int) -> None:
        if isinstance(message.body, SolverBody):
            count[message.body.kind] += 1
            count["bytes"] += size

    environment, evaluator = live(manifest, sequences, config, saboteurs, listen=listen)
    return SimpleNamespace(environment=environment, evaluator=evaluator, count=count)


@cache
def run_of(updates: bool) -> SimpleNamespace:
    return lived(settings(updates))


def events(environment: Environment, kind: str) -> list[dict[str, object]]:
    return [e.fields for e in environment.events if e.kind == kind]


def above_the_optimum(environment: Environment) -> float:
    """F of what all agents together have, over its minimum by the central solver."""
    graphs = [own_graph(a.state) for a in environment.agents]
    edges = {(e.i, e.j): e for g in graphs for e in g.edges}
    poses = {
        n: T
        for g, a in zip(graphs, environment.agents, strict=True)
        for n, T in g.poses.items()
        if n.robot == a.state.me
    }
    graph = PoseGraph(poses, tuple(edges.values()))
    return cost(graph, "F") / optimise(graph, CentralConfig()).cost_after


def error_m(run: SimpleNamespace) -> float:
    return float(np.mean([run.evaluator.keyframe_error(a).rmse_m for a in run.environment.agents]))


def test_a_match_among_those_who_were_solved_for_is_an_update() -> None:
    on, off = run_of(True), run_of(False)
    assert len(events(on.environment, "optimised")) < len(events(off.environment, "optimised"))
    assert events(on.environment, "updated") and not events(off.environment, "updated")
    assert not any(kind.startswith("SolverUpdate") for kind in off.count)
    assert on.count["SolverUpdateEdges"] and on.count["SolverUpdateCorrection"]
    assert on.count["bytes"] < 0.8 * off.count["bytes"]
    assert above_the_optimum(on.environment) < 1.001
    assert error_m(on) < 1.01 * error_m(off)
    for agent in on.environment.agents:
        assert agent.quiet and not agent._pending(), "nothing is left for an optimisation"


def test_the_answer_comes_within_a_step_of_the_match() -> None:
    """From when both agents have a match to when those whom it matters to are corrected: a tick, and no waiting."""
    environment = run_of(True).environment
    first = min(e.now_ns for e in environment.events if e.kind == "updated")
    matched = [e.now_ns for e in environment.events if e.kind == "match" and e.now_ns >= first]
    updated = {e.now_ns for e in environment.events if e.kind in ("updated", "optimised")}
    step_ns = round(environment.config.step_s * 1e9)
    assert matched
    late = [t for t in matched if not any(t <= u <= t + step_ns for u in updated)]
    assert not late, (late, sorted(updated))


def test_the_same_run_has_the_same_bytes() -> None:
    again = lived(settings())
    assert again.count == run_of(True).count
    for a, b in zip(again.environment.agents, run_of(True).environment.agents, strict=True):
        np.testing.assert_array_equal(np.array(a.state.poses), np.array(b.state.poses))


@pytest.mark.parametrize("faults", [{"loss": 0.3}, {"delay_s": 0.1, "jitter_s": 0.2}], ids=["loss", "delay"])
@pytest.mark.parametrize("seed", range(2))
def test_over_bad_links_all_end_at_the_optimum_too(faults: dict[str, float], seed: int) -> None:
    run = lived(settings(seed=seed, **faults))
    assert all(a.state.group == {0, 1, 2} and a.quiet for a in run.environment.agents)
    assert len({a.state.frame for a in run.environment.agents}) == 1
    assert run.count["SolverUpdateCorrection"]
    assert above_the_optimum(run.environment) < 1.02
    assert error_m(run) < 1.05 * error_m(run_of(True))


class Away(Sleeper):
    """In a black hole for ten seconds."""

    ASLEEP_S = (5.0, 15.0)


@pytest.mark.parametrize("away", range(3))
def test_an_agent_that_is_away_for_ten_seconds_holds_nobody_up(away: int) -> None:
    run = lived(settings(loss=1e-9), {away: Away})
    assert all(a.state.group == {0, 1, 2} and a.quiet for a in run.environment.agents)
    assert len({a.state.frame for a in run.environment.agents}) == 1
    assert error_m(run) < 1.1 * error_m(run_of(True))


@pytest.mark.parametrize("all_of_them", [False, True])
def test_a_match_that_is_not_believed_any_more_counts_no_more(all_of_them: bool) -> None:
    run = lived(settings())
    agents = run.environment.agents
    elected = next(a for a in agents if a.optimisation.running.updates._group.node.leads)
    victim = agents[(elected.state.me + 1) % 3]
    mine = sorted(m for m in victim.optimisation.running.updates.matches if m.match_agent != m.query_agent)
    before, gone = elected.optimisation.running.updates._group.node.optimum, mine if all_of_them else mine[-1:]
    victim.state.accepted -= set(gone)
    for message in victim.optimisation.update().messages:
        run.environment.transport.send(message, run.environment.now_ns)
    run.environment._deliver()
    if all_of_them:
        assert not any(a.optimisation.running.updates.matches for a in agents), "it is to be solved anew, without them"
        assert victim._pending()
    else:
        assert elected.optimisation.running.updates._group.node.optimum < before
        assert all(a.optimisation.running.updates.matches for a in agents)
        assert not victim._pending() & set(gone)


def test_a_message_of_updates_that_nobody_knows_is_answered() -> None:
    """An agent that has no part in a solution says so; answers are not answered."""
    agents = run_of(True).environment.agents
    stray = UpdateMessage(UpdateKind.EDGES, 5, 1, 1, 0, b"\x00")
    first = Message(1, 0, None, SolverBody.of(stray))
    (answer,) = agents[0].handle(first).messages
    assert answer.body.kind == "SolverUpdateLost"
    (received,) = agents[1].handle(answer).messages
    assert received.body.kind == "SolverUpdateReceived"
    assert agents[0].handle(received).messages == ()


def test_messages_come_back_from_their_bytes_and_others_are_refused() -> None:
    for kind in UpdateKind:
        body = b"" if kind in (UpdateKind.RECEIVED, UpdateKind.LOST) else b"\x01\x02\x03"
        message = UpdateMessage(kind, 0xABCD, 3, 7, 9, body)
        assert unpack(7, 9, pack(message)) == message
    with pytest.raises(BackendError, match="with a body of 1 bytes"):
        unpack(0, 1, pack(UpdateMessage(UpdateKind.LOST, 0, 0, 0, 1, b"\x00")))
    with pytest.raises(BackendError, match="not a message of an update"):
        unpack(0, 1, b"\xf9" + bytes(4))


class Forger(Saboteur):
    """One byte of each update that it sends is another."""

    forged = 0

    def spoil(self, messages: list[Message]) -> list[Message]:
        return [self._forged(m) if isinstance(m.body, SolverBody) else m for m in messages]

    def _forged(self, message: Message) -> Message:
        sent = message.body.read(message.sender, message.recipient)
        if not isinstance(sent, UpdateMessage) or len(sent.body) < 3:
            return message
        self.forged += 1
        body = bytearray(sent.body)
        body[np.random.default_rng(self.forged).integers(2, len(body))] ^= 0x15
        return msgspec.structs.replace(message, body=SolverBody.of(replace(sent, body=bytes(body))))


@pytest.mark.parametrize("kind", [Forger, Garbler])
@pytest.mark.parametrize("which", [0, 1])
def test_what_a_member_makes_of_updates_breaks_nobody(kind: type[Agent], which: int) -> None:
    run = lived(settings(period=5), {which: kind})
    others = [a for a in run.environment.agents if a.state.me != which]
    assert all(np.isfinite(np.array(a.state.poses)).all() for a in others)
    for agent in others:
        error = run.evaluator.keyframe_error(agent)
        assert error is None or error.rmse_m < 3.0 * error_m(run_of(False)), "no worse than its own odometry"


def test_poses_that_no_map_may_have_are_not_taken_over() -> None:
    """A correction that moves a whole agent far away costs its own edges nothing."""
    agent = lived(settings()).environment.agents[0]
    updates, before = agent.optimisation.running.updates, np.array(agent.state.poses)
    node = updates._group.node
    far_away = {n: T + 1e12 * np.eye(4, k=3) for n, T in node.poses.items()}
    node._places = replace(node._places, poses=far_away)
    node.revision += 1
    effects = updates._after(updates._group, [])
    assert not effects.changes and [e.fields["reason"] for e in effects.events] == ["the solution is not finite"]
    np.testing.assert_array_equal(np.array(agent.state.poses), before)
