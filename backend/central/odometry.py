"""Odometry of a whole graph: lengths that the loops call for, and whether its deviations are what the edges state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array, so3_exp
from ..pose_graph.graph import NodeId, PoseGraph
from .headings import with_corrections
from .odometry_steps import OdometrySteps, steps_of
from .similarity_edges import Descended, SimilarityEdges, edges_of
from .trust_region import anchors, named_parts


@dataclass(frozen=True, eq=False)
class OdometryCorrections:
    """``factors`` of lengths by robot and ``rates`` ``(3,)`` at which steps are to turn by more, rad/m in the frame of
    their end; none where the loops call for none; the ``poses`` with them."""

    factors: Mapping[int, float]
    rates: Mapping[int, Array]
    poses: Mapping[NodeId, Array]


def odometry_corrections(
    graph: PoseGraph, sigma: float, turning: float = 0.0, unit_weights: bool = False
) -> OdometryCorrections:
    """Factors of the robots' lengths, of deviation ``sigma`` before anything is known, and rates at which they turn,
    of deviation ``turning`` (rad/m). ``graph`` is metric and stands at the minimum of F (U with ``unit_weights``),
    without priors."""
    working = graph.with_unit_weights() if unit_weights else graph
    a = working.arrays()
    edges, steps = metric_edges(working, sigma, turning)
    held, kept = anchors(a), np.ones(len(a.poses), dtype=bool)
    start = Descended(a.poses, np.zeros(len(a.poses)), 0)
    best = with_corrections(edges, start, held, kept, steps, freedom(working))
    factors = dict(zip(graph.robots, best.lengths.factors.tolist(), strict=True)) if best.lengths.used else {}
    rates = dict(zip(graph.robots, best.headings.rates, strict=True)) if best.headings.used else {}
    return OdometryCorrections(factors, rates, a.named(best.found.poses) if factors or rates else graph.poses)


def corrected(graph: PoseGraph, factors: Mapping[int, float], rates: Mapping[int, Array] | None = None) -> PoseGraph:
    """The graph with the odometry of each robot multiplied by its factor (1 where not named) and turned by its rate
    ``(3,)``, rad/m."""
    turns = rates or {}
    row = {n: k for k, n in enumerate(graph.nodes)}
    edges = []
    for e in graph.edges:
        T = e.T_i_j
        if e.i.robot == e.j.robot and abs(row[e.i] - row[e.j]) == 1:
            T = corrected_step(T, factors.get(e.i.robot, 1.0), turns.get(e.i.robot, np.zeros(3)))
        edges.append(replace(e, T_i_j=T))
    return replace(graph, edges=tuple(edges))


def corrected_step(T_i_j: Array, factor: float, rate: ArrayLike) -> Array:
    """A step of odometry ``(4, 4)`` multiplied by its robot's factor and turned by its rate ``(3,)``, rad/m."""
    rate = np.asarray(rate, dtype=np.float64)
    T = T_i_j.copy()
    if rate.any():
        T[:3, :3] = T[:3, :3] @ so3_exp(rate * float(np.linalg.norm(T[:3, 3])))
    T[:3, 3] *= factor
    return T


def metric_edges(graph: PoseGraph, sigma: float, turning: float = 0.0) -> tuple[SimilarityEdges, OdometrySteps]:
    """Edges of a metric graph as arrays, those that weigh nothing left out, and which of them are odometry: one
    factor and one rate a robot."""
    a = graph.arrays()
    used = np.array([e.weight > 0 for e in graph.edges], dtype=bool)
    number = {robot: k for k, robot in enumerate(graph.robots)}
    robot_of: NDArray[np.intp] = np.array([number[n.robot] for n in a.nodes], dtype=np.intp)
    edges = edges_of(graph.edges, a.ends[: len(graph.edges)], graph.dimension).only(used)
    return edges, steps_of(edges.ends, robot_of, len(number), sigma, turning)


def freedom(graph: PoseGraph) -> int:
    """Degrees of freedom of a metric graph: what its edges measure beyond what joins the nodes."""
    edges = sum(e.weight > 0 for e in graph.edges)
    joined = len(np.unique(named_parts(graph.arrays())[: len(graph.poses)]))
    return 6 * (edges - len(graph.poses) + joined)
