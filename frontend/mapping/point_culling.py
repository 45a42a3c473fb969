"""Selection of a finished map's points worth writing: those found again where they should be visible."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3_inverse, transform_points

from ..cameras.models import PinholeCamera
from ..image.orb_features import EDGE_PX

Array = NDArray[np.float64]

BEFORE, AFTER = 2, 4
"""Key-frames before the first and after the last that found a point in which it had the chance."""


def found_ratio(poses: Array, points: Array, observations: NDArray[np.integer], camera: PinholeCamera) -> Array:
    """``(P,)`` key-frames that found a point over those that should have seen it (Mur-Artal et al., ORB-SLAM, 2015,
    section VI-B), 1 at most.

    ``poses`` ``(K, 4, 4)`` ``T_W_C``; ``points`` ``(P, 3)``; ``observations`` ``(N, 2)`` key-frame and point. Should
    have: those from :data:`BEFORE` the first to :data:`AFTER` the last that did, where the point projects into the part
    of the image that has key-points. What may stand in between is not asked.
    """
    keyframe, point = observations.T
    first, last = np.full(len(points), len(poses)), np.full(len(points), -1)
    np.minimum.at(first, point, keyframe)
    np.maximum.at(last, point, keyframe)
    found = np.bincount(point, minlength=len(points))
    chances = np.zeros(len(points), dtype=np.int64)
    for k, T_C_W in enumerate(se3_inverse(poses)):
        near = np.flatnonzero((k >= first - BEFORE) & (k <= last + AFTER))
        x, y, z = (transform_points(T_C_W, points[near])).T
        ahead = z > 0
        u, v = camera.fx * x[ahead] / z[ahead] + camera.cx, camera.fy * y[ahead] / z[ahead] + camera.cy
        inside = (u >= EDGE_PX) & (u < camera.width - EDGE_PX) & (v >= EDGE_PX) & (v < camera.height - EDGE_PX)
        chances[near[ahead][inside]] += 1
    return np.asarray(found / np.maximum(np.maximum(chances, found), 1), dtype=np.float64)
