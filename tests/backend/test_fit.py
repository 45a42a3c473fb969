"""The fit of a graph against closed forms: the cost, its degrees of freedom, the edges that fit worst."""

from __future__ import annotations

import numpy as np
import pytest

from maslam.backend.central.costs import cost
from maslam.backend.central.fit import FAR_ABOVE, degrees_of_freedom, graph_fit
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, SimilarityConfig
from maslam.backend.geometry import Array, Sim3, se3, se3_exp, se3_inverse, so3_exp
from maslam.backend.pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph

SIGMA = 0.1


def along(x: float, yaw: float = 0.0) -> Array:
    return se3(so3_exp([0.0, yaw, 0.0]), [x, 0.0, 0.0])


def edge(i: int, j: int, T: Array, kind: EdgeKind = EdgeKind.ODOMETRY, robots: tuple[int, int] = (0, 0)) -> Edge:
    return Edge(NodeId(robots[0], i), NodeId(robots[1], j), T, np.eye(6) / SIGMA**2, kind)


def line(xs: list[float], longest: float) -> PoseGraph:
    """Three places on a line, one metre apart by odometry; the loop says ``longest`` from first to last."""
    edges = (edge(0, 1, along(1.0)), edge(1, 2, along(1.0)), edge(0, 2, along(longest), EdgeKind.LOOP))
    return PoseGraph({NodeId(0, k): along(x) for k, x in enumerate(xs)}, edges)


def test_a_loop_that_is_off_costs_what_its_thirds_cost() -> None:
    """2.3 m instead of 2: the best poses spread 0.3 m evenly, one sigma for each edge."""
    fit = graph_fit(line([0.0, 1.1, 2.2], 2.3))
    assert fit.cost == pytest.approx(3.0) and fit.dof == 6 and fit.fits and fit.edges == 3
    unspread = graph_fit(line([0.0, 1.0, 2.0], 2.3))
    assert unspread.cost == pytest.approx(9.0)
    (worst,) = unspread.worst
    assert (worst.i, worst.j, worst.kind) == (NodeId(0, 0), NodeId(0, 2), EdgeKind.LOOP)
    assert worst.cost == pytest.approx(9.0)


def test_far_above_its_degrees_of_freedom_is_no_noise() -> None:
    off = SIGMA * np.sqrt(FAR_ABOVE * 6 * 3)  # three edges, a third of it each: 6 degrees of freedom times the bound
    inside, outside = (graph_fit(optimised(line([0.0, 1.0, 2.0], 2.0 + off * k))) for k in (0.99, 1.01))
    assert inside.fits and not outside.fits
    tree = PoseGraph({NodeId(0, 0): along(0.0), NodeId(0, 1): along(9.0)}, (edge(0, 1, along(1.0)),))
    assert graph_fit(tree).dof == 0 and graph_fit(tree).fits, "nothing contradicts a tree"


def optimised(graph: PoseGraph) -> PoseGraph:
    return optimise(graph, CentralConfig()).graph


def test_a_turn_costs_its_square() -> None:
    graph = PoseGraph({NodeId(0, 0): along(0.0), NodeId(0, 1): along(1.0, 0.2)}, (edge(0, 1, along(1.0)),))
    assert graph_fit(graph).cost == pytest.approx(2 * (1 - np.cos(0.2)) / SIGMA**2)
    assert graph_fit(graph).cost == pytest.approx(cost(graph, "F"))


def test_the_cost_of_noise_is_about_its_degrees_of_freedom() -> None:
    """Poses around a ring with loops across, measured with the noise that the edges claim: the mean of the best cost
    over draws is the degrees of freedom."""
    truth = [se3(so3_exp([0.0, 0.3 * k, 0.0]), [5 * np.sin(0.3 * k), 0.0, 5 * np.cos(0.3 * k)]) for k in range(20)]
    pairs = [(k, k + 1) for k in range(19)] + [(0, 19), (2, 17), (4, 15), (5, 14), (1, 12), (3, 9)]
    sigma = np.array([0.02] * 3 + [0.01] * 3)
    found = []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        edges = tuple(
            Edge(
                NodeId(0, i),
                NodeId(0, j),
                se3_inverse(truth[i]) @ truth[j] @ se3_exp(rng.normal(0.0, sigma)),
                np.diag(1.0 / sigma**2),
            )
            for i, j in pairs
        )
        fit = graph_fit(optimised(PoseGraph(dict(zip([NodeId(0, k) for k in range(20)], truth, strict=True)), edges)))
        found.append(fit.cost / fit.dof)
    assert fit.dof == 6 * (25 - 20 + 1)
    assert np.mean(found) == pytest.approx(1.0, abs=0.12) and max(found) < 3.0


def test_a_scale_of_its_own_costs_the_square_of_its_logarithm() -> None:
    """Two nodes; the second's unit is half as long as the edge says; translations are in the first's unit, 4."""
    graph = PoseGraph({NodeId(0, 0): along(0.0), NodeId(0, 1): along(0.0)}, (edge(0, 1, along(1.0)),))
    poses = {NodeId(0, 0): Sim3(np.eye(3), np.zeros(3), 4.0), NodeId(0, 1): Sim3(np.eye(3), np.array([4.4, 0, 0]), 2.0)}
    config = SimilarityConfig(drift_sigma=0.5)
    fit = graph_fit(graph, poses, frozenset(), config)
    assert fit.cost == pytest.approx((0.1 / SIGMA) ** 2 + (np.log(2.0) / 0.5) ** 2)
    assert graph_fit(graph, poses, frozenset({0}), config).cost == pytest.approx((0.1 / SIGMA) ** 2)


def test_degrees_of_freedom_by_parts_and_units() -> None:
    """A ring of four of robot 0, and a ring of three of robot 1 apart from it."""
    ring = [edge(k, (k + 1) % 4, along(1.0)) for k in range(4)]
    other = [edge(k, (k + 1) % 3, along(1.0), robots=(1, 1)) for k in range(3)]
    poses = {NodeId(0, k): along(k) for k in range(4)} | {NodeId(1, k): along(k) for k in range(3)}
    apart = PoseGraph(poses, (*ring, *other))
    assert degrees_of_freedom(apart) == 12
    assert degrees_of_freedom(apart, frozenset()) == 14, "7 for each loop"
    assert degrees_of_freedom(apart, frozenset({0, 1})) == 12
    assert degrees_of_freedom(apart, frozenset({0})) == 13
    joined = PoseGraph(poses, (*ring, *other, edge(0, 0, along(1.0), EdgeKind.SEPARATOR, (0, 1))))
    # The match gives the other ring a place and a unit: nothing contradicts it. Of metric robots its unit is known.
    assert degrees_of_freedom(joined) == 12 and degrees_of_freedom(joined, frozenset()) == 14
    assert degrees_of_freedom(joined, frozenset({0})) == 13


def test_a_graph_without_edges_fits() -> None:
    fit = graph_fit(PoseGraph({NodeId(0, 0): along(0.0)}, ()))
    assert (fit.cost, fit.dof, fit.worst, fit.fits) == (0.0, 0, (), True)
