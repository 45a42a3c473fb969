"""Points of a key-frame in few bytes: directions and inverse depths on a grid, and the choice of those worth sending.

A point is 32 bits: 11 for each of x / z and y / z over the range that the view has, 10 for its inverse depth over
that of the view. A camera of 80 degrees gets steps of 0.04 degrees, a quarter of a key-point's noise; a stereo point's
inverse depth has the same error everywhere, as the grid has.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import BackendError
from ..geometry import Array
from .matching import hamming_distances
from .verification import PlaceView

PointCode = Literal["float", "grid"]
BITS = (11, 11, 10)
RANGES = 6
"""Numbers that say what the grid spans: low and high of x / z, y / z and 1 / z."""
_CELLS = 8  # across and down, for the spread of the chosen points


def pack_points(points_C: Array) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
    """Ranges ``(6,)`` and codes ``(n,)`` of points ``(n, 3)`` in front of the camera (z > 0)."""
    if len(points_C) and points_C[:, 2].min() <= 0:
        raise BackendError("points behind the camera have no code")
    if not len(points_C):
        return np.zeros(RANGES, dtype=np.float32), np.zeros(0, dtype=np.uint32)
    inverse = 1.0 / points_C[:, 2]
    values = np.stack([points_C[:, 0] * inverse, points_C[:, 1] * inverse, inverse], axis=1)
    ranges = np.stack([values.min(axis=0), values.max(axis=0)]).astype(np.float32)
    low, high = ranges.astype(np.float64)
    # The inverse depth's grid begins at 0, so that no point comes out at infinity.
    low[2] = 0.0
    ranges[0, 2] = 0.0
    codes = np.zeros(len(points_C), dtype=np.uint32)
    for k, bits in enumerate(BITS):
        steps = 2**bits - 1
        cell = np.rint((values[:, k] - low[k]) / max(high[k] - low[k], 1e-12) * steps)
        codes = (codes << np.uint32(bits)) | cell.clip(1 if k == 2 else 0, steps).astype(np.uint32)
    return ranges.ravel(), codes


def unpack_points(ranges: NDArray[np.float32], codes: NDArray[np.uint32]) -> Array:
    """Inverse of :func:`pack_points`, up to the grid."""
    low, high = np.asarray(ranges, dtype=np.float64).reshape(2, 3)
    values, rest = np.empty((len(codes), 3)), codes.astype(np.uint32)
    for k in (2, 1, 0):
        steps = 2 ** BITS[k] - 1
        values[:, k] = low[k] + (rest & np.uint32(steps)) / steps * (high[k] - low[k])
        rest = rest >> np.uint32(BITS[k])
    z = 1.0 / np.maximum(values[:, 2], 1e-9)
    return np.stack([values[:, 0] * z, values[:, 1] * z, z], axis=1)


def worth_sending(points_C: Array, descriptors: NDArray[np.uint8], count: int) -> NDArray[np.intp]:
    """At most ``count`` rows of a view, the best first: spread over the image, and of each part first those that look
    least like any other point of the view. A brick of a wall says little about where one is."""
    n = len(points_C)
    if n < 2:
        return np.arange(n)
    distances = hamming_distances(descriptors, descriptors).copy()
    np.fill_diagonal(distances, 8 * descriptors.shape[1] + 1)
    alone = distances.min(axis=1)
    plane = points_C[:, :2] / np.maximum(points_C[:, 2:], 1e-9)
    low, high = plane.min(axis=0), plane.max(axis=0)
    cells = ((plane - low) / np.maximum(high - low, 1e-12) * _CELLS).astype(int).clip(0, _CELLS - 1)
    cell = cells[:, 0] * _CELLS + cells[:, 1]
    order = np.lexsort((-alone, cell))
    first = np.searchsorted(cell[order], np.arange(_CELLS**2))
    rank = np.empty(n, dtype=np.intp)
    rank[order] = np.arange(n) - first[cell[order]]
    return np.lexsort((np.arange(n), -alone, rank))[:count]


def as_sent(view: PlaceView, count: int, code: PointCode, descriptor_bytes: int) -> tuple[PlaceView, int]:
    """The receiver's copy of a view sent with at most ``count`` points (0: all), and the bytes of its points."""
    points, words, descriptors = view.points_C, view.words, view.descriptors
    rows = np.arange(len(points))
    if count and descriptors is not None:
        rows = worth_sending(points, descriptors, count)
    elif count < len(points) and count:
        rows = np.linspace(0, len(points) - 1, count).astype(np.intp)
    points = points[rows]
    if code == "grid":
        points = unpack_points(*pack_points(points))
    each = (4 if code == "grid" else 12) + (2 if descriptors is None else descriptor_bytes)
    arrived = PlaceView(
        points,
        descriptors=None if descriptors is None else descriptors[rows, :descriptor_bytes],
        words=None if words is None else words[rows],
        metric=view.metric,
        depth_known=None if view.depth_known is None else view.depth_known[rows],
    )
    return arrived, len(rows) * each + (4 * RANGES if code == "grid" else 0)
