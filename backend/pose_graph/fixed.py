"""Nodes that keep their poses (FIX lines of g2o files): which of them more than say where a graph lies, and a solution
laid on those that only do that."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from ..components import parts
from ..geometry import Array, product, se3_inverse
from .graph import PoseGraph
from .node import NodeId


def not_held(graph: PoseGraph) -> list[NodeId]:
    """The fixed nodes that a solver of free graphs cannot hold, whose result moves as a whole: all but the first of
    each connected part, and all where priors say where it lies."""
    label = _part_of(graph)
    tied = {label[prior.node] for prior in graph.priors}
    first: dict[int, NodeId] = {}
    for node in sorted(graph.fixed):
        first.setdefault(label[node], node)
    return [node for node in sorted(graph.fixed) if label[node] in tied or first[label[node]] != node]


def not_held_text(graph: PoseGraph, method: str) -> list[str]:
    """A sentence where ``method`` does not hold all that is fixed."""
    lost = not_held(graph)
    if not lost:
        return []
    more = f" and {len(lost) - 1} more" if len(lost) > 1 else ""
    why = "priors say where the graph lies" if graph.priors else "only one of each connected part is"
    return [f"FIX of {lost[0]}{more} is not held by {method}: {why}; central holds them all"]


def laid_on_fixed(graph: PoseGraph, poses: Mapping[NodeId, Array]) -> dict[NodeId, Array]:
    """``poses`` of a solution of ``graph`` without its fixed nodes: each connected part moved rigidly so that the one
    that can be held has its pose in ``graph``, exactly."""
    lost, label, out = set(not_held(graph)), _part_of(graph), dict(poses)
    for node in sorted(graph.fixed - lost):
        mine = [other for other in out if label[other] == label[node]]
        moved = product(product(graph.poses[node], se3_inverse(out[node])), np.array([out[other] for other in mine]))
        out |= dict(zip(mine, moved, strict=True))
        out[node] = graph.poses[node]
    return out


def _part_of(graph: PoseGraph) -> dict[NodeId, int]:
    nodes = graph.nodes
    label: NDArray[np.intp] = parts(graph.arrays().ends[: len(graph.edges)], len(nodes))
    return dict(zip(nodes, label.tolist(), strict=True))
