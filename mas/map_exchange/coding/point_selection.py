"""Which of a key-frame's map points are sold: those whose depth is known best, spread over the image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

# Cells of the direction that the points are taken from in turn: columns by rows of about equal numbers of points.
_COLUMNS, _ROWS = 6, 3
# Directions farther from the axis than this (tangent) are no camera's of this kind.
_MOST_TANGENT = 4.0


def sellable(points_C: NDArray[Any]) -> NDArray[np.bool_]:
    """``(n,)``: finite points in front of the camera."""
    p = np.asarray(points_C, dtype=np.float64)
    front = np.isfinite(p).all(axis=1) & (p[:, 2] > 1e-6)
    inside: NDArray[np.bool_] = np.abs(p[:, :2]).max(axis=1, initial=0.0) <= _MOST_TANGENT * p[:, 2]
    return front & inside


def well_spread(points_C: NDArray[Any], rows: NDArray[np.int64], limit: int) -> NDArray[np.int64]:
    """At most ``limit`` of the rows, sorted: from each cell of the image in turn the nearest that is left.

    Near points are the reliable ones: a stereo depth's error grows with its square, and a moving camera sees near
    points from the widest angle.
    """
    if len(rows) <= limit:
        return np.sort(rows)
    p = np.asarray(points_C, dtype=np.float64)[rows]
    columns = _cells(p[:, 0] / p[:, 2], np.zeros(len(p), dtype=np.int64), _COLUMNS)
    cells = columns * _ROWS + _cells(p[:, 1] / p[:, 2], columns, _ROWS)
    order = np.lexsort((rows, p[:, 2], cells))
    turn = np.arange(len(order)) - np.searchsorted(cells[order], cells[order], side="left")
    chosen = order[np.lexsort((p[order, 2], turn))[:limit]]
    return np.sort(rows[chosen])


def _cells(values: NDArray[np.float64], groups: NDArray[np.int64], count: int) -> NDArray[np.int64]:
    """Cell 0 to ``count - 1`` of each value within its group; a group's cells hold about the same number."""
    sizes = np.bincount(groups)
    order = np.lexsort((values, groups))
    rank = np.empty(len(values), dtype=np.int64)
    rank[order] = np.arange(len(values)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return rank * count // sizes[groups]
