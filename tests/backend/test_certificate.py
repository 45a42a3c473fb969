"""The certificate: true at optima known in closed form or by reference, false at a local minimum that is known too."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import grid, loops

from maslam.backend.central.certificate import certify
from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig
from maslam.backend.errors import BackendError
from maslam.backend.geometry import se3, se3_exp, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph, Prior


def ring(dimension, turns, n=20, measured_turns=0.3):
    """Rotations in a ring that measure ``measured_turns`` round, poses that go round ``turns`` times; translation 0.

    Every whole number of turns is a local minimum, with the rest of the turn spread evenly: each edge costs
    ``4 (1 - cos rest)`` (kappa 1).
    """
    nodes = [NodeId(0, k) for k in range(n)]
    step = se3(so3_exp([0.0, 0.0, 2 * np.pi * measured_turns / n]), np.zeros(3))
    information = np.diag([1.0, 1.0, 1.0, 2.0, 2.0, 2.0 if dimension == 3 else 1.0])
    edges = tuple(Edge(nodes[k], nodes[(k + 1) % n], step, information) for k in range(n))
    poses = {m: se3(so3_exp([0.0, 0.0, 2 * np.pi * turns * k / n]), np.zeros(3)) for k, m in enumerate(nodes)}
    rest = 2 * np.pi * (measured_turns - turns) / n
    return PoseGraph(poses, edges, dimension), n * 4.0 * (1.0 - np.cos(rest))


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_ring_wound_a_full_turn_is_not_certified_and_the_unwound_is(dimension):
    best, optimum = ring(dimension, 0)
    found = certify(best)
    assert found.certified and found.cost == pytest.approx(optimum) and found.gap < 1e-9
    assert found.smallest_eigenvalue > -1e-9
    wound, local = ring(dimension, 1)
    # It is a local minimum: the optimiser stays there.
    stays = optimise(wound, CentralConfig(start="given"))
    assert stays.cost_after == pytest.approx(local) and local > 5 * optimum
    found = certify(wound)
    assert not found.certified and found.smallest_eigenvalue < -1e-3
    assert found.lower_bound <= optimum * (1 + 1e-9) and found.gap >= (local / optimum - 1) * (1 - 1e-9)


@pytest.mark.parametrize("convention", ["F", "U"])
def test_the_bound_holds_below_and_the_gap_above(convention):
    graph, _ = grid(np.random.default_rng(3), sigma=0.15)
    best = optimise(graph, CentralConfig(cost=convention))
    assert certify(best.graph, convention).certified
    rng = np.random.default_rng(4)
    for size in (1e-4, 1e-2):
        off = best.graph.with_poses({n: T @ se3_exp(size * rng.normal(size=6)) for n, T in best.graph.poses.items()})
        found = certify(off, convention)
        true_gap = cost(off, convention) / best.cost_after - 1
        assert not found.certified and found.lower_bound <= best.cost_after * (1 + 1e-12)
        assert found.gap == pytest.approx(true_gap, rel=1e-4)


def test_weights_parts_and_exact_graphs():
    graph, _ = loops(np.random.default_rng(5), robots=3, length=20)
    weights = np.where([e.is_separator for e in graph.edges], 0.5, 1.0)
    apart = replace(graph, edges=tuple(e for e in graph.edges if {e.i.robot, e.j.robot} != {0, 1}))
    for case in (graph.with_weights(weights), apart, graph.with_weights(weights == 1.0)):
        assert certify(optimise(case, CentralConfig()).graph).certified
    found = certify(PoseGraph(graph.poses, ()))
    assert found.certified and found.cost == 0 == found.gap
    with pytest.raises(BackendError, match="no certificate for cost E"):
        certify(graph, "E")


def test_priors_count():
    graph, truth = loops(np.random.default_rng(6), robots=2, length=20)
    priors = tuple(Prior(NodeId(0, k), truth[NodeId(0, k)], np.eye(6)) for k in (0, 7, 14))
    result = optimise(replace(graph, priors=priors), CentralConfig())
    assert certify(result.graph).certified
    # The same priors as edges to a node of their own, which is the origin.
    origin = NodeId(9, 0)
    edges = [Edge(origin, p.node, p.T_O_i, p.information, EdgeKind.SEPARATOR) for p in priors]
    same = PoseGraph({**graph.poses, origin: np.eye(4)}, (*graph.edges, *edges))
    assert optimise(same, CentralConfig()).cost_after == pytest.approx(result.cost_after, rel=1e-9)


def test_what_it_says():
    best, _ = ring(2, 0)
    assert "globally optimal" in str(certify(best))
    nothing = replace(certify(best), certified=False, gap=float("inf"), smallest_eigenvalue=-0.5)
    assert "not certified, eigenvalue -0.5" in str(nothing)
    shaken = best.with_poses({NodeId(0, 3): best.poses[NodeId(0, 3)] @ se3_exp([0, 0, 0, 0, 0, 0.01])})
    assert "% above the global optimum" in str(certify(shaken))
