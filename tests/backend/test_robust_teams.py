"""Selection between robots where wrong matches agree with each other, centrally and by messages alike."""

import numpy as np
import pytest
from graphs import with_look_alikes

from maslam.backend.config import CentralConfig, RobustConfig, SolverConfig
from maslam.backend.distributed.elected_messages import ElectedMessage, Kind
from maslam.backend.distributed.elected_selection import SelectingNode
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.local import LocalProblem
from maslam.backend.distributed.selection import Selection
from maslam.backend.distributed.share import shares
from maslam.backend.distributed.vote import elected_places
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from maslam.backend.robust.chi_square import below
from maslam.backend.robust.meetings import Ends, Meeting, PieceEdges, loop_distances
from maslam.backend.robust.pcm import bytes_of_cycles
from maslam.backend.robust.placement import placed_pieces
from maslam.backend.robust.select import optimise_robustly
from maslam.tools.pgo.city import city

LIMIT = below(0.999, 6)


def team(seed, share, agreeing=0.5, robots=5, poses=100):
    """A city's graph with wrong matches; masks of its wrong edges and of all that are judged."""
    graph, truth = city(robots, poses, seed)
    spoiled, wrong = with_look_alikes(graph, truth, np.random.default_rng(seed), share, agreeing)
    edges = spoiled.edges
    return (
        spoiled,
        np.array([(e.i, e.j) in wrong for e in edges]),
        np.array([e.kind is not EdgeKind.ODOMETRY for e in edges]),
    )


def kept_by(graph, way):
    """Mask of the edges that a method keeps."""
    if way in ("gnc", "pcm+gnc"):
        return optimise_robustly(graph, way).weights > 0.5
    result = optimise_distributed(graph, SolverConfig(method=way, robust="gnc", gnc_confidence=0.999))
    assert all(o.accepted for o in result.outcomes.values())
    return np.array([v is None or not v.rejected for v in result.judged])


@pytest.mark.parametrize(
    ("way", "seed", "share", "agreeing"),
    [
        ("gnc", 1, 0.3, 0.5),
        ("gnc", 2, 0.5, 0.5),
        ("pcm+gnc", 0, 0.7, 0.5),
        ("elected", 2, 0.5, 0.5),
        ("elected", 0, 0.7, 0.5),
        ("rbcd", 1, 0.3, 0.5),
        ("rbcd", 0, 0.7, 0.5),
    ],
)
def test_no_wrong_match_is_kept_and_no_right_one_lost(way, seed, share, agreeing):
    graph, wrong, judged = team(seed, share, agreeing)
    assert wrong.sum() == pytest.approx(share * sum(e.is_separator for e in graph.edges), abs=1)
    kept = kept_by(graph, way)
    assert not (kept & wrong).any() and (~kept & judged & ~wrong).sum() <= 0.01 * (judged & ~wrong).sum()


def meeting(first, second, T, support):
    return Meeting(first, second, T, T[:3, 3] / 2, 1e-4, 1e-2, support)


def test_a_larger_wrong_group_between_two_pieces_loses_against_cycles_over_a_third():
    rng = np.random.default_rng(0)
    stands = [np.eye(4), *(se3(so3_exp(rng.normal(size=3)), rng.uniform(-20, 20, 3)) for _ in range(3))]
    between = [(a, b, se3_inverse(stands[a]) @ stands[b]) for a in range(4) for b in range(a + 1, 4)]
    meetings = [meeting(a, b, T, 5) for a, b, T in between]
    # Three of six pairs have a wrong group with more edges than the right one.
    for k in (0, 3, 5):
        a, b, T = between[k]
        meetings.append(meeting(a, b, T @ se3_exp([7.0, -5.0, 3.0, 0.3, 0.4, 0.5]), 8))
    for order in (range(9), reversed(range(9))):
        places = placed_pieces([meetings[k] for k in order], 0, LIMIT)
        assert sorted(places) == [0, 1, 2, 3]
        for piece, T in places.items():
            np.testing.assert_allclose(T, stands[piece], atol=1e-6)


def test_what_no_meeting_joins_to_the_anchor_has_no_place():
    T = se3_exp([1.0, 2.0, 3.0, 0.0, 0.0, 0.1])
    assert list(placed_pieces([meeting(3, 4, T, 2)], 0, LIMIT)) == [0]
    assert sorted(placed_pieces([meeting(3, 4, T, 2), meeting(1, 0, T, 1)], 0, LIMIT)) == [0, 1]


def test_edges_that_agree_up_to_drift_make_one_meeting():
    rng = np.random.default_rng(1)
    n, stands = 8, se3(so3_exp([0.1, 0.2, 1.0]), [10.0, 3.0, 1.0])
    here, there = (se3(np.tile(np.eye(3), (n, 1, 1)), np.arange(n)[:, None] * np.eye(3)[0]) for _ in range(2))
    noise = se3_exp(0.02 * rng.normal(size=(n, 6)))
    measured = se3_inverse(here) @ stands @ there @ noise
    measured[5:] = se3_inverse(here[5:]) @ se3_exp([4.0, 0, 0, 0, 0, 0.5]) @ stands @ there[5:]
    variances = np.full((n, 2), 0.02**2)
    still = np.zeros((n, 2))
    found = PieceEdges(0, 1, Ends(here, still), Ends(there, still), measured, variances).meetings(LIMIT)
    assert [m.support for m in found] == [5, 3]
    assert np.linalg.norm((found[0].T_first_second - stands)[:3, 3]) < 0.3
    # With a tenth of a radian's drift between the ends, all of them may be one.
    drifting = np.stack([np.linspace(0, 1.0, n), np.linspace(0, 100.0, n)], axis=1)
    loose = PieceEdges(0, 1, Ends(here, drifting), Ends(there, drifting), measured, variances).meetings(LIMIT)
    assert max(m.support for m in loose) > 5


def test_a_loop_is_far_from_closing_by_its_noise_and_the_way_round():
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 0, 3] = np.arange(5.0)
    drift = np.stack([0.01 * np.arange(5.0), 0.04 * np.arange(5.0)], axis=1)
    off = se3(np.eye(3), [1.0, 0.0, 0.0])[None]
    ends, variances = np.array([[1, 4]]), np.array([[0.0, 0.09]])
    # From node 1 to 4: 0.09 of the edge, 0.12 of steps, and turns of 0.03 over a mean square of (9 + 4 + 1) / 3.
    expected = 1.0 / (0.09 + 0.12 + 0.03 * 14 / 3)
    measured = se3_inverse(poses[1]) @ poses[4] @ off
    assert loop_distances(poses, drift, ends, measured, variances)[0] == pytest.approx(expected, rel=1e-9)


def line(wrong_by=0.0, spread=()):
    """Two robots on a line, a metre a step, with a match at each of three poses; of one the measurement is off."""
    edges = [Edge(NodeId(r, k), NodeId(r, k + 1), se3_exp([1.0, 0, 0, 0, 0, 0])) for r in range(2) for k in range(2)]
    for k in range(3):
        T = se3_exp([0, 2.0 + (wrong_by if k == 1 else 0.0), 0, 0, 0, 0])
        edges.append(Edge(NodeId(0, k), NodeId(1, k), T, np.eye(6), EdgeKind.SEPARATOR))
    poses = {NodeId(r, k): se3_exp([float(k), 2.0 * r, 0, 0, 0, 0]) for r in range(2) for k in range(3)}
    return PoseGraph(poses, tuple(edges))


@pytest.mark.parametrize(
    ("off", "before", "after"), [(4.6, 0.0, 1.0), (4.9, 0.0, 0.0), (4.9, 1.0, 1.0), (6.6, 1.0, 0.0)]
)
def test_the_last_look_lets_back_what_is_within_the_bound_and_drops_what_is_beyond_the_worst_of_many(
    off, before, after
):
    # Chi-square of six degrees: 22.46 at 0.999, 40.1 where one of a thousand times a thousand goes; squares of
    # 4.74 and 6.3 standard deviations.
    problem = LocalProblem(shares(line(off))[0])
    problem.places.poses[3:] = [se3_exp([float(k), 2.0, 0, 0, 0, 0]) for k in range(3)]
    selection = Selection(problem, 0.999, 1.0)
    row = next(k for k, e in enumerate(problem.share.edges) if (e.i, e.j) == (NodeId(0, 1), NodeId(1, 1)))
    candidates = np.ones(len(problem.share.edges), dtype=bool)
    candidates[row] = before > 0.5
    selection.begin_with(candidates)
    assert selection.weights[row] == before
    changed = selection.look_again()
    assert selection.weights[row] == after and changed == float(before != after)
    assert np.delete(selection.weights, row).all()


def test_a_vote_needs_one_anchor():
    nobody = [0.0, 0.0, 1.0, 0.0, *[0.0] * 6, *[0.0] * 3, 1.0, 1.0, 3.0]
    with pytest.raises(BackendError, match="0 robots say that they are the anchor"):
        elected_places(nobody, LIMIT)
    with pytest.raises(BackendError, match="15 numbers of a vote"):
        elected_places(nobody[:-1], LIMIT)


def test_verdicts_on_fewer_edges_than_a_member_has_are_an_error():
    group = shares(line())
    node = SelectingNode(group[0], SolverConfig(method="elected", robust="gnc"))
    node.start()
    node.handle(ElectedMessage(Kind.SIZE, 0, 1, 0, (1 << 20).to_bytes(4, "little")))
    with pytest.raises(BackendError, match="verdicts on fewer edges"):
        node.handle(ElectedMessage(Kind.SOLUTION, 0, 1, 0, b"\0" * 8))


def test_an_elected_robot_selects_among_rigid_single_edges_only():
    share = shares(line())[0]
    with pytest.raises(BackendError, match="elected_longest 4"):
        SelectingNode(share, SolverConfig(method="elected", robust="gnc", elected_longest=4))
    with pytest.raises(BackendError, match="units of length"):
        SelectingNode(shares(line(), frozenset({1}))[0], SolverConfig(method="elected", robust="gnc"))


def test_both_owners_are_told_the_same_and_poses_are_those_of_central_selection():
    graph, wrong, _ = team(3, 0.3)
    result = optimise_distributed(graph, SolverConfig(method="elected", robust="gnc"))
    told = {}
    for outcome in result.outcomes.values():
        for j in outcome.judged:
            assert told.setdefault((j.i, j.j), j) == j
    central = optimise_robustly(graph, "pcm+gnc", CentralConfig(), RobustConfig())
    assert not (central.weights[wrong] > 0.5).any()
    to_first = central.graph.poses[NodeId(0, 0)] @ se3_inverse(result.graph.poses[NodeId(0, 0)])
    gaps = [np.linalg.norm((to_first @ result.graph.poses[n] - T)[:3, 3]) for n, T in central.graph.poses.items()]
    assert max(gaps) < 0.01


def test_the_bytes_by_which_two_robots_compare_their_edges():
    # Three ends of 27 numbers, three bits, two headers.
    assert bytes_of_cycles(line()) == 3 * 27 * 4 + 1 + 20
