"""Scales as variables: monocular tracks with drift, of which the truth is known."""

import itertools

import numpy as np
import pytest

from maslam.backend.central.optimise import optimise
from maslam.backend.central.similarity import _Problem, _State, optimise_similarity
from maslam.backend.config import CentralConfig, SimilarityConfig
from maslam.backend.geometry import Sim3, se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, Prior

INFORMATION = np.diag([400.0] * 3 + [4e4] * 3)


def circle(n, robot=0, radius=10.0):
    """True poses on a circle, a full round."""
    return {
        NodeId(robot, k): se3(
            so3_exp([0.0, 0.0, 2 * np.pi * k / n]),
            radius * np.array([np.cos(2 * np.pi * k / n), np.sin(2 * np.pi * k / n), 0.05 * np.sin(6 * np.pi * k / n)]),
        )
        for k in range(n)
    }


def seen(truth, unit, i, j, kind, scale=None, noise=None):
    """The edge that nodes with these units measure: its translation in i's unit."""
    T = se3_inverse(truth[i]) @ truth[j]
    T[:3, 3] /= unit[i]
    T = T if noise is None else T @ se3_exp(noise)
    return Edge(i, j, T, INFORMATION, kind, unit[j] / unit[i] if scale is None else scale)


def track(truth, unit, **noise):
    """Odometry, which believes its unit constant: scale 1."""
    return [seen(truth, unit, a, b, EdgeKind.ODOMETRY, 1.0, **noise) for a, b in itertools.pairwise(sorted(truth))]


def aligned(result, truth, first):
    """Largest distance of positions from the truth, brought into the frame and unit of node ``first``."""
    move = result.poses[first].se3() @ se3_inverse(truth[first])
    return max(np.linalg.norm((move @ truth[n])[:3, 3] - result.poses[n].translation) for n in truth)


def test_steady_drift_is_undone_by_one_loop():
    # The unit shrinks by the same share each step, 30 % in a round; the loop measures it exactly. Spread evenly, as
    # least squares does, every scale is the truth's.
    truth = circle(120)
    nodes = sorted(truth)
    unit = {n: 0.7 ** (k / 119) for k, n in enumerate(nodes)}
    loop = seen(truth, unit, nodes[-1], nodes[0], EdgeKind.LOOP)
    graph = PoseGraph({n: np.eye(4) for n in nodes}, (*track(truth, unit), loop))
    result = optimise_similarity(graph, SimilarityConfig(match_sigma=1e-5))
    for n in nodes:
        assert result.poses[n].scale == pytest.approx(unit[n], rel=1e-3)
    assert aligned(result, truth, nodes[0]) < 0.02
    # Without scales there is no circle: the ends do not fit.
    rigid = optimise(graph, CentralConfig(cost="E")).graph
    move = rigid.poses[nodes[0]] @ se3_inverse(truth[nodes[0]])
    assert max(np.linalg.norm((move @ truth[n] - rigid.poses[n])[:3, 3]) for n in nodes) > 1.0
    # In one unit throughout, the edges fit their poses, and no scale is left but the drift in each.
    for e in result.graph.edges:
        between = se3_inverse(result.graph.poses[e.i]) @ result.graph.poses[e.j]
        np.testing.assert_allclose(e.T_i_j, between, atol=2e-3)
        assert e.scale == pytest.approx(1.0, abs=4e-3)


def test_random_drift_and_noise_are_mostly_undone():
    rng = np.random.default_rng(1)
    truth = circle(150)
    nodes = sorted(truth)
    walk = np.concatenate([[0.0], np.cumsum(0.01 * rng.normal(size=149) - 0.002)])
    unit = dict(zip(nodes, np.exp(walk), strict=True))
    sigma = np.array([0.01] * 3 + [0.001] * 3)
    edges = [
        seen(truth, unit, a, b, EdgeKind.ODOMETRY, 1.0, sigma * rng.normal(size=6))
        for a, b in itertools.pairwise(nodes)
    ]
    for k in range(0, 30, 3):
        edges.append(seen(truth, unit, nodes[149 - k], nodes[k], EdgeKind.LOOP, None, sigma * rng.normal(size=6)))
    graph = PoseGraph({n: np.eye(4) for n in nodes}, tuple(edges))
    result = optimise_similarity(graph, SimilarityConfig())
    assert result.cost_after < result.cost_before
    rigid = optimise(graph, CentralConfig(cost="E")).graph
    move = rigid.poses[nodes[0]] @ se3_inverse(truth[nodes[0]])
    error = max(np.linalg.norm((move @ truth[n] - rigid.poses[n])[:3, 3]) for n in nodes)
    assert aligned(result, truth, nodes[0]) < 0.4 * error
    ends = [result.poses[n].scale / unit[n] for n in nodes[-5:]]
    np.testing.assert_allclose(ends, 1.0, atol=0.04)


def test_monocular_robots_take_the_unit_of_the_metric_one_and_without_one_the_anchors():
    truth = {**circle(40, 0), **circle(40, 1), **circle(40, 2)}
    unit = {n: (1.0, 2.5, 0.4)[n.robot] for n in truth}
    edges = [e for r in range(3) for e in track({n: T for n, T in truth.items() if n.robot == r}, unit)]
    for k in range(0, 40, 8):
        edges.append(seen(truth, unit, NodeId(0, k), NodeId(1, k + 1), EdgeKind.SEPARATOR))
        edges.append(seen(truth, unit, NodeId(1, k), NodeId(2, k + 2), EdgeKind.SEPARATOR))
    graph = PoseGraph({n: np.eye(4) for n in truth}, tuple(edges))
    for metric, factor in ((frozenset(), 1.0), (frozenset({0}), 1.0), (frozenset({2}), 1 / 0.4)):
        result = optimise_similarity(graph, SimilarityConfig(), metric)
        assert result.cost_after < 1e-9
        for n in truth:
            assert result.poses[n].scale == pytest.approx(unit[n] * factor, rel=1e-5)
        # Node 0:0 stays where it is; the rest is the truth in the unit asked for.
        move = se3_inverse(truth[NodeId(0, 0)])
        for n in truth:
            np.testing.assert_allclose(result.poses[n].translation, factor * (move @ truth[n])[:3, 3], atol=1e-4)


def test_priors_give_the_metre():
    truth = circle(60)
    nodes = sorted(truth)
    unit = {n: 0.3 * 0.8 ** (k / 59) for k, n in enumerate(nodes)}
    gps = np.diag([100.0] * 3 + [0.0] * 3)
    positions = tuple(Prior(n, se3(np.eye(3), truth[n][:3, 3]), gps) for n in (*nodes[::5], nodes[-1]))
    graph = PoseGraph({n: np.eye(4) for n in nodes}, tuple(track(truth, unit)), priors=positions)
    rough = {n: Sim3(T[:3, :3], T[:3, 3] + 1.0, 1.0) for n, T in truth.items()}
    for start in (None, rough):
        result = optimise_similarity(graph, SimilarityConfig(), start=start)
        for n in nodes:
            np.testing.assert_allclose(result.poses[n].translation, truth[n][:3, 3], atol=0.05)
            assert result.poses[n].scale == pytest.approx(unit[n], rel=0.03)


def moved(x, step):
    return _State(x.rotation @ so3_exp(step[:, 3:6]), x.translation + step[:, :3], x.log_scale + step[:, 6])


def test_derivatives_are_those_of_differences():
    rng = np.random.default_rng(3)
    nodes = [NodeId(0, k) for k in range(3)]
    edges = tuple(
        Edge(a, b, se3_exp(rng.normal(size=6)), INFORMATION, EdgeKind.LOOP, 1.3)
        for a, b in itertools.permutations(nodes, 2)
    )
    problem = _Problem(PoseGraph({n: np.eye(4) for n in nodes}, edges), SimilarityConfig(), frozenset())
    x = _State(so3_exp(rng.normal(size=(3, 3))), rng.normal(size=(3, 3)), 0.3 * rng.normal(size=3))
    J = problem._jacobian(x)
    for node in range(3):
        for axis in range(7):
            step = np.zeros((3, 7))
            step[node, axis] = 1e-6
            slope = (problem.residuals(moved(x, step)) - problem.residuals(moved(x, -step))) / 2e-6
            for k, (i, j) in enumerate(problem.ends):
                expected = J[k, :, axis] if i == node else J[k, :, 7 + axis] if j == node else np.zeros(7)
                np.testing.assert_allclose(slope[k], expected, atol=1e-6)


def test_gtsam_finds_the_same():
    gtsam = pytest.importorskip("gtsam")
    rng = np.random.default_rng(4)
    truth = circle(60)
    nodes = sorted(truth)
    unit = dict(zip(nodes, np.exp(np.cumsum(0.01 * rng.normal(size=60))), strict=True))
    sigma = np.array([0.01] * 3 + [0.001] * 3)
    edges = [
        seen(truth, unit, a, b, EdgeKind.ODOMETRY, 1.0, sigma * rng.normal(size=6))
        for a, b in itertools.pairwise(nodes)
    ]
    edges += [
        seen(truth, unit, nodes[59 - k], nodes[k], EdgeKind.LOOP, None, sigma * rng.normal(size=6)) for k in (0, 4, 8)
    ]
    result = optimise_similarity(PoseGraph({n: np.eye(4) for n in nodes}, tuple(edges)), SimilarityConfig())
    factors, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    # gtsam's similarity is s (R p + t), its tangent (turn, shift, log scale).
    for k, n in enumerate(nodes):
        S = result.poses[n]
        values.insert(k, gtsam.Similarity3(gtsam.Rot3(S.rotation), S.translation / S.scale, S.scale))
    tight = gtsam.noiseModel.Isotropic.Sigma(7, 1e-4)
    factors.add(gtsam.PriorFactorSimilarity3(0, values.atSimilarity3(0), tight))
    for e in edges:
        s = 0.01 if e.kind is EdgeKind.ODOMETRY else 0.02
        model = gtsam.noiseModel.Diagonal.Sigmas(np.array([0.005] * 3 + [0.05] * 3 + [s]))
        measured = gtsam.Similarity3(gtsam.Rot3(e.T_i_j[:3, :3]), e.T_i_j[:3, 3] / e.scale, e.scale)
        factors.add(gtsam.BetweenFactorSimilarity3(e.i.index, e.j.index, measured, model))
    solved = gtsam.LevenbergMarquardtOptimizer(factors, values).optimize()
    there = [solved.atSimilarity3(k) for k in range(60)]
    off = max(
        np.linalg.norm(S.translation() * S.scale() - result.poses[n].translation)
        for n, S in zip(nodes, there, strict=True)
    )
    # The two costs agree to first order in the residuals.
    assert off < 0.005
    scales = [S.scale() / result.poses[n].scale for n, S in zip(nodes, there, strict=True)]
    np.testing.assert_allclose(scales, 1.0, atol=1e-3)
