"""Agents that are wrong, idle, dishonest, late or gone: what a user would want to come of it."""

from __future__ import annotations

import numpy as np
import pytest
from by_hand import happened
from factory import circuit, make_sequence, make_world, manifest_of, talkative, town
from saboteurs import Idler, Liar, Swindler, live

from maslam.backend.trajectory_error import TrajectoryError
from maslam.mas.agent import Agent
from maslam.mas.config import FaultsConfig, MasConfig
from maslam.mas.contracts.reputation import Trust
from maslam.mas.evaluation.ground_truth import GroundTruthEvaluator, groups_of
from maslam.mas.manifest import Manifest
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import Environment
from maslam.mas.state.trajectories import keyframe_trajectory

CONFIG = talkative()
ODD = 2
HONEST = (0, 1, 3)


def four() -> tuple[Manifest, list[AgentSequence]]:
    return town(4, 30, spacing_m=12.0, drifting=0.03)


def faulty(**faults: object) -> MasConfig:
    return CONFIG.model_copy(update={"faults": FaultsConfig.model_validate(faults)})


def errors(environment: Environment, evaluator: GroundTruthEvaluator) -> list[TrajectoryError]:
    found = [evaluator.error_of(a.state.me, keyframe_trajectory(a.state)) for a in environment.agents]
    return [e for e in found if e is not None]


def regards(agents: list[Agent], of: int) -> list[Trust]:
    return [a.context.reputation.trust(of) for a in agents if a.state.me != of]


def groups_with(environment: Environment, agents: tuple[int, ...]) -> bool:
    return any(set(agents) <= set(group) for group in groups_of(environment.agents))


@pytest.fixture(scope="module")
def undisturbed() -> list[float]:
    """Errors of the honest agents when the odd one is not there."""
    _, sequences = four()
    three = [sequences[a] for a in HONEST]
    return [e.rmse_m for e in errors(*live(manifest_of(three), three, CONFIG))]


def test_one_that_bids_and_never_delivers_is_found_out_and_waited_for_no_more(undisturbed: list[float]) -> None:
    environment, evaluator = live(*four(), CONFIG, {ODD: Idler})
    agents = environment.agents
    assert regards(agents, ODD) == [Trust.UNDELIVERING] * 3
    assert all(regards(agents, a)[-1] is Trust.GOOD for a in HONEST), "nobody else is blamed"
    assert groups_with(environment, HONEST)
    for honest, alone in zip(HONEST, undisturbed, strict=True):
        assert errors(environment, evaluator)[honest].rmse_m <= 1.1 * alone + 0.02
        assert set(agents[honest].maps.copies) >= set(HONEST) - {honest}
        assert not agents[honest].context.ledger.running()


def test_one_that_lies_about_matches_is_found_out_and_its_matches_are_not_used(undisturbed: list[float]) -> None:
    environment, evaluator = live(*four(), CONFIG, {ODD: Liar})
    agents = environment.agents
    liar = agents[ODD]
    assert isinstance(liar, Liar) and liar.lies >= 6
    told = [a for a in HONEST if any(reported_by_liar(m) for m in agents[a].state.verified)]
    assert told and all(agents[a].context.reputation.trust(ODD) is Trust.UNTRUSTED for a in told)
    assert not [m for a in HONEST for m in agents[a].state.accepted if reported_by_liar(m)]
    assert groups_with(environment, HONEST)
    for honest, alone in zip(HONEST, undisturbed, strict=True):
        assert errors(environment, evaluator)[honest].rmse_m <= 1.1 * alone + 0.02


def test_one_whose_lies_agree_is_told_by_the_way_round_over_third_agents(undisturbed: list[float]) -> None:
    """Between two agents its lies look like truth: all of its map claimed 15 m beside where it is."""
    environment, evaluator = live(*four(), CONFIG, {ODD: Swindler})
    agents = environment.agents
    assert isinstance(agents[ODD], Swindler) and agents[ODD].lies >= 6
    accusers = [a for a in HONEST if agents[a].context.reputation.of(ODD).f > 0]
    regards = [agents[b].context.reputation.trust(a) for a in HONEST for b in HONEST if a != b]
    assert accusers and Trust.UNTRUSTED not in regards
    assert groups_with(environment, HONEST)
    connected = evaluator.connected_errors(environment.agents)
    assert max(connected[a].rmse_m for a in HONEST) < 0.6, "15 m would show"


def reported_by_liar(match: MatchId) -> bool:
    return match.match_agent == ODD and match.query_agent != ODD


def test_one_with_a_wrong_map_does_not_spoil_the_others(undisturbed: list[float]) -> None:
    """Its odometry is thirty times worse than it claims: places are recognised, but they do not agree."""
    world = make_world(0)
    ways = [circuit(12.0 * a, 45.0) for a in range(4)]
    sequences = [make_sequence(world, w, 0, a, drifting=0.9 if a == ODD else 0.03) for a, w in enumerate(ways)]
    environment, evaluator = live(manifest_of(sequences), sequences, CONFIG)
    assert groups_with(environment, HONEST)
    for honest, alone in zip(HONEST, undisturbed, strict=True):
        assert errors(environment, evaluator)[honest].rmse_m <= 1.1 * alone + 0.02


def test_one_that_comes_late_is_taken_in() -> None:
    environment, evaluator = live(*four(), faulty(late_s={ODD: 8.0}))
    assert groups_of(environment.agents) == [[0, 1, 2, 3]]
    seen = [e["trust"] for e in happened(environment, "reputation", 0) if e["of"] == ODD]
    assert seen == ["silent", "good"], "missed while it was not there, and welcome when it came"
    assert all(set(a.maps.copies) == {0, 1, 2, 3} - {a.state.me} for a in environment.agents)
    assert max(e.rmse_m for e in evaluator.connected_errors(environment.agents).values()) < 1.0


def test_one_that_leaves_is_noticed_and_what_it_brought_is_kept(undisturbed: list[float]) -> None:
    environment, evaluator = live(*four(), faulty(leave_s={ODD: 6.0}))
    agents = environment.agents
    assert Trust.SILENT in regards(agents, ODD)
    assert groups_with(environment, HONEST)
    assert any(ODD in agents[a].maps.copies for a in HONEST), "its map lives on"
    assert not any(agents[a].context.ledger.running() for a in HONEST)
    for honest, alone in zip(HONEST, undisturbed, strict=True):
        assert errors(environment, evaluator)[honest].rmse_m <= 1.2 * alone + 0.05


@pytest.mark.parametrize("preset_name", ["default", "maslam"])
@pytest.mark.parametrize("loss", [0.1, 0.3])
def test_under_loss_the_group_is_found_all_contracts_end_and_it_costs_a_bounded_amount(
    loss: float, preset_name: str
) -> None:
    config = preset(preset_name).model_copy(update={"faults": FaultsConfig(loss=loss)})
    manifest, sequences = town(3, 24, spacing_m=9.0, drifting=0.03)
    whole, _ = live(manifest, sequences, preset(preset_name))
    environment, evaluator = live(manifest, sequences, config)
    assert groups_of(environment.agents) == [[0, 1, 2]]
    for agent in environment.agents:
        assert not agent.context.ledger.unsettled and not happened(environment, "refused")
        assert all(r is Trust.GOOD for r in regards(environment.agents, agent.state.me)), "losses blame nobody"
    odometry = [evaluator.error_of(a.state.me, odometry_of(a)) for a in environment.agents]
    after = np.mean([e.rmse_m for e in errors(environment, evaluator)])
    assert after < np.mean([e.rmse_m for e in odometry if e is not None])
    useful = sum(c.wire_bytes for c in whole.transport.by_operation.values())
    assert sum(c.wire_bytes for c in environment.transport.by_operation.values()) < 6 * useful


def odometry_of(agent: Agent) -> object:
    from maslam.frontend.files.trajectory import Trajectory

    keyframes = agent.state.keyframes
    return Trajectory(np.array([k.stamp_ns for k in keyframes]), np.array([k.T_T_C for k in keyframes]))
