"""Central optimisation and the three costs: against gtsam's own factors and closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import grid, loops, measured

from maslam.backend.central.costs import cost, edge_cost
from maslam.backend.central.gtsam_adapter import levenberg_marquardt
from maslam.backend.central.linear import isotropic_weights
from maslam.backend.central.optimise import optimise, polished, two_stage
from maslam.backend.config import CentralConfig
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, Prior

gtsam = pytest.importorskip("gtsam")


def noisy(seed=0):
    rng = np.random.default_rng(seed)
    graph, _ = grid(rng)
    edges = []
    for e in graph.edges:
        root = rng.normal(size=(6, 6))
        edges.append(replace(e, information=root @ root.T + np.eye(6)))
    return replace(graph, edges=tuple(edges))


def test_costs_agree_with_gtsam():
    graph = noisy()
    swap = [3, 4, 5, 0, 1, 2]
    values = gtsam.Values()
    keys = {n: k for k, n in enumerate(graph.nodes)}
    for n, k in keys.items():
        values.insert(k, gtsam.Pose3(graph.poses[n]))
    geodesic, frobenius = [], []
    for e in graph.edges:
        pair = keys[e.i], keys[e.j], gtsam.Pose3(e.T_i_j)
        model = gtsam.noiseModel.Gaussian.Information(e.information[np.ix_(swap, swap)])
        geodesic.append(gtsam.BetweenFactorPose3(*pair, model).error(values))
        frobenius.append(gtsam.FrobeniusBetweenFactorPose3(*pair).error(values))
    np.testing.assert_allclose(edge_cost(graph, "E"), geodesic, rtol=1e-7)
    np.testing.assert_allclose(edge_cost(graph, "U"), frobenius, rtol=1e-9)


def test_weights_are_those_of_se_sync():
    information = np.diag([1.0, 2.0, 4.0, 10.0, 20.0, 40.0])
    kappa, tau = isotropic_weights(information[None])
    assert tau[0] == pytest.approx(3 / (1 + 1 / 2 + 1 / 4))
    assert kappa[0] == pytest.approx(3 / (2 * (1 / 10 + 1 / 20 + 1 / 40)))
    kappa, tau = isotropic_weights(information[None], dimension=2)
    assert tau[0] == pytest.approx(2 / (1 + 1 / 2)) and kappa[0] == pytest.approx(40.0)
    kappa, tau = isotropic_weights(np.diag([1.0, 1.0, -1.0, 1.0, 1.0, 0.0])[None])
    assert 0 <= kappa[0] < 1e-6 and 0 <= tau[0] < 1e-6
    graph, _ = grid(np.random.default_rng(0))
    assert cost(graph.with_unit_weights(), "F") == pytest.approx(2 * cost(graph, "U"))


@pytest.mark.parametrize("convention", ["F", "U", "E"])
@pytest.mark.parametrize("start", ["chordal", "given"])
def test_exact_measurements_cost_nothing(convention, start):
    graph, truth = loops(np.random.default_rng(1), robots=2, length=20, sigma_t=0.0, sigma_deg=0.0)
    result = optimise(graph, CentralConfig(cost=convention, start=start))
    assert result.cost_after < 1e-8 < result.cost_before and result.improved
    shift = graph.poses[NodeId(0, 0)] @ se3_inverse(truth[NodeId(0, 0)])
    for node in truth:
        np.testing.assert_allclose(result.graph.poses[node], shift @ truth[node], atol=1e-4)


def test_a_loop_of_three_shares_its_error_evenly():
    # Three steps forward that should close but are 0.3 m short: each takes a third.
    nodes = [NodeId(0, k) for k in range(3)]
    steps = [np.eye(4) for _ in range(3)]
    steps[0][0, 3], steps[1][0, 3], steps[2][0, 3] = 1.0, 1.0, -1.7
    edges = tuple(Edge(nodes[k], nodes[(k + 1) % 3], steps[k], np.eye(6)) for k in range(3))
    poses = {n: np.eye(4) for n in nodes}
    result = optimise(PoseGraph(poses, edges), CentralConfig(cost="E"))
    x = [result.graph.poses[n][0, 3] for n in nodes]
    np.testing.assert_allclose(x, [0.0, 0.9, 1.8], atol=1e-6)
    assert result.cost_after == pytest.approx(0.5 * 3 * 0.1**2)


@pytest.mark.parametrize("convention", ["F", "U", "E"])
def test_the_optimum_is_no_worse_than_the_two_stage_solution_and_stays(convention):
    graph = noisy(2)
    staged = cost(two_stage(graph, unit_weights=convention == "U"), convention)
    result = optimise(graph, CentralConfig(cost=convention))
    assert result.cost_after <= staged < result.cost_before
    again = optimise(result.graph, CentralConfig(cost=convention))
    assert again.cost_after <= result.cost_after
    assert again.cost_after == pytest.approx(result.cost_after, rel=1e-7)


def test_a_robust_loss_bears_a_wrong_edge():
    rng = np.random.default_rng(3)
    graph, truth = loops(rng, robots=2, length=30, sigma_t=0.01, sigma_deg=0.05)
    wrong = measured(
        truth, NodeId(0, 3), NodeId(1, 20), EdgeKind.SEPARATOR, np.zeros(6), graph.edges[0].information, rng
    )
    wrong = replace(wrong, T_i_j=wrong.T_i_j @ se3_exp([10.0, 5, 0, 0, 1, 0]))
    spoiled = replace(graph, edges=(*graph.edges, wrong))
    shift = graph.poses[NodeId(0, 0)] @ se3_inverse(truth[NodeId(0, 0)])

    def worst(result):
        return max(np.linalg.norm((result.graph.poses[n] - shift @ truth[n])[:3, 3]) for n in truth)

    plain = worst(optimise(spoiled, CentralConfig(cost="E")))
    robust = worst(optimise(spoiled, CentralConfig(cost="E", loss="cauchy", start="chordal")))
    assert robust < 0.3 * plain


def test_parts_that_nothing_joins_are_each_held_by_their_first_node():
    graph, _ = loops(np.random.default_rng(4), robots=3, length=12)
    apart = replace(graph, edges=tuple(e for e in graph.edges if not e.is_separator))
    result = optimise(apart, CentralConfig())
    assert result.cost_after <= result.cost_before < 1e-9
    for robot in apart.robots:
        np.testing.assert_allclose(result.graph.poses[NodeId(robot, 0)], np.eye(4), atol=1e-9)
    nothing = PoseGraph({NodeId(0, 0): np.eye(4)}, ())
    assert optimise(nothing, CentralConfig()).graph is nothing


@pytest.mark.parametrize("convention", ["F", "U", "E"])
def test_priors_place_the_graph_and_gps_needs_no_rotation(convention):
    graph, truth = loops(np.random.default_rng(7), robots=2, length=30, sigma_t=0.0, sigma_deg=0.0)
    gps = np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    position = {n: truth[n].copy() for n in list(truth)[::7]}
    for T in position.values():
        T[:3, :3] = np.eye(3)
    cases = [tuple(Prior(n, T, gps) for n, T in position.items()), (Prior(NodeId(1, 4), truth[NodeId(1, 4)]),)]
    for priors in cases:
        result = optimise(replace(graph, priors=priors), CentralConfig(cost=convention if convention != "U" else "F"))
        assert result.cost_after < 1e-8
        for n in truth:
            np.testing.assert_allclose(result.graph.poses[n], truth[n], atol=1e-3)


def test_a_prior_pulls_with_its_weight():
    a, b = NodeId(0, 0), NodeId(0, 1)
    step = np.eye(4)
    step[0, 3] = 1.0
    far = np.eye(4)
    far[0, 3] = 2.0
    # Anchored at 0, one edge of length 1, and a prior at 2 of weight 1/2: x = (1 + 2 / 2) / 1.5.
    priors = (Prior(a, np.eye(4), 1e9 * np.eye(6)), Prior(b, far, np.eye(6), weight=0.5))
    graph = PoseGraph({a: np.eye(4), b: np.eye(4)}, (Edge(a, b, step),), priors=priors)
    for convention in ("F", "E"):
        result = optimise(graph, CentralConfig(cost=convention))
        assert result.graph.poses[b][0, 3] == pytest.approx(4 / 3, abs=1e-6)
    with pytest.raises(BackendError, match="no pose for this node"):
        PoseGraph({a: np.eye(4)}, (), priors=(Prior(b, far),))


def test_newton_reaches_the_optimum_from_far():
    # Only the curvature's sign tells a saddle from a minimum; gtsam's own descent is the witness.
    rng = np.random.default_rng(11)
    graph, _ = grid(rng, sigma=0.2)
    lost = graph.with_poses({n: T @ se3_exp(rng.normal(size=6)) for n, T in graph.poses.items()})
    refined, _, converged = polished(lost)
    assert converged and cost(refined, "F") == pytest.approx(optimise(graph, CentralConfig()).cost_after, rel=1e-9)
    by_gtsam, _ = levenberg_marquardt(graph, CentralConfig(iterations=300, tolerance=1e-13))
    assert cost(refined, "F") == pytest.approx(cost(by_gtsam, "F"), rel=1e-7)


def test_weights_that_span_ten_powers_of_ten_do_not_stop_levenberg_marquardt():
    """Headings of most steps known to a millionth, as some public files say: one damping for all unknowns is none for
    most, and the start came back as the optimum."""
    rng = np.random.default_rng(0)
    turns = 2 * np.pi * np.arange(12) / 12
    truth = {NodeId(0, k): se3(so3_exp([0, 0, a]), [5 * np.cos(a), 5 * np.sin(a), 0]) for k, a in enumerate(turns)}
    edges = []
    for k in range(12):
        i, j = NodeId(0, k), NodeId(0, (k + 1) % 12)
        noise = np.r_[0.05 * rng.normal(size=2), 0, 0, 0, 0.01 * rng.normal()]
        information = np.diag([10, 400, 1, 1, 1, 1e12 if k % 3 else 1e3])
        kind = EdgeKind.ODOMETRY if k < 11 else EdgeKind.LOOP
        edges.append(Edge(i, j, se3_inverse(truth[i]) @ truth[j] @ se3_exp(noise), information, kind))
    graph = PoseGraph(truth, tuple(edges), dimension=2)
    start = cost(optimise(graph, CentralConfig(cost="F")).graph, "E")
    assert optimise(graph, CentralConfig(cost="E")).cost_after < 0.2 * start
