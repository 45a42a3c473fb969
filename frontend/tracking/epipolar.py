"""Where points of unknown position may be: on their epipolar line, at the depth of their neighbours."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product

from ..mapping.range_sensor import Ranging

Array = NDArray[np.float64]
_EPIPOLAR_PX = 2.0
_NEIGHBOURS = 3
"""Points of known position that tell how far what lies between them may be."""
_FAR, _NEAREST = 1e6, 1e-6


def on_epipolar_line(ranging: Ranging, T_C1_C0: Array, before: Array, after: Array) -> NDArray[np.bool_]:
    """Whether points at ``before`` ``(n, 2)`` in one frame can be at ``after`` ``(n, 2)`` in the next, pixels."""
    a, b = ranging.rays(before), ranging.rays(after)
    if np.linalg.norm(T_C1_C0[:3, 3]) < 1e-9:
        return np.ones(len(after), dtype=bool)
    line = np.cross(T_C1_C0[:3, 3], product(a, T_C1_C0[:3, :3].T))
    scale = np.hypot(line[:, 0], line[:, 1]) / ranging.cam[0]
    return np.asarray(np.abs((line * b).sum(axis=1)) < _EPIPOLAR_PX * scale + 1e-12)


def depth_around(uv: Array, known_uv: Array, depth: Array) -> Array:
    """Depth ``(n,)`` at pixels ``uv`` ``(n, 2)``: the median of the nearest of the pixels ``known_uv`` ``(m, 2)``
    of known ``depth`` ``(m,)``; far where there are too few."""
    if len(known_uv) < _NEIGHBOURS:
        return np.full(len(uv), _FAR)
    apart = ((uv[:, None] - known_uv[None]) ** 2).sum(axis=2)
    nearest = np.argpartition(apart, _NEIGHBOURS - 1, axis=1)[:, :_NEIGHBOURS]
    return np.maximum(np.median(depth[nearest], axis=1), _NEAREST)
