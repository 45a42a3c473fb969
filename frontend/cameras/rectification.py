"""Rectification: from stored images to those of an ideal pinhole or stereo pair. Maps are built once and applied to
every frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse

from ..errors import FrontendError
from .calibration import Distortion, RawCamera, RawRig
from .lens import project, unproject
from .models import PinholeCamera, RigKind

Array = NDArray[np.float64]
Maps = tuple[NDArray[np.int16], NDArray[np.uint16]]

_MAX_TANGENT = (
    2.0  # of the half field of view kept on each side (63 degrees): beyond, an ideal pinhole has hardly any pixels left
)
_BORDER_SAMPLES = 64  # points along each side of the image
_NO_VIEW = "the calibration leaves no view: the cameras look apart, or the coefficients are not those of this lens"
_GRID = 9  # points along each side of the rectified view
_LEAST_SEEN = 0.5  # of them, in each stored image: all are, but for a lens whose formula bends its corners back
_LEAST_VIEW = 0.02  # of x/z or y/z across the rectified image: a degree
_HARDLY_AHEAD = 0.01  # of a direction's length along the axis: less is 89.4 degrees off it
_OUTSIDE = -1000.0  # a column and a row that no image has
_OPENCV: dict[Distortion, Any] = {
    Distortion.NONE: cv2.initUndistortRectifyMap,
    Distortion.RADIAL_TANGENTIAL: cv2.initUndistortRectifyMap,
    Distortion.EQUIDISTANT: cv2.fisheye.initUndistortRectifyMap,
}


@dataclass(frozen=True)
class Rectifier:
    """Look-up maps of ``cv2.remap`` for the left and, in stereo, the right image; sizes are those of the stored images.

    ``depth_index`` ``(H, W)`` int64: position in the flattened stored depth whose value a rectified pixel takes, or
    -1 (RGB-D only). Depth is not interpolated: a mean across an edge would be a surface that does not exist.
    """

    left: Maps
    right: Maps | None = None
    depth_index: NDArray[np.int64] | None = None

    def rectify_left(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The left image ``(H, W)`` or ``(H, W, 3)`` rectified."""
        return _remap(image, self.left)

    def rectify_right(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The right image ``(H, W)`` rectified; stereo only."""
        return image if self.right is None else _remap(image, self.right)

    def rectify_depth(self, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
        """Depth registered to the image as stored, of the rectified image."""
        if self.depth_index is None:
            return depth_m
        return np.where(self.depth_index >= 0, depth_m.ravel()[self.depth_index], np.float32(0.0))


@dataclass(frozen=True)
class Rectification:
    """Result of rectifying a rig: the ideal camera, the baseline (stereo), the maps (None where images are ideal
    already), and ``R_rectified_left`` ``(3, 3)``, which turns the calibrated left camera's coordinates into the
    rectified one's."""

    camera: PinholeCamera
    baseline_m: float | None
    rectifier: Rectifier | None
    R_rectified_left: Array


def rectify_rig(raw: RawRig, kind: RigKind, size: tuple[int, int]) -> Rectification:
    """The ideal rig of ``raw`` used as ``kind``, for stored images of ``size`` ``(width, height)``.

    The rectified image has the stored size, square pixels, and shows only what all cameras of the rig see: no empty
    corners.
    """
    identity = np.eye(3)
    if kind is RigKind.STEREO and raw.right is not None and raw.T_left_right is not None:
        if raw.rectified:
            return Rectification(raw.left.pinhole(size), raw.baseline_m, None, identity)
        R_left, R_right, baseline = stereo_rotations(raw.T_left_right)
        camera = common_camera([(raw.left, R_left), (raw.right, R_right)], size)
        rectifier = Rectifier(_maps(raw.left, R_left, camera), _maps(raw.right, R_right, camera))
        return Rectification(camera, baseline, rectifier, R_left)
    if not raw.left.distorted:
        return Rectification(raw.left.pinhole(size), None, None, identity)
    camera = common_camera([(raw.left, identity)], size)
    depth_index = _depth_index(raw.left, camera) if kind is RigKind.RGBD else None
    return Rectification(camera, None, Rectifier(_maps(raw.left, identity, camera), depth_index=depth_index), identity)


def stereo_rotations(T_left_right: Array) -> tuple[Array, Array, float]:
    """Rotations ``(3, 3)`` of the left and the right camera into the common rectified orientation, and the baseline in
    metres.

    Each camera is turned by half their relative rotation, then both so that x runs along the baseline (Bouguet's
    method, as ``cv2.stereoRectify``). A right camera that stands left of the left one gives a negative baseline.
    """
    T_right_left = se3_inverse(T_left_right)
    none, K = np.zeros(4), np.eye(3)
    rotation, position = T_right_left[:3, :3].copy(), T_right_left[:3, 3:].copy()
    R_left, R_right, *_ = cv2.stereoRectify(K, none, K, none, (2, 2), rotation, position)
    return np.asarray(R_left), np.asarray(R_right), float(product(R_left, T_left_right[:3, 3])[0])


def common_camera(cameras: list[tuple[RawCamera, Array]], size: tuple[int, int]) -> PinholeCamera:
    """The pinhole with square pixels, of the largest field of view that all ``cameras``, each turned by its
    rotation, fill entirely. :class:`FrontendError` where that is nothing."""
    width, height = size
    low, high = np.full(2, -_MAX_TANGENT), np.full(2, _MAX_TANGENT)
    for camera, rotation in cameras:
        inner_low, inner_high = _inner_rectangle(camera, rotation, size)
        low, high = np.maximum(low, inner_low), np.minimum(high, inner_high)
    if (high - low).min() < _LEAST_VIEW:
        raise FrontendError(_NO_VIEW)
    extent = np.array([width - 1.0, height - 1.0])
    focal = float((extent / (high - low)).max())
    # The axis with room to spare is placed so that the optical axis stays as near to the middle as it can.
    centre = np.clip(extent / 2.0, extent - focal * high, -focal * low)
    ideal = PinholeCamera(width, height, focal, focal, float(centre[0]), float(centre[1]))
    if min(_seen_share(camera, rotation, ideal, size) for camera, rotation in cameras) < _LEAST_SEEN:
        raise FrontendError(_NO_VIEW)
    return ideal


def _seen_share(camera: RawCamera, rotation: Array, ideal: PinholeCamera, size: tuple[int, int]) -> float:
    """Share of the rectified view that the stored image shows: a border without a direction ahead is that of a wide
    lens, or of a camera that looks away."""
    across, down = np.meshgrid(np.linspace(0, ideal.width - 1, _GRID), np.linspace(0, ideal.height - 1, _GRID))
    x, y = (across - ideal.cx) / ideal.fx, (down - ideal.cy) / ideal.fy
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
    pixels = project(camera, product(rays, rotation))
    return float(((pixels > -1.0) & (pixels < np.array(size))).all(axis=1).mean())


def _inner_rectangle(camera: RawCamera, rotation: Array, size: tuple[int, int]) -> tuple[Array, Array]:
    """Lowest and highest x/z, y/z ``(2,)`` between which every direction lies inside the image."""
    width, height = size
    along_x, along_y = np.linspace(0, width - 1, _BORDER_SAMPLES), np.linspace(0, height - 1, _BORDER_SAMPLES)
    top = _directions(camera, rotation, along_x, np.zeros(_BORDER_SAMPLES))
    bottom = _directions(camera, rotation, along_x, np.full(_BORDER_SAMPLES, height - 1.0))
    left = _directions(camera, rotation, np.zeros(_BORDER_SAMPLES), along_y)
    right = _directions(camera, rotation, np.full(_BORDER_SAMPLES, width - 1.0), along_y)
    low = np.array([left[:, 0].max(initial=-np.inf), top[:, 1].max(initial=-np.inf)])
    high = np.array([right[:, 0].min(initial=np.inf), bottom[:, 1].min(initial=np.inf)])
    return low, high


def _directions(camera: RawCamera, rotation: Array, u: Array, v: Array) -> Array:
    """``x/z, y/z`` ``(n, 2)`` in the turned camera of those stored pixels ``u``, ``v`` that look ahead: the border of
    a wide lens looks sideways or back, or shows nothing, and bounds no pinhole."""
    rays = product(unproject(camera, np.stack([u, v], axis=1)), rotation.T)
    ahead = rays[rays[:, 2] > _HARDLY_AHEAD]
    return ahead[:, :2] / ahead[:, 2:]


def _float_maps(
    camera: RawCamera, rotation: Array, ideal: PinholeCamera
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Column and row of the stored image for each rectified pixel."""
    coefficients, size = np.array(camera.coefficients, dtype=np.float64), (ideal.width, ideal.height)
    make = _OPENCV.get(camera.distortion)
    if make is not None:
        return make(camera.K, coefficients, rotation, ideal.K, size, cv2.CV_32FC1)
    x, maps = (np.arange(ideal.width) - ideal.cx) / ideal.fx, np.empty((2, ideal.height, ideal.width), np.float32)
    for row in range(ideal.height):  # one at a time: directions of all pixels of a large image would fill the memory
        rays = np.column_stack([x, np.full(len(x), (row - ideal.cy) / ideal.fy), np.ones(len(x))])
        maps[:, row] = np.nan_to_num(project(camera, product(rays, rotation)), nan=_OUTSIDE).T
    return maps[0], maps[1]


def _maps(camera: RawCamera, rotation: Array, ideal: PinholeCamera) -> Maps:
    return cv2.convertMaps(*_float_maps(camera, rotation, ideal), cv2.CV_16SC2)


def _depth_index(camera: RawCamera, ideal: PinholeCamera) -> NDArray[np.int64]:
    column, row = (np.rint(m).astype(np.int64) for m in _float_maps(camera, np.eye(3), ideal))
    inside = (column >= 0) & (column < ideal.width) & (row >= 0) & (row < ideal.height)
    return np.where(inside, row * ideal.width + column, -1)


def _remap(image: NDArray[np.uint8], maps: Maps) -> NDArray[np.uint8]:
    return cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR).astype(np.uint8, copy=False)
