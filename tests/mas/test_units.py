"""A unit of length for each key-frame: in an agent's state, its graph and a team's plan."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from map_driver import SEEN, drift_apart, seen
from test_matches import bid, random_sim3

from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.geometry import Sim3, se3_exp, se3_inverse
from maslam.backend.pose_graph.graph import NodeId
from maslam.mas.optimisation.planning import plan
from maslam.mas.protocol.ids import FrameId, MatchId
from maslam.mas.protocol.messages import Bid, PieceTerms
from maslam.mas.protocol.tasks import OptimiseTask
from maslam.mas.protocol.tensors import pack_sim3s, unpack_sim3s
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.place_match import Match, MatchEnd
from maslam.mas.state.pose_graph import UnknownPart, adopt, match_edge, odometry_edges, own_graph, share_of, terms

# -- state and graph --------------------------------------------------------------------------------------------------


def test_a_new_key_frame_follows_in_the_unit_of_the_last_one() -> None:
    state, keyframes = seen(6)
    drift_apart(state)
    state.observe(keyframes[6])
    step = se3_inverse(keyframes[5].T_T_C) @ keyframes[6].T_T_C
    expected = state.pose(5) @ Sim3.from_se3(step)
    np.testing.assert_allclose(state.pose(6).matrix(), expected.matrix(), atol=1e-12)
    assert state.units[6] == state.units[5] == 2.0 * np.exp(0.15)


def task_of(state: AgentState, placed: Sim3, frame: FrameId, **changes: object) -> OptimiseTask:
    fields: dict[str, object] = {
        "members": (0, 1),
        "frame": frame,
        "metric": True,
        "tracks": tuple(p.track for p in state.pieces),
        "matches": (),
        "present": (FrameId(0, 0),),
        "placements": pack_sim3s([placed]),
        "arbitrary": (0,),
    }
    return OptimiseTask(**{**fields, **changes})  # type: ignore[arg-type]


def test_a_share_holds_poses_and_units_in_the_tasks_coordinates() -> None:
    state, _ = seen()
    drift_apart(state)
    placed = random_sim3(np.random.default_rng(0), 3.0)
    share = share_of(state, task_of(state, placed, FrameId(1, 0)))
    assert share.arbitrary_scale == {0} and share.anchor == 1
    for k in range(SEEN):
        expected = placed @ state.pose(k)
        found = Sim3(share.poses[NodeId(0, k)][:3, :3], share.poses[NodeId(0, k)][:3, 3], share.units[NodeId(0, k)])
        np.testing.assert_allclose(found.matrix(), expected.matrix(), atol=1e-9)


def test_an_agent_that_knows_the_metre_brings_no_units() -> None:
    state, _ = seen(scale=1.0)
    share = share_of(state, task_of(state, Sim3.identity(), FrameId(0, 0), arbitrary=(1,)))
    assert not share.units and share.arbitrary_scale == {1} and share.anchor == 0
    assert all(e.scale_sigma is None for e in share.edges)
    assert set(state.units) == {1.0}


@pytest.mark.parametrize(("scale", "arbitrary"), [(1.0, (0, 1)), (1.0, (0,)), (0.5, ()), (0.5, (1,))])
def test_a_task_that_takes_an_agent_for_another_kind_is_refused(scale: float, arbitrary: tuple[int, ...]) -> None:
    state, _ = seen(3, scale=scale)
    with pytest.raises(UnknownPart, match="unit"):
        share_of(state, task_of(state, Sim3.identity(), FrameId(0, 0), arbitrary=arbitrary))


def test_what_is_adopted_is_what_was_found_and_later_key_frames_follow() -> None:
    state, keyframes = seen(8)
    task = task_of(state, Sim3.identity(), FrameId(1, 0))
    rng = np.random.default_rng(1)
    poses = {NodeId(0, k): se3_exp(rng.normal(size=6)) for k in range(6)}
    units = {NodeId(0, k): float(rng.uniform(0.5, 2.0)) for k in range(6)}
    before = state.pose(5)
    outcome = SolverOutcome(0, True, "accepted", poses, units, 2.0, 1.0, 0, 1, ())
    adoption = adopt(state, task, outcome)
    assert adoption.before[5].scale == before.scale == 1.0
    for k in range(6):
        assert state.units[k] == units[NodeId(0, k)] and np.array_equal(state.poses[k], poses[NodeId(0, k)])
    for k in (6, 7):
        step = Sim3.from_se3(se3_inverse(keyframes[k - 1].T_T_C) @ keyframes[k].T_T_C)
        np.testing.assert_allclose(state.pose(k).matrix(), (state.pose(k - 1) @ step).matrix(), atol=1e-12)
    assert state.frame == FrameId(1, 0) and state.pieces[0].metric


def test_edges_say_how_far_the_unit_may_have_drifted() -> None:
    state, _ = seen()
    config = state.config.optimisation
    assert {e.scale_sigma for e in odometry_edges(state, 0)} == {config.odometry_sigma_scale}
    end = MatchEnd(0, np.eye(4), 0.0)
    match = Match(MatchId(0, 9, 1, 2), end, end, Sim3(np.eye(3), np.ones(3), 1.3), np.eye(6), 50, 5.0)
    assert match_edge(match, config).scale_sigma is None
    measured = match_edge(replace(match, scale_sigma=0.03), config)
    assert measured.scale == 1.3
    assert measured.scale_sigma == pytest.approx(np.hypot(0.03, config.match_sigma_scale))
    vague = match_edge(replace(match, scale_sigma=float("inf")), config).scale_sigma
    assert vague is not None and 10.0 < vague < np.inf, "a match that says nothing about it"


def test_all_tracks_of_one_camera_are_brought() -> None:
    state, _ = seen(cuts=(12, 24))
    assert [p.track for p in terms(state, 0).pieces] == [0, 1, 2]


def test_the_graph_for_export_is_in_one_unit() -> None:
    """Each odometry edge in the unit of its first key-frame there; the poses as they are."""
    state, _ = seen()
    drift_apart(state)
    graph = own_graph(state)
    for edge, k in zip(graph.edges, range(SEEN - 1), strict=True):
        step = state.odometry_step(state.keyframes[k + 1])
        np.testing.assert_allclose(edge.T_i_j[:3, 3], step[:3, 3] * state.units[k])


def test_an_edge_between_cameras_stands_in_one_graph_only() -> None:
    """Only the agent of its first node knows that node's unit; between metric agents both write the same numbers."""
    state, _ = seen()
    other, end = state.me + 1, MatchEnd(0, np.eye(4), 0.0)
    asked = Match(MatchId(state.me, 3, other, 5), end, end, Sim3(np.eye(3), np.ones(3), 1.3), np.eye(6), 50, 5.0)
    for match, there in (
        (replace(asked, scale_sigma=0.03), 0),
        (asked, 1),
        (replace(asked, scale_sigma=0.03).turned(), 1),
    ):
        state.verified[match.id] = match
        state.accepted = {match.id}
        between = [e for e in own_graph(state).edges if e.i.robot != e.j.robot]
        assert len(between) == there


# -- plans of mixed teams ---------------------------------------------------------------------------------------------


def joined(
    units: dict[int, float], pairs: list[tuple[int, int]], metric: set[int], noise: float = 0.0
) -> dict[int, Bid]:
    """Bids of agents, each in its own frame, whose matches agree up to a scale that is ``noise`` (logarithm) off."""
    rng = np.random.default_rng(5)
    T_W = {a: random_sim3(rng, unit) for a, unit in units.items()}
    rows: dict[int, list[tuple[MatchId, bool, Sim3, Sim3]]] = {a: [] for a in units}
    for m, q in pairs:
        match, pose_m, pose_q = MatchId(q, 4, m, 6), random_sim3(rng, 1.0), random_sim3(rng, 1.0)
        T_M_Q = pose_m.inverse() @ T_W[m].inverse() @ T_W[q] @ pose_q
        T_M_Q = replace(T_M_Q, scale=T_M_Q.scale * float(np.exp(noise)))
        rows[m].append((match, False, pose_m, T_M_Q))
        rows[q].append((match, True, pose_q, T_M_Q))
    return {a: bid(a, rows[a], metric=a in metric) for a in units}


def test_a_team_takes_the_lowest_coordinates_in_metres() -> None:
    units = {0: 0.4, 1: 1.0, 2: 2.0, 3: 1.0}
    found = plan(0, joined(units, [(0, 1), (1, 2), (2, 3)], {1, 3}))
    assert {(t.frame, t.metric, t.arbitrary) for t in found.tasks.values()} == {(FrameId(1, 0), True, (0, 2))}
    scale = {a: unpack_sim3s(t.placements)[0].scale for a, t in found.tasks.items()}
    assert scale == {0: pytest.approx(0.4, rel=1e-5), 1: 1.0, 2: pytest.approx(2.0, rel=1e-5), 3: 1.0}


def test_without_a_metre_the_lowest_coordinates_are_taken() -> None:
    found = plan(2, joined({0: 0.4, 2: 2.0}, [(0, 2)], set()))
    assert {(t.frame, t.metric, t.arbitrary) for t in found.tasks.values()} == {(FrameId(0, 0), False, (0, 2))}


def test_metres_stay_metres_over_a_chain_of_other_units() -> None:
    """Matches' scales are 3 % off each; the match camera stands where the chain says."""
    bids = joined({0: 1.0, 1: 0.4, 2: 1.0}, [(0, 1), (1, 2)], {0, 2}, noise=0.03)
    found = plan(0, bids)
    exact = plan(0, joined({0: 1.0, 1: 0.4, 2: 1.0}, [(0, 1), (1, 2)], {0, 2}))
    noisy, true = (unpack_sim3s(p.tasks[2].placements)[0] for p in (found, exact))
    assert noisy.scale == 1.0
    np.testing.assert_allclose(noisy.rotation, true.rotation, atol=1e-6)
    links = bids[2].links
    assert links is not None
    camera = unpack_sim3s(links.poses)[0].translation
    T_0_1 = unpack_sim3s(found.tasks[1].placements)[0]
    links_1 = bids[1].links
    assert links_1 is not None
    row = [m.query_agent for m in links_1.matches].index(2)
    chained = T_0_1 @ unpack_sim3s(links_1.poses)[row] @ unpack_sim3s(links.transforms)[0]
    np.testing.assert_allclose(noisy @ camera, chained.translation, atol=1e-5)


def test_who_has_met_the_metre_stays_with_it() -> None:
    """Agents 0 and 1 have one camera; 1 stands in the coordinates of agent 3, which takes no part now."""
    bids = joined({0: 0.4, 1: 2.0}, [(0, 1)], set())
    old = bids[1]
    assert old.links is not None
    links = type(old.links)(old.links.matches, old.links.tracks, (FrameId(3, 0),), *(
        getattr(old.links, name) for name in ("query", "poses", "transforms")
    ))  # fmt: skip
    bids[1] = Bid(0, 0, links, (PieceTerms(0, FrameId(3, 0), False, True),))
    found = plan(0, bids)
    assert {(t.frame, t.metric, t.arbitrary) for t in found.tasks.values()} == {(FrameId(3, 0), True, (0, 1))}


# -- what a match knows of its scale ----------------------------------------------------------------------------------


def test_each_part_of_a_match_gets_what_is_left_without_the_other() -> None:
    """Information of the parts is the inverse of their blocks in the covariance."""
    rng = np.random.default_rng(3)
    root = rng.normal(size=(7, 7))
    full = root @ root.T + np.eye(7)
    covariance = np.linalg.inv(full)
    end = MatchEnd(0, np.eye(4), 0.0)
    match = Match.of(MatchId(0, 1, 1, 2), end, end, Sim3.identity(), full, 30, 5.0)
    np.testing.assert_allclose(np.linalg.inv(match.information), covariance[:6, :6], rtol=1e-9)
    assert match.scale_sigma == pytest.approx(np.sqrt(covariance[6, 6]))
    assert Match.of(MatchId(0, 1, 1, 2), end, end, Sim3.identity(), full[:6, :6], 30, 5.0).scale_sigma is None
