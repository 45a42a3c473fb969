"""How well poses fit the edges of a graph: the cost against its degrees of freedom, and the edges that fit worst.

Residuals are in standard deviations. The sum over the edges is the cost F (SE-Sync: :mod:`.costs`), translations in
the unit of each edge's first node; where nodes have a scale of their own, plus ``log(s_j / (s_i scale))^2`` over its
variance, as in :mod:`.similarity`. Where edges are as good as their information says, the cost of the best poses is
about its degrees of freedom: 6 for each edge beyond those that it takes to join the nodes, 7 with scales. A cost many
times that says that edges contradict each other, or are not as good as they claim.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..config import SimilarityConfig
from ..geometry import Array, Sim3
from ..pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from .linear import edge_costs, isotropic_weights
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
    ends = [(known[e.i], known[e.j]) for e in graph.edges]
    T_i_j = np.array([_in_units_of(S_i, S_j) for S_i, S_j in ends])
    measured = np.array([e.T_i_j for e in graph.edges])
    kappa, tau = isotropic_weights(np.array([e.weight * e.information for e in graph.edges]), graph.dimension)
    shares = edge_costs(np.broadcast_to(np.eye(4), T_i_j.shape), T_i_j, measured, kappa, tau)
    if metric is not None:
        apart = [np.log(S_j.scale / (S_i.scale * e.scale)) for e, (S_i, S_j) in zip(graph.edges, ends, strict=True)]
        sigma = np.array([_scale_sigma(e, config) for e in graph.edges])
        scaled = np.array([not {e.i.robot, e.j.robot} <= metric for e in graph.edges])
        shares = shares + np.array([e.weight for e in graph.edges]) * scaled * (np.array(apart) / sigma) ** 2
    return np.asarray(shares, dtype=np.float64)


def _in_units_of(S_i: Sim3, S_j: Sim3) -> Array:
    """``T_i_j`` ``(4, 4)``, its translation in i's unit."""
    T = np.eye(4)
    T[:3, :3] = S_i.rotation.T @ S_j.rotation
    T[:3, 3] = S_i.rotation.T @ (S_j.translation - S_i.translation) / S_i.scale
    return T


def _scale_sigma(edge: Edge, config: SimilarityConfig) -> float:
    own: float | None = getattr(edge, "scale_sigma", None)
    if own is not None:
        return own
    return config.drift_sigma if edge.kind is EdgeKind.ODOMETRY else config.match_sigma
