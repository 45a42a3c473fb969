"""Poses as they are before elimination: what neighbours need of them to know what the graph costs."""

from __future__ import annotations

import numpy as np

from ..compact import CompactReader, CompactWriter
from ..local import LocalProblem
from ..share import Share
from .front import Front


class StartingPoses:
    """Own poses, and neighbours' shared ones once they are taken in. ``awaited``: neighbours whose poses are needed;
    none in a warm start, where the first pass tells the cost."""

    def __init__(self, share: Share, warm: bool) -> None:
        self._local = LocalProblem(share)
        others = [] if warm else share.neighbours
        self._lower = [n for n in others if n < share.robot]
        self.awaited = [n for n in others if n > share.robot]

    def bodies(self) -> dict[int, bytes]:
        """For each neighbour that needs them the poses that it shares."""
        return {n: self._body_for(n) for n in self._lower}

    def take(self, neighbour: int, body: bytes) -> None:
        """Take a neighbour's poses in."""
        rows = len(self._local.received_rows[neighbour])
        values = CompactReader(body).array(rows * self._local.width, "<f4")
        self._local.receive_places(neighbour, values.reshape(rows, -1))

    def cost(self) -> float:
        """F over the edges that this robot counts."""
        return self._local.cost()

    def cost_aside(self, front: Front) -> float:
        """F over the edges of poses that are not tied to the anchor, which stay: what this robot counts of it."""
        local = self._local
        lost = np.zeros(len(local), dtype=bool)
        lost[: local.own_count] = ~front.reached[: front.own_count]
        aside = local.counted & lost[local.edges.ends].any(axis=1)
        costs = local.edges.only(aside).costs(local.places.poses, local.places.log_units)
        return float(costs[np.isfinite(costs)].sum())

    def _body_for(self, neighbour: int) -> bytes:
        out = CompactWriter()
        out.array(self._local.separator_places(neighbour), "<f4")
        return out.bytes()
