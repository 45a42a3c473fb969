"""Depth at pixels from given 3-D points: each covers a few pixels, the nearest in front."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, transform_points

from ..cameras.models import PinholeCamera

_COVER = 0.008
"""Half the side of the square that a point covers, share of the image's width: scans and maps are sparse."""
_LEAST_PX = 3
_HIDDEN = 1.15
"""A point this many times as far as one around it is behind that one's surface."""
_NEAREST_M = 1e-3


def depth_of_points(T_C_W: Array, points: Array, camera: PinholeCamera, hide: bool) -> NDArray[np.float32]:
    """A depth image ``(H, W)``, in the points' unit, 0 where none is near, of ``points`` ``(n, 3)`` of the world.

    ``hide``: points may lie behind others; False: the camera is known to see them.
    """
    width, height = camera.width, camera.height
    out = np.zeros((height, width), dtype=np.float32)
    p = transform_points(T_C_W, points)
    p = p[p[:, 2] > _NEAREST_M]
    reach = max(_LEAST_PX, round(_COVER * width))
    x = np.rint(camera.fx * p[:, 0] / p[:, 2] + camera.cx)
    y = np.rint(camera.fy * p[:, 1] / p[:, 2] + camera.cy)
    near = (x >= -reach) & (y >= -reach) & (x < width + reach) & (y < height + reach)
    column, row, z = x[near].astype(np.int64), y[near].astype(np.int64), p[near, 2]
    if hide and len(z):
        seen = _in_front(column + reach, row + reach, z, (height + 2 * reach, width + 2 * reach), 2 * reach + 1)
        column, row, z = column[seen], row[seen], z[seen]
    order = np.argsort(-z, kind="stable")  # the nearest is written last
    column, row, z = column[order], row[order], z[order]
    steps = sorted(
        ((dx, dy) for dx in range(-reach, reach + 1) for dy in range(-reach, reach + 1)),
        key=lambda step: (-max(abs(step[0]), abs(step[1])), step),
    )
    for dx, dy in steps:  # middles last: there the point itself is
        u, v = column + dx, row + dy
        inside = (u >= 0) & (v >= 0) & (u < width) & (v < height)
        out[v[inside], u[inside]] = z[inside]
    return out


def _in_front(
    column: NDArray[np.int64], row: NDArray[np.int64], z: Array, size: tuple[int, int], cell: int
) -> NDArray[np.bool_]:
    """Which points ``(n,)`` have none much nearer in their cell or one of those around it."""
    rows, columns = size[0] // cell + 3, size[1] // cell + 3
    least = np.full((rows, columns), np.inf)
    at = row // cell + 1, column // cell + 1
    np.minimum.at(least, at, z)
    around = np.min(
        [np.roll(least, (dy, dx), axis=(0, 1)) for dy in (-1, 0, 1) for dx in (-1, 0, 1)], axis=0
    )  # the margin holds no points
    return np.asarray(z <= _HIDDEN * around[at])
