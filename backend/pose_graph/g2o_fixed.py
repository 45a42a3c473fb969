"""FIX lines of g2o files: vertices that stay, beside those that stay in any case."""

from __future__ import annotations

from collections.abc import Mapping

from ..components import parts
from .graph import PoseGraph
from .node import NodeId


def pinned_lines(fixed: Mapping[NodeId, str], graph: PoseGraph) -> list[str]:
    """A sentence where FIX lines pin other nodes of ``graph`` (each with its file and line) than the first of its
    connected part, which stays by itself: the others are not held."""
    nodes = graph.nodes
    row = {node: k for k, node in enumerate(nodes)}
    known = {node: where for node, where in fixed.items() if node in row}
    if not known:
        return []
    edges = graph.arrays()
    label = parts(edges.ends[: len(graph.edges)], len(nodes))
    first = {int(label[k]): node for k, node in reversed(list(enumerate(nodes)))}
    moved = sorted(known) if graph.priors else [node for node in sorted(known) if node not in first.values()]
    if not moved:
        return []
    more = f" and {len(moved) - 1} more" if len(moved) > 1 else ""
    says = f"{known[moved[0]]}: FIX of {moved[0]}{more} is not held"
    if graph.priors:
        return [f"{says}: priors say where the graph lies"]
    if len({int(label[row[node]]) for node in known}) == len(known):
        return [f"{says}: the first node stays instead; shape and cost are the same"]
    return [f"{says}: the first node stays; EDGE_SE3_PRIOR or EDGE_PRIOR_SE2 lines hold several"]
