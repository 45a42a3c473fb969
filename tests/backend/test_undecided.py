"""What a selection does not decide is said, and a smaller group does not stay where a larger one would hold."""

import numpy as np
import pytest

from maslam.backend.config import RobustConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.geometry import se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.g2o import write_g2o
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from maslam.backend.robust import select
from maslam.backend.robust.select import optimise_robustly
from maslam.backend.robust.undecided import undecided_edges
from maslam.tools import cli
from maslam.tools.pgo.undecided import undecided_lines, undecided_records

SIGMA = np.array([0.02] * 3 + [0.002] * 3)
ELSEWHERE = se3_exp([12.0, -7.0, 0.0, 0.0, 0.0, 0.8])


def team(right, wrong=(), poses=12, seed=0):
    """Robots on parallel streets; ``right`` ``(a, b, count)`` matches, and ``wrong`` ones that agree that robot b
    stands elsewhere. The graph; and a mask of its wrong edges."""
    rng = np.random.default_rng(seed)
    robots = range(1 + max(max(a, b) for a, b, _ in right))
    truth = {
        NodeId(r, k): se3(so3_exp([0, 0, 0.05 * k]), [float(k), 5.0 * r, 0.1 * k * r])
        for r in robots
        for k in range(poses)
    }

    def edge(i, j, move, kind):
        T = se3_inverse(truth[i]) @ move @ truth[j] @ se3_exp(SIGMA * rng.normal(size=6))
        return Edge(i, j, T, np.diag(SIGMA**-2.0), kind)

    edges = [
        edge(NodeId(r, k - 1), NodeId(r, k), np.eye(4), EdgeKind.ODOMETRY) for r in robots for k in range(1, poses)
    ]
    odometry = len(edges)
    for which, move, shift in ((right, np.eye(4), 0), (wrong, ELSEWHERE, 1)):
        for a, b, count in which:
            ends = ((NodeId(a, (k + shift) % poses), NodeId(b, k)) for k in range(count))
            edges += [edge(i, j, move, EdgeKind.SEPARATOR) for i, j in ends]
    bad = np.arange(len(edges)) >= odometry + sum(count for *_, count in right)
    start = {n: truth[NodeId(n.robot, 0)] for n in truth}
    return PoseGraph(start, tuple(edges)), bad


@pytest.mark.parametrize("method", ["gnc", "pcm+gnc", "pcm"])
def test_as_many_edges_on_either_side_are_said(method):
    graph, wrong = team([(0, 1, 4), (1, 2, 6)], [(1, 2, 6)])
    found = optimise_robustly(graph, method)
    (one,) = found.undecided
    assert one.robots == (2,)
    assert len(one.kept) == len(one.rejected) == 6
    assert len(set(wrong[list(one.kept)])) == len(set(wrong[list(one.rejected)])) == 1
    assert set(one.kept) | set(one.rejected) >= set(np.flatnonzero(wrong).tolist())


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ([(0, 1, 6)], [(0, 1, 3)]),
        # As many between the two, but the third robot has as many again.
        ([(0, 1, 4), (1, 2, 4), (0, 2, 4)], [(0, 1, 4)]),
    ],
)
def test_what_more_edges_decide_is_not_said(right, wrong):
    graph, bad = team(right, wrong)
    found = optimise_robustly(graph, "gnc")
    np.testing.assert_array_equal(found.weights > 0.5, ~bad)
    assert found.undecided == ()


def test_two_robots_against_one_edge_each_are_undecided_together():
    # The ends of a chain: its middle may be moved with either end.
    graph, wrong = team([(0, 1, 5), (1, 2, 2), (2, 3, 5)], [(1, 2, 2)])
    found = optimise_robustly(graph, "gnc")
    (one,) = found.undecided
    assert one.robots == (0, 1)
    assert set(one.kept) | set(one.rejected) >= set(np.flatnonzero(wrong).tolist())


def test_edges_that_join_nothing_to_nothing_break_nothing():
    graph, _ = team([(0, 1, 3)])
    none = graph.with_weights(np.array([float(e.kind is EdgeKind.ODOMETRY) for e in graph.edges]))
    assert undecided_edges(none, RobustConfig()) == ()
    assert undecided_edges(graph, RobustConfig()) == ()


def test_a_smaller_group_does_not_stay_where_a_larger_one_would_hold(monkeypatch):
    graph, wrong = team([(0, 1, 4), (1, 2, 5)], [(1, 2, 2)])
    across = np.array([e.is_separator for e in graph.edges])

    def misled(whole, consistent, noise, config):
        between_two = np.array([{e.i.robot, e.j.robot} == {1, 2} for e in whole.edges])
        return across, ~between_two | wrong

    monkeypatch.setattr(select, "voted_edges", misled)
    found = optimise_robustly(graph, "gnc")
    np.testing.assert_array_equal(found.weights > 0.5, ~wrong)
    assert found.undecided == ()


@pytest.mark.parametrize("method", ["elected", "rbcd"])
@pytest.mark.parametrize("wrong", [4, 0], ids=["as many", "none"])
def test_the_result_of_a_group_says_it(method, wrong):
    graph, bad = team([(0, 1, 4)], [(0, 1, wrong)])
    found = optimise_distributed(graph, SolverConfig(method=method, robust="gnc"))
    assert [(len(u.kept), len(u.rejected)) for u in found.undecided] == [(4, 4)] * bool(wrong)
    assert all(set(u.kept) | set(u.rejected) >= set(np.flatnonzero(bad).tolist()) for u in found.undecided)
    # The elected robot, and no other, knows it by itself.
    knows = {(u.kept, u.rejected) for outcome in found.outcomes.values() for u in outcome.undecided}
    ends = [(e.i, e.j) for e in graph.edges]
    said = {(tuple(ends[k] for k in u.kept), tuple(ends[k] for k in u.rejected)) for u in found.undecided}
    assert knows == (said if method == "elected" else set())
    assert optimise_distributed(graph, SolverConfig(method=method)).undecided == ()


@pytest.mark.parametrize("method", ["central", "elected", "rbcd"])
def test_the_command_says_it(tmp_path, capsys, method):
    graph, _ = team([(0, 1, 4)], [(0, 1, 4)])
    write_g2o(tmp_path / "in.g2o", graph)
    words = ["pgo", str(tmp_path / "in.g2o"), str(tmp_path / "out.g2o"), "--method", method, "--robust", "gnc"]
    assert cli.main(words) == 0
    assert "undecided where robot 0 stands: 4 edges" in capsys.readouterr().out


def test_sentences_name_robots_and_edges():
    one = {"robots": ["2"], "kept": ["1:0 - 2:0"], "rejected": [["1:3 - 2:4"], ["0:3 - 2:4", "0:4 - 2:5"]]}
    (line,) = undecided_lines([one])
    assert line == (
        "  undecided where robot 2 stands: 1 edge, 1:0 - 2:0, kept, 2 rejected for 2 other places; "
        "wrong edges may have been kept"
    )
    assert undecided_lines([one] * 7)[-1] == "  undecided in 2 more ways; --json lists them"


def test_records_have_each_other_place_of_the_same_edges():
    graph, _ = team([(0, 1, 3)], [(0, 1, 3)])
    solved = optimise_robustly(graph, "gnc").graph
    (record,) = undecided_records(solved, RobustConfig())
    assert len(record["kept"]) == 3 and [len(r) for r in record["rejected"]] == [3]
