"""Disparity or depth at key-points: the measurement that gives a rig its metric scale."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel
from maslam.backend.geometry import transform_points

from ..cameras.models import Rig, RigKind
from ..config import FlowConfig, StereoConfig
from ..estimation.depth_alignment import Surface, surface
from ..estimation.self_calibration import (
    N_ALL,
    N_RADIAL,
    CalibrationFilter,
    distort,
    pair_shift,
    physical,
    prior_information,
    undistort,
)
from ..frames import Frame
from ..image.patch_alignment import align, cut_patches, half_sized
from ..image.used_pixels import are_used

_COARSE_LEVEL = 2
_COARSE = 2**_COARSE_LEVEL
"""The first search runs on images this much smaller, whole pixels only; flow refines it."""
_HALF = 3
_MIN_RAW_PX = -8.0
"""What lies at infinity has a negative disparity in a rig whose cameras squint."""
_NEGATIVE = 2
"""Reduced pixels that a disparity may be below zero: rigs that squint."""


def coarse_disparity(
    left: NDArray[np.uint8], right: NDArray[np.uint8], xy: NDArray[np.float64], reach: int, rows: int
) -> NDArray[np.float64]:
    """Whole-pixel disparity and row offset ``(n, 2)`` of the best zero-mean SAD match along (nearly) the same row."""
    side = (2 * _HALF + 1, 2 * _HALF + 1)
    mean_left, mean_right = (cv2.boxFilter(image, cv2.CV_32F, side) for image in (left, right))
    return _search_rows(left, right, mean_left, mean_right, xy, reach, rows)


@kernel
def _search_rows(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    mean_left: NDArray[np.float32],
    mean_right: NDArray[np.float32],
    xy: NDArray[np.float64],
    reach: int,
    rows: int,
) -> NDArray[np.float64]:
    height, width = left.shape
    flat = right.reshape(height * width)
    out = np.zeros((len(xy), 2))
    # All disparities of a row at once, so that the compiler works on many: index 0 is the largest.
    cost, mean = np.empty(_NEGATIVE + reach + 1, np.float32), np.empty(_NEGATIVE + reach + 1, np.float32)
    for i in range(len(xy)):
        x, y = round(xy[i, 0]), round(xy[i, 1])
        x, y = min(max(x, _HALF), width - 1 - _HALF), min(max(y, _HALF), height - 1 - _HALF)
        first, last = max(x - reach, _HALF), min(x + _NEGATIVE, width - 1 - _HALF)
        n, best = np.uint64(last - first + 1), np.float32(np.inf)
        for yr in range(max(y - rows, _HALF), min(y + rows, height - 1 - _HALF) + 1):
            for k in range(n):
                cost[k] = 0.0
                mean[k] = mean_right[yr, first + k] - mean_left[y, x]
            for dy in range(-_HALF, _HALF + 1):
                for dx in range(-_HALF, _HALF + 1):
                    grey = np.float32(left[y + dy, x + dx])
                    at = np.uint64((yr + dy) * width + first + dx)
                    for k in range(n):
                        cost[k] += abs(grey - np.float32(flat[at + k]) + mean[k])
            for k in range(n):
                if cost[k] <= best:
                    best = cost[k]
                    out[i, 0], out[i, 1] = x - first - k, yr - y
    return out


def measure_disparity(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    uv: NDArray[np.float64],
    expected: NDArray[np.float64],
    expected_row: NDArray[np.float64],
    flow: FlowConfig,
    config: StereoConfig,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Sub-pixel disparity and row difference (right minus left) ``(n,)`` at ``uv`` ``(n, 2)``, NaN where none is found.

    ``expected`` ``(n,)``: predicted disparity, NaN where none; those are searched along the row on a reduced pair
    first. ``expected_row`` ``(n,)``: predicted row difference; a common one beyond it is allowed for: its median over
    all points is taken out before the row test.
    """
    if not len(uv):
        return np.zeros(0), np.zeros(0)
    guess = uv.copy()
    guess[:, 1] += expected_row
    known = np.isfinite(expected)
    guess[known, 0] -= expected[known]
    if not known.all():
        small = [half_sized(im, _COARSE_LEVEL)[-1] for im in (left, right)]
        reach = int(min(config.max_disparity_px, left.shape[1] / 2) / _COARSE)
        coarse = coarse_disparity(small[0], small[1], uv[~known] / _COARSE, reach, 0)
        guess[~known, 0] -= coarse[:, 0] * _COARSE
    same = np.broadcast_to(np.eye(2), (len(uv), 2, 2))
    patches = cut_patches(half_sized(left, 1), uv)
    xy, ok = align(patches, half_sized(right, 1), same, guess, flow.min_correlation, 6.0)
    rows = xy[:, 1] - uv[:, 1]
    if ok.any():
        beyond = rows - expected_row
        ok &= np.abs(beyond - np.median(beyond[ok])) < config.max_vertical_px / 2
    disparity = uv[:, 0] - xy[:, 0]
    ok &= (disparity > _MIN_RAW_PX) & (disparity < config.max_disparity_px)
    return np.where(ok, disparity, np.nan), np.where(ok, rows, np.nan)


@kernel
def depth_at(depth_m: NDArray[np.float32], uv: NDArray[np.float64], max_jump: float) -> NDArray[np.float64]:
    """Depth ``(n,)`` at sub-pixel points: bilinear where the four neighbours agree within ``max_jump`` (relative),
    else NaN.

    Corners sit on depth edges, where the depth of the wrong side is worse than none.
    """
    height, width = depth_m.shape
    out = np.full(len(uv), np.nan)
    for i in range(len(uv)):
        x, y = int(np.floor(uv[i, 0])), int(np.floor(uv[i, 1]))
        if x < 1 or y < 1 or x >= width - 2 or y >= height - 2:
            continue
        low, high = 1e9, 0.0
        for yy in range(y - 1, y + 3):
            for xx in range(x - 1, x + 3):
                low, high = min(low, depth_m[yy, xx]), max(high, depth_m[yy, xx])
        if low <= 0.0 or high - low > max_jump * low:
            continue
        a, b = uv[i, 0] - x, uv[i, 1] - y
        top = (1 - a) * depth_m[y, x] + a * depth_m[y, x + 1]
        bottom = (1 - a) * depth_m[y + 1, x] + a * depth_m[y + 1, x + 1]
        out[i] = (1 - b) * top + b * bottom
    return out


_STARTING, _ENOUGH, _FEW_DISTORT_PX = 12, 8, 0.2
"""Key-frames of the start; key-frames that tell distortions; displacements that fewer are believed to see."""
_VIRTUAL_BASELINE_M = 0.08
"""RGB-D: a depth travels as the disparity of a stereo pair with this baseline, so that one kernel serves both."""
_DEPTH_JUMP = 0.03


class Ranging:
    """The rig as the mapper sees it: disparities at points, and the residual calibration estimated so far (pixels).

    ``cam``: ``[fx, fy, cx, cy, bf]``. Positions ``uv`` are as measured in the image; :meth:`ideal` and
    :meth:`corrected` take the residual calibration out.
    """

    def __init__(self, rig: Rig, config: StereoConfig, flow: FlowConfig) -> None:
        camera = rig.camera
        baseline = {RigKind.MONO: 0.0, RigKind.STEREO: rig.baseline_m or 0.0, RigKind.RGBD: _VIRTUAL_BASELINE_M}[
            rig.kind
        ]
        self.rig, self.config, self.flow = rig, config, flow
        self.cam = np.array([camera.fx, camera.fy, camera.cx, camera.cy, camera.fx * baseline])
        self.calib = np.zeros(N_ALL if rig.kind is RigKind.STEREO else N_RADIAL)
        """Residual calibration, pixels, in the order of :mod:`maslam.frontend.estimation.self_calibration`."""
        rgbd = rig.kind is RigKind.RGBD
        self.sigma_d = self.cam[4] * config.depth_sigma_m if rgbd else config.disparity_sigma_px
        self.min_disparity = self.cam[4] / config.max_depth_m if rgbd else config.min_disparity_sigmas * self.sigma_d
        size = camera.width, camera.height
        self._priors = [
            prior_information(*size, self.cam, config.residual_prior_px, beyond, N_ALL)
            for beyond in (_FEW_DISTORT_PX, config.residual_prior_px)
        ]
        self.calib_filter: CalibrationFilter | None = None
        """Estimate over all windows of a camera without a second; a stereo pair is calibrated anew in every window."""
        if rig.kind is not RigKind.STEREO:
            prior = prior_information(*size, self.cam, config.lens_prior_px, np.inf, N_RADIAL)
            self.calib_filter = CalibrationFilter.at_start(prior)

    def measure(
        self, frame: Frame, uv: NDArray[np.float64], expected_depth: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Raw disparity and row difference ``(n,)`` at ``uv``, NaN where unknown; ``expected_depth`` ``(n,)`` metres,
        NaN where there is none."""
        unknown = np.full(len(uv), np.nan)
        size = (self.rig.camera.width, self.rig.camera.height)
        if self.rig.kind is RigKind.STEREO and frame.right is not None:
            frame.check_size(frame.right, "right image", size)
            ideal = self.cam[4] / expected_depth
            shift = pair_shift(uv, np.nan_to_num(ideal), self.cam, self.calib)
            disparity, row = measure_disparity(
                frame.image, frame.right, uv, ideal + shift[:, 0], shift[:, 1], self.flow, self.config
            )
            seen = are_used(frame.right_used, uv + np.stack([-disparity, row], axis=1))
            return np.where(seen, disparity, np.nan), np.where(seen, row, np.nan)
        if self.rig.kind is RigKind.RGBD and frame.depth_m is not None:
            frame.check_size(frame.depth_m, "depth image", size)
            depth = depth_at(frame.depth_m, uv, _DEPTH_JUMP)
            return np.where(depth <= self.config.max_depth_m, self.cam[4] / depth, np.nan), unknown
        return unknown, unknown

    def surface(self, frame: Frame) -> Surface | None:
        """The depth image as a surface to align; None where there is none, or where it is not used."""
        config = self.config
        if self.rig.kind is not RigKind.RGBD or not config.align_depth or frame.depth_m is None:
            return None
        return surface(frame.depth_m, self.cam, config.max_align_depth_m, config.align_columns)

    def ideal(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Ideal pinhole positions ``(n, 2)``, pixels, of points measured at ``uv`` ``(n, 2)``: the residual calibration
        removed."""
        return undistort(uv, self.cam, self.calib) if self.calib.any() else uv

    def corrected(self, uv: NDArray[np.float64], disparity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Ideal disparities ``(n,)``, pixels, of those measured at ``uv`` ``(n, 2)``."""
        return disparity - pair_shift(uv, disparity, self.cam, self.calib)[:, 0] if self.calib.any() else disparity

    def measured(
        self, uv: NDArray[np.float64], disparity: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """:meth:`ideal` positions and :meth:`corrected` disparities."""
        return self.ideal(uv), self.corrected(uv, disparity)

    def calibrates(self, keyframes: int) -> bool:
        """Whether the residual calibration is estimated anew after so many key-frames: often at the start, where it
        decides about the map, later now and then (it changes slowly and costs half a bundle adjustment)."""
        start = keyframes <= _STARTING // 2 or (keyframes <= _STARTING and keyframes % 2 == 0)
        due = start or keyframes % self.config.calibrate_every == 0
        return self.config.estimate_calibration and (due or self.calib_filter is not None)

    def learn(self, calib: NDArray[np.float64], gained: NDArray[np.float64]) -> None:
        """Take over an estimate; ``gained`` ``(C, C)``: the information of its window beyond the prior's."""
        self.calib = calib
        if self.calib_filter is not None:
            self.calib_filter = self.calib_filter.after(calib, gained)

    def prior(self, keyframes: int) -> NDArray[np.float64]:
        """Prior information of the residual calibration in a bundle adjustment of so many key-frames: a few cannot tell
        a distortion from the shape of the scene or from things that move."""
        return self._priors[int(keyframes >= _ENOUGH)]

    def calibration_stats(self) -> dict[str, float]:
        """The calibration estimated, for reports: what it does at the middle of the image, and its parameters."""
        at = pair_shift(self.cam[None, 2:4], np.zeros(1), self.cam, self.calib)[0]
        return {"disparity_offset_px": float(at[0]), "row_offset_px": float(at[1]), **physical(self.calib, self.cam)}

    def back_project(self, uv: NDArray[np.float64], disparity: NDArray[np.float64]) -> NDArray[np.float64]:
        """Points ``(n, 3)`` in the camera frame, metres, measured at ``uv`` ``(n, 2)`` with ``disparity`` ``(n,)``; NaN
        where the disparity is unknown or too small."""
        d = self.corrected(uv, disparity)
        z = np.where(d > self.min_disparity, self.cam[4] / np.where(d > 0, d, 1.0), np.nan)
        return self.rays(uv) * z[:, None]

    def rays(self, uv: NDArray[np.float64]) -> NDArray[np.float64]:
        """Viewing rays ``(n, 3)`` in the camera frame, with z = 1, of positions measured at ``uv`` ``(n, 2)``."""
        fx, fy, cx, cy, _ = self.cam
        ideal = self.ideal(uv)
        return np.stack([(ideal[:, 0] - cx) / fx, (ideal[:, 1] - cy) / fy, np.ones(len(uv))], axis=1)

    def project(
        self, T_C_W: NDArray[np.float64], points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels ``(n, 2)`` at which an image shows ``points`` ``(n, 3)`` of the world, and depths ``(n,)``; pixels are
        NaN behind the camera and where the point is unknown."""
        fx, fy, cx, cy, _ = self.cam
        p = transform_points(T_C_W, points)
        z = np.where(p[:, 2] > 1e-3, p[:, 2], np.nan)
        ideal = np.stack([fx * p[:, 0] / z + cx, fy * p[:, 1] / z + cy], axis=1)
        return distort(ideal, self.cam, self.calib) if self.calib.any() else ideal, p[:, 2]

    def show(
        self, T_2_1: NDArray[np.float64], points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Pixels ``(n, 2)`` at which camera 2 shows ``points`` ``(n, 3)`` of camera 1, and how a step around them in
        image 1 shows there ``(n, 2, 2)``: as on a plane parallel to that image."""
        uv, _ = self.project(T_2_1, points)
        warp = np.empty((len(points), 2, 2))
        for k in range(2):
            step = points.copy()
            step[:, k] += points[:, 2] / self.cam[k]
            warp[:, :, k] = self.project(T_2_1, step)[0] - uv
        return uv, warp
