"""Irregularities of a pose graph that a user should know before trusting its figures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..pose_graph.graph import NodeId, PoseGraph
from .linear import indefinite
from .trust_region import named_parts

_SHOWN = 3
"""Nodes named of those that are counted."""


@dataclass(frozen=True)
class GraphReport:
    """``parts``: connected parts. ``indefinite``: edges (positions in ``edges``, priors after them) whose information
    has a negative eigenvalue and is made semidefinite; ``weightless`` of them and of others: those whose rotation or
    translation then has next to no weight in F. ``without_odometry``: nodes to which no odometry leads from the node
    before. ``repeated``: pairs of nodes with more than one edge.
    """

    parts: int
    indefinite: tuple[int, ...]
    weightless: tuple[int, ...]
    without_odometry: tuple[NodeId, ...]
    repeated: tuple[tuple[NodeId, NodeId], ...]

    def lines(self) -> list[str]:
        """One sentence for each thing that is odd; none for an ordinary graph."""
        found = [
            (self.parts > 1, f"{self.parts} parts that no edge joins"),
            (self.indefinite, f"{len(self.indefinite)} edges with indefinite information, made semidefinite"),
            (self.weightless, f"{len(self.weightless)} edges without information on rotation or translation"),
            (
                self.without_odometry,
                f"{len(self.without_odometry)} nodes without odometry from the node before: "
                f"{_shown(list(map(str, self.without_odometry)))}",
            ),
            (
                self.repeated,
                f"{len(self.repeated)} pairs of nodes with more than one edge: "
                f"{_shown([f'{i} and {j}' for i, j in self.repeated])}",
            ),
        ]
        return [text for true, text in found if true]


def _shown(names: Sequence[str]) -> str:
    return ", ".join(names[:_SHOWN]) + (f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else "")


def report(graph: PoseGraph) -> GraphReport:
    """Look at every edge and node once."""
    a, d = graph.arrays(), graph.dimension
    odometry = {max(e.i, e.j) for e in graph.edges if e.kind == "odometry"}
    firsts = {min(n for n in graph.poses if n.robot == r) for r in graph.robots}
    pairs = Counter((min(e.i, e.j), max(e.i, e.j)) for e in graph.edges)
    return GraphReport(
        parts=len(np.unique(named_parts(a))),
        indefinite=tuple(np.flatnonzero(indefinite(a.information)).tolist()) if len(a.ends) else (),
        weightless=tuple(np.flatnonzero(_weightless(a.information, d)).tolist()) if len(a.ends) else (),
        without_odometry=tuple(n for n in graph.nodes if n not in odometry and n not in firsts),
        repeated=tuple(sorted(pair for pair, count in pairs.items() if count > 1)),
    )


def _weightless(information: np.ndarray, d: int) -> np.ndarray:
    """Edges whose smallest eigenvalue on translation or rotation is next to nothing beside the largest."""
    rotation = information[:, 5:, 5:] if d == 2 else information[:, 3:, 3:]
    out = np.zeros(len(information), dtype=bool)
    for block in (information[:, :d, :d], rotation):
        values = np.linalg.eigvalsh(0.5 * (block + np.swapaxes(block, 1, 2)))
        out |= values[:, 0] <= 1e-12 * np.maximum(values[:, -1], 1e-300)
    return out
