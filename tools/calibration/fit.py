"""A camera fitted to views of a board, and how far its numbers can be trusted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.frontend.cameras.calibration import Distortion, RawCamera

from ..common.errors import ToolError
from .board import Array
from .views import BoardView

FEWEST_VIEWS = 8
_TILT_DEG = 15.0
"""Slants of the board that differ by less leave focal length and distance apart open."""
_FOCAL_SHARE = 0.02
"""Standard deviation of a focal length, as a share of it, from which it is not known."""
_RMS_PX = 3.0
_WORSE, _WORSE_PX = 3.0, 0.5
"""Times the median error of all views, and pixels, beyond which a view is left out: the board was bent, or blurred."""
NAMES = {
    Distortion.RADIAL_TANGENTIAL: ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3"),
    Distortion.EQUIDISTANT: ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"),
}
"""Parameters of a model, in the order of their standard deviations."""


@dataclass(frozen=True)
class FittedCamera:
    """``camera`` with the standard deviations ``sigma`` of its parameters, in the order of :data:`NAMES`; ``rms_px`` of
    both coordinates together, all views; ``view_rms_px`` of each of ``views``; ``residuals`` ``(n, 2)`` of each, seen
    minus expected; ``tilt_deg``: largest angle between two slants of the board."""

    camera: RawCamera
    sigma: tuple[float, ...]
    rms_px: float
    views: tuple[BoardView, ...]
    view_rms_px: tuple[float, ...]
    residuals: tuple[Array, ...]
    tilt_deg: float

    @property
    def parameters(self) -> dict[str, tuple[float, float]]:
        """Each parameter with its standard deviation."""
        one = self.camera
        values = (one.fx, one.fy, one.cx, one.cy, *one.coefficients)
        return dict(zip(NAMES[one.distortion], zip(values, self.sigma, strict=True), strict=False))


def fit_camera(views: Sequence[BoardView], size: tuple[int, int], model: Distortion, k3: bool) -> FittedCamera:
    """The camera by all ``views``, then without those that fit badly. ``k3``: radial-tangential with a fifth
    coefficient. ``ToolError`` where the views do not determine it."""
    if len(views) < FEWEST_VIEWS:
        raise ToolError(f"only {len(views)} sharp views of the board; {FEWEST_VIEWS} are needed, of different slants")
    fitted = _fit(views, size, model, k3)
    limit = max(_WORSE * float(np.median(fitted.view_rms_px)), _WORSE_PX)
    good = [view for view, rms in zip(views, fitted.view_rms_px, strict=True) if rms <= limit]
    if FEWEST_VIEWS <= len(good) < len(views):
        fitted = _fit(good, size, model, k3)
    _refuse_unknown(fitted)
    return fitted


def _refuse_unknown(fitted: FittedCamera) -> None:
    camera = fitted.camera
    if fitted.rms_px > _RMS_PX:
        raise ToolError(
            f"the board does not fit: {fitted.rms_px:.1f} px root mean square, {_RMS_PX:.0f} at most; are --points and "
            "--model right, is the board flat?"
        )
    if fitted.tilt_deg < _TILT_DEG:
        raise ToolError(
            f"the views are too alike: the board's slants differ by {fitted.tilt_deg:.0f} degrees at most, "
            f"{_TILT_DEG:.0f} are needed; tilt the board in both directions"
        )
    worst = max(fitted.sigma[0] / camera.fx, fitted.sigma[1] / camera.fy)
    if not worst <= _FOCAL_SHARE:
        raise ToolError(
            f"the views do not tell the focal length: known to {100 * worst:.1f} %, {100 * _FOCAL_SHARE:.0f} % are "
            "needed; tilt the board more, and come closer"
        )


def _fit(views: Sequence[BoardView], size: tuple[int, int], model: Distortion, k3: bool) -> FittedCamera:
    points = [view.points.astype(np.float32) for view in views]
    seen = [view.uv.astype(np.float32) for view in views]
    try:
        if model is Distortion.EQUIDISTANT:
            K, coefficients, turns, shifts = _fit_equidistant(points, seen, size)
        else:
            flags = 0 if k3 else cv2.CALIB_FIX_K3
            _, K, found, turns, shifts = cv2.calibrateCamera(points, seen, size, None, None, flags=flags)
            coefficients = tuple(np.ravel(found)[: 5 if k3 else 4].tolist())
    except cv2.error as error:
        raise ToolError(
            f"no {model} camera fits these views: more, and more varied, are needed (OpenCV: "
            f"{' '.join(str(error.err).split())})"
        ) from error
    camera = RawCamera(K[0, 0], K[1, 1], K[0, 2], K[1, 2], size, model, coefficients)
    poses = [(np.ravel(w).astype(float), np.ravel(t).astype(float)) for w, t in zip(turns, shifts, strict=True)]
    shown = [_project(camera, view.points, *pose) for view, pose in zip(views, poses, strict=True)]
    residuals = tuple(np.asarray(view.uv - uv) for view, (uv, _, _) in zip(views, shown, strict=True))
    squares = sum(float((r**2).sum()) for r in residuals)
    count = sum(len(r) for r in residuals)
    if not np.isfinite(squares):
        raise ToolError(f"no {model} camera fits these views: more and more varied views are needed")
    variance = squares / max(2 * count - 6 * len(views) - len(NAMES[model]), 1)
    return FittedCamera(
        camera,
        _sigma([(inner, outer) for _, inner, outer in shown], variance),
        float(np.sqrt(squares / count)),
        tuple(views),
        tuple(float(np.sqrt((r**2).sum(axis=1).mean())) for r in residuals),
        residuals,
        _largest_tilt([cv2.Rodrigues(turn)[0][:, 2] for turn, _ in poses]),
    )


def _fit_equidistant(
    points: list[NDArray[np.float32]], seen: list[NDArray[np.float32]], size: tuple[int, int]
) -> tuple[Array, tuple[float, ...], Sequence[Array], Sequence[Array]]:
    flags = sum(
        getattr(cv2.fisheye, name, None) or getattr(cv2, name)
        for name in ("CALIB_RECOMPUTE_EXTRINSIC", "CALIB_FIX_SKEW")
    )
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    K, k = np.zeros((3, 3)), np.zeros((4, 1))
    _, K, k, turns, shifts = cv2.fisheye.calibrate(
        [p[None].astype(np.float64) for p in points],
        [uv[None].astype(np.float64) for uv in seen],
        size,
        K,
        k,
        flags=flags,
        criteria=criteria,
    )
    return np.asarray(K, dtype=np.float64), tuple(np.ravel(k).tolist()), turns, shifts


def _project(camera: RawCamera, points: Array, turn: Array, shift: Array) -> tuple[Array, Array, Array]:
    """Pixels ``(n, 2)`` of ``points``, with the Jacobians ``(2n, C)`` by the camera and ``(2n, 6)`` by the pose."""
    coefficients = np.array(camera.coefficients)
    if camera.distortion is Distortion.EQUIDISTANT:
        uv, J = cv2.fisheye.projectPoints(points[:, None], turn, shift, camera.K, coefficients)[:2]
        inner, outer = J[:, :8], J[:, 8:14]
    else:
        uv, J = cv2.projectPoints(points, turn, shift, camera.K, coefficients)
        inner, outer = J[:, 6 : 10 + len(coefficients)], J[:, :6]
    return np.asarray(uv, dtype=np.float64).reshape(-1, 2), np.asarray(inner), np.asarray(outer)


def _sigma(jacobians: Sequence[tuple[Array, Array]], variance: float) -> tuple[float, ...]:
    """Standard deviations of the camera's parameters when all poses are free."""
    count = jacobians[0][0].shape[1]
    information = np.zeros((count, count))
    for inner, outer in jacobians:
        across = inner.T @ outer
        information += inner.T @ inner - across @ np.linalg.pinv(outer.T @ outer) @ across.T
    return tuple(np.sqrt(np.maximum(np.diag(np.linalg.pinv(information)), 0.0) * variance).tolist())


def _largest_tilt(normals: Sequence[Array]) -> float:
    """Largest angle, degrees, between two normals of the board in the camera's frame."""
    stacked = np.stack(normals)
    return float(np.degrees(np.arccos(np.clip((stacked @ stacked.T).min(), -1.0, 1.0))))
