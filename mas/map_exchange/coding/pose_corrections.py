"""Corrections of many poses, interpolated between a few of them.

After an optimisation old key-frames move together, each by a little more or less than the one before it. So the motion
of only a few of them, anchors, is sent; between two the correction is interpolated, in whole numbers. Anchors are
added where that is off by more than a :class:`Bound`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .quantised_map import Ints


@dataclass(frozen=True)
class Bound:
    """Largest difference of a copy's pose from the owner's, in quantisation steps; ``rotation``: of its unit, too."""

    position: int = 4
    rotation: int = 4

    def worst(self, off: Ints) -> NDArray[np.float64]:
        """``(K,)`` of ``(K, 6)`` or ``(K, 7)``: above 1 where it is exceeded."""
        shares = np.abs(off) / np.repeat([self.position, self.rotation], [3, off.shape[1] - 3])
        worst: NDArray[np.float64] = shares.max(axis=1, initial=0.0)
        return worst


def anchors_for(moves: Ints, bound: Bound) -> NDArray[np.intp]:
    """The fewest anchors that bisecting at the worst key-frame finds for corrections ``(K, c)`` within the bound."""
    last = len(moves) - 1
    chosen = sorted({0, last})
    while True:
        off = bound.worst(moves - interpolated(moves[chosen], np.array(chosen), len(moves)))
        if off.max(initial=0.0) <= 1.0:
            return np.array(chosen, dtype=np.intp)
        chosen = sorted({*chosen, int(off.argmax())})


def interpolated(at_anchors: Ints, anchors: NDArray[np.intp], count: int) -> Ints:
    """Corrections ``(count, c)`` between those of the anchors ``(a, c)``; the first and last row are anchors."""
    rows = np.arange(count)
    right = np.clip(np.searchsorted(anchors, rows, side="left"), min(1, len(anchors) - 1), len(anchors) - 1)
    left = np.maximum(right - 1, 0)
    width = np.maximum(anchors[right] - anchors[left], 1)[:, None]
    share = (rows - anchors[left])[:, None]
    out: Ints = at_anchors[left] + (2 * share * (at_anchors[right] - at_anchors[left]) + width) // (2 * width)
    return out
