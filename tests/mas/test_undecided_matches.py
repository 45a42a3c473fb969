"""Where nothing decides between matches, the elected agent of an optimisation says so."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest
from factory import town

from maslam.backend.geometry import Array, Sim3, se3_exp, se3_inverse
from maslam.mas.contracts.effects import Event
from maslam.mas.evaluation.ground_truth import GroundTruthEvaluator
from maslam.mas.evaluation.summarise import FinishedRun, summarise
from maslam.mas.optimisation.undecided import UndecidedMatches
from maslam.mas.place_recognition.comparison import match_end
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.simulation import Environment, make_agents, make_transport
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.place_match import Match
from maslam.tools.report.summary_table import table
from maslam.tools.report.undecided_warnings import undecided_sections, undecided_warnings

ELSEWHERE = se3_exp([9.0, 0.0, 5.0, 0.0, 0.7, 0.0])
INFORMATION = np.diag([1 / 0.02**2] * 3 + [1 / 0.002**2] * 3)


def optimised(wrong: int, right: int = 5, solver: dict[str, object] | None = None) -> SimpleNamespace:
    """Three agents, 0 and 1 joined by ``right`` matches, 1 and 2 by as many and by ``wrong`` others, all of which agree
    that agent 2 stands elsewhere, after one optimisation that agent 1 has called for."""
    config = preset("maslam")
    chosen = {"robust": "gnc", "length_sigma": 0.0, **(solver or {})}
    made = config.optimisation.solver.model_copy(update=chosen)
    optimisation = config.optimisation.model_copy(update={"solver": made})
    config = config.model_copy(update={"optimisation": optimisation})
    manifest, sequences = town(3, 14, spacing_m=6.0, drifting=0.0)
    agents = make_agents(manifest, sequences, config)
    truth = [s.groundtruth.poses[::3] for s in sequences if s.groundtruth is not None]
    keyframes = [keyframes_of(s) for s in sequences]
    for agent, seen in zip(agents, keyframes, strict=True):
        for keyframe in seen:
            agent.observe(keyframe)
    rng = np.random.default_rng(0)

    def join(query: tuple[int, int], match: tuple[int, int], move: Array) -> MatchId:
        """Both agents have it."""
        (a, i), (b, j) = query, match
        noise = se3_exp(np.array([0.02] * 3 + [0.002] * 3) * rng.normal(size=6))
        T_M_Q = Sim3.from_se3(se3_inverse(truth[b][j]) @ move @ truth[a][i] @ noise)
        ends = match_end(agents[a].state, keyframes[a][i]), match_end(agents[b].state, keyframes[b][j])
        found = Match.of(MatchId(a, i, b, j), *ends, T_M_Q, INFORMATION, 50, keyframes[b][j].depth)
        for agent in (agents[a], agents[b]):
            agent.state.verified[found.id] = found
            agent.state.accepted = {*agent.state.accepted, found.id}
            agent.state.join((0, 1, 2))
        return found.id

    for k in range(right):
        join((0, k), (1, k), np.eye(4))
    true = {join((2, 2 * k), (1, 2 * k), np.eye(4)) for k in range(right)}
    false = {join((2, 2 * k + 1), (1, 2 * k), ELSEWHERE) for k in range(wrong)}
    environment = Environment(agents, [[], [], []], make_transport(config, lambda sent: None), config)
    environment._act_on(agents[1].optimisation.start([0, 1, 2]), agents[1])
    environment._deliver()
    assert [e.fields["matches"] for e in environment.events if e.kind == "optimised"] == [2 * right + wrong]
    run = FinishedRun(agents, sequences, config, environment.transport, environment.events, 1)
    summary = summarise(run, GroundTruthEvaluator(sequences), {})
    left = [a.optimisation.running.undecided for a in agents]
    return SimpleNamespace(true=true, false=false, left=left, events=environment.events, summary=summary)


def said(events: list[Event]) -> list[dict[str, object]]:
    return [e.fields for e in events if e.kind == "undecided"]


def test_as_many_matches_on_either_side_are_said() -> None:
    """By the agent that was elected, in the events, the summary, on the console and in the report."""
    found = optimised(wrong=5)
    (one,) = (u for left in found.left for u in left)
    assert isinstance(one, UndecidedMatches) and one.agents == (2,)
    assert {frozenset(one.kept), frozenset(one.rejected)} == {frozenset(found.true), frozenset(found.false)}
    names = {"agents": [2], "kept": [str(m) for m in one.kept], "rejected": [str(m) for m in one.rejected]}
    assert said(found.events) == [names]
    summary = json.loads(found.summary.model_dump_json())
    assert summary["optimisations"]["undecided"] == [names]
    line = f"undecided where agent_02 stands: 5 matches ({names['kept'][0]}, …) kept, 5 matches"
    assert line in table(summary, {"wall_s": 1.0, "realtime_factor": 1.0})
    (section,) = undecided_sections(summary)
    assert line in section.body


@pytest.mark.parametrize("wrong", [0, 2])
def test_what_more_matches_decide_is_not_said(wrong: int) -> None:
    found = optimised(wrong)
    assert not any(found.left) and not said(found.events) and not found.summary.optimisations.undecided
    assert undecided_warnings(json.loads(found.summary.model_dump_json())) == []


def test_many_ways_are_counted() -> None:
    one = {"agents": [1, 2], "kept": ["2:1 - 0:1"], "rejected": ["2:1 - 0:2"]}
    lines = undecided_warnings({"optimisations": {"undecided": [one] * 7}})
    assert lines[0] == (
        "warning: undecided where agent_01 agent_02 stand: 1 match (2:1 - 0:1) kept, 1 match (2:1 - 0:2) rejected; "
        "wrong ones may have been kept"
    )
    assert lines[-1] == "warning: undecided in 2 more ways: optimisations.undecided in summary.json"
    assert undecided_warnings({}) == []
