"""Odometry of a whole graph: lengths that the loops call for, and whether its deviations are what the edges state."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array
from ..pose_graph.graph import NodeId, PoseGraph
from .lengths import OdometrySteps, steps_of, with_lengths
from .similarity_edges import Descended, SimilarityEdges, edges_of
from .trust_region import anchors, named_parts


@dataclass(frozen=True, eq=False)
class OdometryLengths:
    """``factors`` by robot, none where the loops call for none; the ``poses`` with them."""

    factors: Mapping[int, float]
    poses: Mapping[NodeId, Array]


def odometry_lengths(graph: PoseGraph, sigma: float, unit_weights: bool = False) -> OdometryLengths:
    """Factors of the robots' lengths, of deviation ``sigma`` before anything is known. ``graph`` is metric and stands
    at the minimum of F (U with ``unit_weights``), without priors."""
    working = graph.with_unit_weights() if unit_weights else graph
    a = working.arrays()
    edges, steps = metric_edges(working, sigma)
    held, kept = anchors(a), np.ones(len(a.poses), dtype=bool)
    start = Descended(a.poses, np.zeros(len(a.poses)), 0)
    found, lengths = with_lengths(edges, start, held, kept, steps, freedom(working))
    if not lengths.used:
        return OdometryLengths({}, graph.poses)
    factors = dict(zip(graph.robots, lengths.factors.tolist(), strict=True))
    return OdometryLengths(factors, a.named(found.poses))


def lengthened(graph: PoseGraph, factors: Mapping[int, float]) -> PoseGraph:
    """The graph with the odometry of each robot multiplied by its factor (1 where not named)."""
    row = {n: k for k, n in enumerate(graph.nodes)}
    edges = []
    for e in graph.edges:
        T = e.T_i_j.copy()
        if e.i.robot == e.j.robot and abs(row[e.i] - row[e.j]) == 1:
            T[:3, 3] *= factors.get(e.i.robot, 1.0)
        edges.append(replace(e, T_i_j=T))
    return replace(graph, edges=tuple(edges))


def metric_edges(graph: PoseGraph, sigma: float) -> tuple[SimilarityEdges, OdometrySteps]:
    """Edges of a metric graph as arrays, those that weigh nothing left out, and which of them are odometry: one
    factor a robot."""
    a = graph.arrays()
    used = np.array([e.weight > 0 for e in graph.edges], dtype=bool)
    number = {robot: k for k, robot in enumerate(graph.robots)}
    robot_of: NDArray[np.intp] = np.array([number[n.robot] for n in a.nodes], dtype=np.intp)
    edges = edges_of(graph.edges, a.ends[: len(graph.edges)], graph.dimension).only(used)
    return edges, steps_of(edges.ends, robot_of, len(number), sigma)


def freedom(graph: PoseGraph) -> int:
    """Degrees of freedom of a metric graph: what its edges measure beyond what joins the nodes."""
    edges = sum(e.weight > 0 for e in graph.edges)
    joined = len(np.unique(named_parts(graph.arrays())[: len(graph.poses)]))
    return 6 * (edges - len(graph.poses) + joined)
