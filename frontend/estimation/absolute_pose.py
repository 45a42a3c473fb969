"""Pose of a camera from map points, most or few of them right, without a prediction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam import _pycolmap
from maslam.backend.geometry import se3

Array = NDArray[np.float64]
_MIN_INLIERS, _CONFIDENCE = 6, 0.999
_MIN_TRIALS, _MAX_TRIALS = 30, 2000
_SEED = 1


def absolute_pose(points: Array, uv: Array, cam: Array, threshold_px: float) -> Array | None:
    """``T_C_W`` ``(4, 4)`` of a camera that sees ``points`` ``(n, 3)`` at ``uv`` ``(n, 2)`` pixels, by LO-RANSAC; None
    where fewer than six agree within ``threshold_px``.

    ``cam`` begins with fx, fy, cx, cy. The seed is fixed: same points, same pose.
    """
    fx, fy, cx, cy = cam[:4].tolist()
    limits = _pycolmap.RansacLimits(threshold_px, _MIN_INLIERS, _CONFIDENCE, _MIN_TRIALS, _MAX_TRIALS)
    T_C_W = _pycolmap.absolute_pose(points, uv, (fx, fy, cx, cy), limits, _SEED, refine=True)
    return None if T_C_W is None else se3(T_C_W[:, :3], T_C_W[:, 3])
