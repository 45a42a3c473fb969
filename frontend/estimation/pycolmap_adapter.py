"""The only place of the front end that calls pycolmap: robust absolute pose by LO-RANSAC."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3

Array = NDArray[np.float64]
_MIN_INLIERS = 6
_SEED = 1
_MIN_TRIALS, _MAX_TRIALS = 30, 2000


def absolute_pose(points: Array, uv: Array, intrinsics: Array, threshold_px: float) -> Array | None:
    """``T_C_W`` ``(4, 4)`` of a camera that sees ``points`` ``(n, 3)`` at ``uv`` ``(n, 2)`` pixels, most or few of them
    right; None where fewer than six agree.

    ``intrinsics``: fx, fy, cx, cy. COLMAP puts the centre of the first pixel at (0.5, 0.5); as a camera's own numbers
    and its key-points move together, nothing needs to be converted. The seed is fixed: same points, same pose.
    """
    import pycolmap

    if len(points) < _MIN_INLIERS:
        return None
    width, height = (int(2 * c) + 2 for c in intrinsics[2:4])
    camera = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=list(intrinsics[:4]))
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error = threshold_px
    options.ransac.random_seed = _SEED
    options.ransac.confidence = 0.999
    options.ransac.min_num_trials, options.ransac.max_num_trials = _MIN_TRIALS, _MAX_TRIALS
    found = pycolmap.estimate_and_refine_absolute_pose(uv, points, camera, options)
    if found is None or found["num_inliers"] < _MIN_INLIERS:
        return None
    T_C_W = found["cam_from_world"].matrix()
    if not np.isfinite(T_C_W).all():
        return None
    return se3(T_C_W[:, :3], T_C_W[:, 3])
