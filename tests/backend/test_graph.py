"""Pose graphs as values: invariants, cutting, rescaling, carrying along."""

import numpy as np
import pytest
from graphs import grid, loops

from maslam.backend.central.costs import cost
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, spread_poses


def test_broken_edges_are_refused_with_their_nodes():
    a, b = NodeId(0, 1), NodeId(2, 3)
    with pytest.raises(BackendError, match="0:1 - 0:1"):
        Edge(a, a, np.eye(4))
    with pytest.raises(BackendError, match=r"0:1 - 2:3.*rigid"):
        Edge(a, b, 2.0 * np.eye(4))
    with pytest.raises(BackendError, match="6x6"):
        Edge(a, b, np.eye(4), np.eye(3))
    with pytest.raises(BackendError, match="scale"):
        Edge(a, b, np.eye(4), scale=-1.0)
    with pytest.raises(BackendError, match="weight"):
        Edge(a, b, np.eye(4), weight=1.5)
    with pytest.raises(BackendError, match="no pose for node 2:3"):
        PoseGraph({a: np.eye(4)}, (Edge(a, b, np.eye(4)),))
    assert Edge(a, b, np.eye(4)).is_separator and not Edge(a, NodeId(0, 9), np.eye(4)).is_separator


def test_poses_spread_along_edges_and_back():
    graph, truth = loops(np.random.default_rng(0), robots=2, length=20, sigma_t=0.0, sigma_deg=0.0)
    first = NodeId(0, 0)
    poses = spread_poses({first: truth[first]}, graph.edges)
    assert set(poses) == set(truth)
    for node in truth:
        np.testing.assert_allclose(poses[node], truth[node], atol=1e-9)
    # The parts of a graph that is not connected each start at the identity.
    lonely = Edge(NodeId(7, 0), NodeId(7, 1), np.eye(4))
    assert np.array_equal(spread_poses(poses, [*graph.edges, lonely])[NodeId(7, 0)], np.eye(4))
    assert spread_poses({}, []) == {}


def test_rescaling_takes_units_out():
    rng = np.random.default_rng(2)
    graph, truth = grid(rng)
    units = {0: 1.0, 1: 2.5, 2: 0.4, 3: 1.0}
    # The same world, measured by robots with units of their own.
    edges = []
    for e in graph.edges:
        T = e.T_i_j.copy()
        T[:3, 3] /= units[e.i.robot]
        edges.append(Edge(e.i, e.j, T, e.information, e.kind, units[e.j.robot] / units[e.i.robot]))
    poses = {n: T.copy() for n, T in truth.items()}
    for n, T in poses.items():
        T[:3, 3] /= units[n.robot]
    back = PoseGraph(poses, tuple(edges)).rescaled(units)
    for n in truth:
        np.testing.assert_allclose(back.poses[n], truth[n], atol=1e-12)
    for e, original in zip(back.edges, graph.edges, strict=True):
        np.testing.assert_allclose(e.T_i_j, original.T_i_j, atol=1e-12)
        assert e.scale == pytest.approx(1.0)


def test_cost_does_not_depend_on_units():
    rng = np.random.default_rng(3)
    graph, _ = loops(rng, robots=1, length=10)
    assert cost(graph.rescaled({0: 3.0}), "E") == pytest.approx(cost(graph, "E"))
    moved = graph.with_poses({n: T @ se3_exp(0.01 * rng.normal(size=6)) for n, T in graph.poses.items()})
    assert cost(moved.rescaled({0: 3.0}), "E") == pytest.approx(cost(moved, "E"), rel=1e-9)
    assert cost(moved.rescaled({0: 3.0}), "F") == pytest.approx(cost(moved, "F"), rel=1e-9)


def test_a_graph_is_cut_into_consecutive_parts():
    rng = np.random.default_rng(4)
    graph, _ = loops(rng, robots=1, length=11)
    parts = graph.partitioned(3)
    assert [sum(n.robot == r for n in parts.poses) for r in parts.robots] == [4, 4, 3]
    assert sum(e.is_separator for e in parts.edges) == 2
    assert all(e.is_separator == (e.kind is EdgeKind.SEPARATOR) for e in parts.edges)
    own = parts.of_robot(1)
    assert {n.robot for n in own.poses} == {0, 1, 2} and len(own.edges) == 5
    with pytest.raises(BackendError, match="cannot cut"):
        graph.partitioned(12)


@pytest.mark.parametrize(("poses", "robots"), [(36, 8), (36, 25), (36, 36)])
def test_a_graph_is_cut_into_as_many_parts_as_asked_for(poses, robots):
    """Also where parts of one length would leave none for the last ones."""
    graph, _ = loops(np.random.default_rng(0), robots=1, length=poses)
    counts = np.bincount([n.robot for n in graph.partitioned(robots).nodes])
    assert len(counts) == robots and counts.sum() == poses and counts.min() >= 1
