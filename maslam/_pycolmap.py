"""The only place that calls pycolmap: robust absolute pose by P3P and LO-RANSAC, self-calibration by structure from
motion."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from ._quiet_import import signals_kept

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


def _library() -> ModuleType:
    """pycolmap, imported when first needed, without its handlers of signals."""
    with signals_kept() if "pycolmap" not in sys.modules else nullcontext():
        import pycolmap
    return pycolmap


def absolute_pose(
    points: Array, uv: Array, pinhole: tuple[float, float, float, float], limits: RansacLimits, seed: int, refine: bool
) -> Array | None:
    """``T_C_W`` ``(3, 4)`` of a camera that sees ``points`` ``(n, 3)`` at ``uv`` ``(n, 2)`` pixels, most or few of them
    right; None where too few agree.

    ``pinhole``: fx, fy, cx, cy. COLMAP puts the centre of the first pixel at (0.5, 0.5); as a camera's own numbers and
    its key-points move together, nothing needs to be converted. ``refine``: by least squares on the inliers at the end.
    Same points and seed, same pose. LO-RANSAC: Chum, Matas and Kittler, DAGM 2003.
    """
    pycolmap = _library()
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


@dataclass(frozen=True)
class SelfCalibration:
    """A reconstruction with the camera left free, from one first guess: ``focal_px``, the radial coefficient ``k1``,
    ``images`` placed, ``points``, their mean reprojection error ``error_px``; ``turned_deg``: largest angle between two
    optical axes."""

    focal_px: float
    k1: float
    images: int
    points: int
    error_px: float
    turned_deg: float


class SelfCalibrator:
    """Structure from motion on a few grey images of one camera in order of time, for its focal length and ``k1``. One
    thread, fixed seeds: same images, same result (COLMAP: Schönberger and Frahm, CVPR 2016).

    ``centre``: its principal point, in COLMAP's pixels (the first one's centre at (0.5, 0.5)); ``folder``: an empty
    one, for what it needs on disk.
    """

    _NEIGHBOURS = 5

    def __init__(
        self, images: Sequence[NDArray[np.uint8]], centre: tuple[float, float], folder: Path, features: int = 1500
    ) -> None:
        import cv2

        pycolmap = _library()
        pycolmap.logging.minloglevel = 3
        self._images, self._made, self._database = folder / "images", folder / "made", folder / "database.db"
        self._images.mkdir()
        names = [f"{i:04d}.png" for i in range(len(images))]
        for name, image in zip(names, images, strict=True):
            cv2.imwrite(str(self._images / name), image)
        self._centre = centre
        extraction = pycolmap.FeatureExtractionOptions()
        extraction.num_threads, extraction.use_gpu = 1, False
        extraction.sift.max_num_features = features
        pycolmap.extract_features(
            self._database,
            self._images,
            image_names=names,
            camera_mode=pycolmap.CameraMode.SINGLE,
            reader_options=pycolmap.ImageReaderOptions(camera_model="SIMPLE_RADIAL"),
            extraction_options=extraction,
        )
        matching, pairing = pycolmap.FeatureMatchingOptions(), pycolmap.SequentialPairingOptions()
        matching.num_threads, matching.use_gpu = 1, False
        pairing.overlap, pairing.quadratic_overlap = self._NEIGHBOURS, True
        pycolmap.match_sequential(self._database, matching_options=matching, pairing_options=pairing)

    def run(self, focal_px: float) -> SelfCalibration | None:
        """Begin with this focal length; None where nothing could be reconstructed."""
        pycolmap = _library()
        with pycolmap.Database.open(self._database) as database:
            camera = database.read_all_cameras()[0]
            camera.params = [focal_px, *self._centre, 0.0]
            database.update_camera(camera)
        options = pycolmap.IncrementalPipelineOptions()
        options.num_threads, options.random_seed, options.multiple_models = 1, 0, False
        self._made.mkdir(exist_ok=True)
        models = pycolmap.incremental_mapping(self._database, self._images, self._made, options=options)
        if not models:
            return None
        best = max(models.values(), key=lambda model: model.num_reg_images())
        params = next(iter(best.cameras.values())).params
        axes = np.stack(
            [image.cam_from_world().rotation.matrix()[2] for image in best.images.values() if image.has_pose]
        )
        turned = float(np.degrees(np.arccos(np.clip((axes @ axes.T).min(), -1.0, 1.0))))
        error = float(best.compute_mean_reprojection_error())
        found = best.num_reg_images(), best.num_points3D()
        return SelfCalibration(float(params[0]), float(params[3]), *found, error, turned)
