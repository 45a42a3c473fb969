"""How well poses fit the edges of a graph: the cost against its degrees of freedom, and the edges that fit worst.

Residuals are in standard deviations. The sum over the edges is the cost F (SE-Sync: :mod:`.costs`), with units of
length where nodes have their own (:mod:`.similarity_edges`). Where edges are as good as their information says, the
cost of the best poses is about its degrees of freedom: 6 for each edge beyond those that it takes to join the nodes, 7
with scales. A cost many times that says that edges contradict each other, or are not as good as they claim.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..config import SimilarityConfig
from ..geometry import Array, Sim3
from ..pose_graph.graph import EdgeKind, NodeId, PoseGraph
from .similarity_edges import edges_of
from .trust_region import named_parts

FAR_ABOVE = 10.0
"""A cost of more than so many times its degrees of freedom is no noise."""


@dataclass(frozen=True)
class EdgeMisfit:
    """An edge and its share of the cost, whose square root is its error in standard deviations."""

    i: NodeId
    j: NodeId
    kind: EdgeKind
    cost: float


@dataclass(frozen=True)
class GraphFit:
    """``cost`` of ``edges`` edges, ``dof`` its degrees of freedom; ``worst``: the edges with the largest shares, the
    largest first."""

    cost: float
    dof: int
    edges: int
    worst: tuple[EdgeMisfit, ...]

    @property
    def fits(self) -> bool:
        """Whether the cost is what noise makes it. A graph without a loop fits whatever its edges say."""
        return self.dof <= 0 or self.cost <= FAR_ABOVE * self.dof


def graph_fit(
    graph: PoseGraph,
    poses: Mapping[NodeId, Sim3] | None = None,
    metric: frozenset[int] | None = None,
    config: SimilarityConfig | None = None,
    worst: int = 5,
) -> GraphFit:
    """The fit of ``graph`` at ``poses`` (``S_O_i``: the scale is the node's unit in the origin's; without, its own).

    ``metric``: robots whose nodes all have the unit of the origin; None: all of them. ``config``: the deviations of
    log scales where an edge says none. ``worst``: so many edges are named, none whose share is 0. Priors do not count.
    """
    shares = _shares(graph, poses, metric, config or SimilarityConfig())
    order = np.argsort(-shares, kind="stable")[:worst]
    named = [(graph.edges[k], float(shares[k])) for k in order if shares[k] > 0]
    return GraphFit(
        cost=float(shares.sum()),
        dof=degrees_of_freedom(graph, metric),
        edges=len(graph.edges),
        worst=tuple(EdgeMisfit(e.i, e.j, e.kind, cost) for e, cost in named),
    )


def degrees_of_freedom(graph: PoseGraph, metric: frozenset[int] | None = None) -> int:
    """6 for each edge less 6 for each node, of which one in each connected part is free; and 1 each for the scales of
    nodes and of edges that have one, of which one is free in parts without a metric robot."""
    part = named_parts(graph.arrays())[: len(graph.poses)]
    count = len(np.unique(part))
    dof = 6 * (len(graph.edges) - len(graph.poses) + count)
    if metric is None:
        return dof
    scaled = sum(not {e.i.robot, e.j.robot} <= metric for e in graph.edges)
    own = np.array([n.robot not in metric for n in graph.nodes])
    free = count - len(np.unique(part[~own]))
    return dof + scaled - int(own.sum()) + free


def _shares(
    graph: PoseGraph, poses: Mapping[NodeId, Sim3] | None, metric: frozenset[int] | None, config: SimilarityConfig
) -> Array:
    """Each edge's share of the cost ``(m,)``."""
    if not graph.edges:
        return np.zeros(0)
    known = poses or {n: Sim3.from_se3(T) for n, T in graph.poses.items()}
    nodes = [n for e in graph.edges for n in (e.i, e.j)]
    ends = np.arange(len(nodes), dtype=np.intp).reshape(-1, 2)
    edges = edges_of(graph.edges, ends, graph.dimension, config)
    scaled = [metric is not None and not {e.i.robot, e.j.robot} <= metric for e in graph.edges]
    edges = replace(edges, precision=np.where(scaled, edges.precision, 0.0))
    log_units = np.log(np.array([known[n].scale for n in nodes]))
    return edges.costs(np.array([known[n].se3() for n in nodes]), log_units)
