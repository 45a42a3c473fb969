"""The only place that calls pycolmap: robust absolute pose by P3P and LO-RANSAC."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RansacLimits:
    """``max_error_px``: reprojection error of an inlier; ``min_inliers``: below, there is no pose; trials: fewest and
    most."""

    max_error_px: float
    min_inliers: int
    confidence: float
    min_trials: int
    max_trials: int


def absolute_pose(
    points: Array, uv: Array, pinhole: tuple[float, float, float, float], limits: RansacLimits, seed: int, refine: bool
) -> Array | None:
    """``T_C_W`` ``(3, 4)`` of a camera that sees ``points`` ``(n, 3)`` at ``uv`` ``(n, 2)`` pixels, most or few of them
    right; None where too few agree.

    ``pinhole``: fx, fy, cx, cy. COLMAP puts the centre of the first pixel at (0.5, 0.5); as a camera's own numbers and
    its key-points move together, nothing needs to be converted. ``refine``: by least squares on the inliers at the end.
    Same points and seed, same pose. LO-RANSAC: Chum, Matas and Kittler, DAGM 2003.
    """
    import pycolmap

    if len(points) < limits.min_inliers:
        return None
    width, height = (int(2 * c) + 2 for c in pinhole[2:])
    camera = pycolmap.Camera(model="PINHOLE", width=width, height=height, params=list(pinhole))
    options = pycolmap.AbsolutePoseEstimationOptions()
    options.ransac.max_error, options.ransac.random_seed = limits.max_error_px, seed
    options.ransac.confidence = limits.confidence
    options.ransac.min_num_trials, options.ransac.max_num_trials = limits.min_trials, limits.max_trials
    estimate = pycolmap.estimate_and_refine_absolute_pose if refine else pycolmap.estimate_absolute_pose
    found = estimate(uv, points, camera, options)
    if found is None or found["num_inliers"] < limits.min_inliers:
        return None
    T_C_W = np.asarray(found["cam_from_world"].matrix(), dtype=np.float64)
    return T_C_W if np.isfinite(T_C_W).all() else None
