"""F with units of length: the cost, its derivatives, its minimum, and what condensing keeps of it."""

from __future__ import annotations

import numpy as np
import pytest
from graphs import drifting, loops

from maslam.backend.central.linear import edge_costs
from maslam.backend.central.minimum import minimum
from maslam.backend.central.similarity_edges import SimilarityEdges, descend, edges_of, linear_start, moved_by
from maslam.backend.distributed.condense import OwnGraph
from maslam.backend.distributed.share import Share
from maslam.backend.geometry import Sim3, se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph


def some_edges(rng: np.random.Generator, scaled: bool = True) -> tuple[SimilarityEdges, np.ndarray, np.ndarray]:
    ends = np.array([(0, 1), (1, 2), (2, 0), (3, 1), (2, 3)])
    poses = se3_exp(rng.normal(size=(4, 6)))
    measured = se3_inverse(poses[ends[:, 0]]) @ poses[ends[:, 1]] @ se3_exp(0.1 * rng.normal(size=(5, 6)))
    log_units = 0.3 * rng.normal(size=4) if scaled else np.zeros(4)
    log_scale = 0.2 * rng.normal(size=5) if scaled else np.zeros(5)
    weights = rng.uniform(0.5, 5.0, (3, 5))
    return SimilarityEdges(ends, measured, log_scale, *weights), poses, log_units


def test_with_units_of_one_it_is_f_itself() -> None:
    edges, poses, log_units = some_edges(np.random.default_rng(0), scaled=False)
    i, j = edges.ends.T
    expected = edge_costs(poses[i], poses[j], edges.measured, edges.kappa, edges.tau)
    assert np.array_equal(edges.costs(poses, log_units), expected)
    nearly = edges.costs(poses, log_units + 1e-9)
    np.testing.assert_allclose(nearly, expected, rtol=1e-6)


def test_the_cost_does_not_depend_on_the_common_frame_or_unit() -> None:
    rng = np.random.default_rng(1)
    edges, poses, log_units = some_edges(rng)
    S = Sim3(so3_exp(rng.normal(size=3)), rng.normal(size=3), 2.7)
    moved = edges.costs(S.transform_poses(poses), log_units + np.log(2.7))
    np.testing.assert_allclose(moved, edges.costs(poses, log_units), rtol=1e-9)


def test_gradient_is_that_of_differences() -> None:
    """The right-hand side is minus half the gradient where steps begin; what is fixed has none."""
    edges, poses, log_units = some_edges(np.random.default_rng(2))
    fixed = np.array([False, False, True, False])
    hessian, rhs = edges.blocks(poses, log_units, fixed)
    values = np.zeros((4, 7))
    values[:, :3] = poses[:, :3, 3]
    gradient = np.zeros((4, 7))
    for k, (i, j) in enumerate(edges.ends):
        both = hessian[k] @ np.concatenate([values[i], values[j]]) - rhs[k, :, 0]
        gradient[i] += 2.0 * both[:7]
        gradient[j] += 2.0 * both[7:]
    step, rows = 1e-6, np.arange(4)
    for node in range(4):
        for axis in range(7):
            delta = np.zeros((4, 7))
            delta[node, axis] = step
            there = edges.costs(*moved_by(poses, log_units, rows, delta)).sum()
            back = edges.costs(*moved_by(poses, log_units, rows, -delta)).sum()
            expected = 0.0 if fixed[node] and axis == 6 else (there - back) / (2.0 * step)
            assert gradient[node, axis] == pytest.approx(expected, abs=1e-5)


def drifted() -> tuple[PoseGraph, dict[NodeId, np.ndarray], dict[NodeId, float]]:
    graph, truth = loops(np.random.default_rng(3), robots=2, length=30, sigma_t=0.0, sigma_deg=0.0)
    units = {n: float(np.exp(0.1 * n.robot + 0.02 * n.index)) for n in graph.nodes}
    return drifting(graph, truth, units), truth, units


def test_exact_edges_give_the_truth_without_a_guess() -> None:
    graph, truth, units = drifted()
    nodes, a = graph.nodes, graph.arrays()
    edges, fixed = edges_of(graph.edges, a.ends), np.zeros(len(nodes), dtype=bool)
    poses = np.tile(np.eye(4), (len(nodes), 1, 1))
    poses[0], log_units = truth[nodes[0]], np.zeros(len(nodes))
    log_units[0] = np.log(units[nodes[0]])
    started = linear_start(edges, poses, log_units, [0], fixed)
    for found in (started[0], minimum(edges, poses, log_units, [0], fixed).poses):
        np.testing.assert_allclose(found, [truth[n] for n in nodes], atol=1e-6)
    descended = descend(edges, *started, [0], fixed)
    np.testing.assert_allclose(np.exp(descended.log_units), [units[n] for n in nodes], rtol=1e-6)


def test_a_condensed_stretch_has_the_noise_of_simulated_ones_units_too() -> None:
    rng = np.random.default_rng(4)
    kappa, tau, sigma, n = 2e6, 1e6, 0.02, 12
    information = np.diag([tau] * 3 + [2 * kappa] * 3)
    T = se3_exp([1.0, 0.1, 0.0, 0.0, 0.1, 0.05])
    edges = [
        Edge(NodeId(0, k), NodeId(0, k + 1), T, information, EdgeKind.ODOMETRY, 1.02, scale_sigma=sigma)
        for k in range(n)
    ]
    ends = (Edge(NodeId(0, 0), NodeId(1, 0), np.eye(4), information), Edge(NodeId(0, n), NodeId(1, 1), np.eye(4)))
    poses = {NodeId(0, k): np.eye(4) for k in range(n + 1)}
    condensed = OwnGraph(Share(0, (0, 1), poses, (*edges, *ends), frozenset({0, 1}))).condensed(1000).edges
    exact, shifts = Sim3.identity(), []
    for _ in range(n):
        exact = exact @ Sim3(T[:3, :3], T[:3, 3], 1.02)
    np.testing.assert_allclose(condensed.measured[0], se3(exact.rotation, exact.translation), atol=1e-9)
    assert condensed.log_scale[0] == pytest.approx(n * np.log(1.02))
    logs = []
    for _ in range(4000):
        S = Sim3.identity()
        for drift in sigma * rng.normal(size=n):
            S = S @ Sim3(T[:3, :3], T[:3, 3], 1.02 * np.exp(drift))
        shifts.append(S.translation)
        logs.append(np.log(S.scale))
    assert np.var(logs) == pytest.approx(1.0 / condensed.precision[0], rel=0.08)
    assert np.var(shifts, axis=0).sum() == pytest.approx(3.0 / condensed.tau[0], rel=0.1)
