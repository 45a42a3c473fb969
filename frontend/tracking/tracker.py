"""The tracker: finds patches of the last key-frame where the predicted pose projects them, then estimates the robust
pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3, se3_inverse, transform_points

from ..config import OdometryConfig
from ..estimation.pose_refinement import SeenPoints, refine_pose
from ..estimation.pycolmap_adapter import absolute_pose
from ..frames import Frame
from ..image.optical_flow import follow, follow_both_ways
from ..image.patch_alignment import align, cut_patches, half_sized
from ..mapping.map import Ints, Map
from ..mapping.range_sensor import Ranging

Array = NDArray[np.float64]
_EPIPOLAR_PX = 2.0
_LOOK_AGAIN_PX = 3.0
"""A prediction this wrong (median) has misled the search: what was not found is looked for again from the pose
found."""


@dataclass(frozen=True)
class TrackedFrame:
    """Result of tracking a frame: ``T_C_W`` ``(4, 4)``, None where tracking failed, and ``reason`` with its numbers.
    ``inliers``: map points that agree with the pose."""

    T_C_W: Array | None
    inliers: int
    reason: str = ""


class Tracker:
    """Owns what is followed: map points ``point`` ``(n,)``, where the last key-frame sees them (``anchor_uv`` ``(n,
    2)``), what they look like there (``patches``), and where they were in the last frame (``uv`` ``(n, 2)``, ``found``
    ``(n,)``)."""

    def __init__(self, ranging: Ranging, config: OdometryConfig) -> None:
        self.ranging, self.config = ranging, config
        self.patches = cut_patches([], np.zeros((0, 2)))
        self.image: list[NDArray[np.uint8]] = []
        self.stamp_ns = 0
        self.point: Ints = np.zeros(0, dtype=np.int64)
        self.anchor_uv: Array = np.zeros((0, 2))
        self.uv: Array = np.zeros((0, 2))
        self.found: NDArray[np.bool_] = np.zeros(0, dtype=bool)
        self.anchor_T: Array = np.eye(4)
        self.T_C_W: Array = np.eye(4)
        self.motion: Array | None = None
        """``T_C1_C0`` of the last step ..."""
        self.step_s = 0.0
        """... and its duration; unknown is 0."""

    def start(self, frame: Frame, T_C_W: Array, point: Ints, uv: Array) -> None:
        """Follow ``point``, seen at ``uv`` in this frame, from here on."""
        if self.stamp_ns != frame.stamp_ns or not self.image:
            self.image = half_sized(frame.image, self.config.flow.align_levels)
        self.stamp_ns = frame.stamp_ns
        self.T_C_W, self.anchor_T = T_C_W, T_C_W
        self.point, self.anchor_uv, self.uv = point, uv, uv
        self.patches = cut_patches(self.image, uv)
        self.found = np.ones(len(point), dtype=bool)
        self.motion = None

    def track(self, frame: Frame, map_: Map) -> TrackedFrame:
        """Find the points in ``frame`` and its pose. On failure the state stays as it was."""
        image = half_sized(frame.image, self.config.flow.align_levels)
        dt = (frame.stamp_ns - self.stamp_ns) / 1e9
        xyz = map_.xyz[self.point]
        predicted = self._predict(dt)
        # Patches of the key-frame, searched where the motion so far would put them ...
        uv, ok = self._find(image, xyz, predicted)
        result, inlier = self._pose(uv, ok, xyz, predicted)
        seen = int(np.isfinite(xyz[:, 0]).sum())
        if result.T_C_W is None or result.inliers < self.config.pose.trusted_share * seen:
            # ... and where that finds too few, where flow from the previous frame has taken them.
            rough = self._rough_pose(frame, xyz)
            if rough is not None:
                uv2, ok2 = self._find(image, xyz, rough)
                result2, inlier2 = self._pose(uv2, ok2, xyz, rough)
                if result2.inliers > result.inliers:
                    predicted, uv, ok, result, inlier = rough, uv2, ok2, result2, inlier2
        if result.T_C_W is None:
            return result
        uv, ok, result, inlier = self._look_again(image, xyz, predicted, uv, ok, result, inlier)
        assert result.T_C_W is not None
        uv, ok = self._follow_unknown(frame, xyz, uv, ok, result.T_C_W)
        self.motion, self.step_s = product(result.T_C_W, se3_inverse(self.T_C_W)), dt
        self.image, self.stamp_ns, self.T_C_W = image, frame.stamp_ns, result.T_C_W
        known = np.isfinite(xyz[:, 0])
        self.found = np.where(known, inlier, ok & self.found)
        self.uv = np.where(self.found[:, None], uv, self.uv)
        return result

    def seen(self) -> tuple[Ints, Array]:
        """Map points found in the last frame and where."""
        return self.point[self.found], self.uv[self.found]

    def _predict(self, dt: float) -> Array:
        regular = (
            self.step_s > 0.0 and 0.3 * self.step_s < dt < 3.0 * self.step_s and dt <= self.config.pose.max_frame_gap_s
        )
        return product(self.motion, self.T_C_W) if self.motion is not None and regular else self.T_C_W

    def _find(
        self, image: list[NDArray[np.uint8]], xyz: Array, T_C_W: Array, only: NDArray[np.bool_] | None = None
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Points of known position looked for around their projection with ``T_C_W``."""
        uv, ok = self.uv.copy(), np.zeros(len(self.uv), dtype=bool)
        guess, warp = self._projected(xyz, T_C_W)
        height, width = image[0].shape
        inside = (guess[:, 0] > 4) & (guess[:, 1] > 4) & (guess[:, 0] < width - 5) & (guess[:, 1] < height - 5)
        index = np.flatnonzero(inside if only is None else inside & only)
        flow = self.config.flow
        uv[index], ok[index] = align(
            self.patches.take(index), image, warp[index], guess[index], flow.min_correlation, flow.reach_px
        )
        return uv, ok

    def _projected(self, xyz: Array, T_C_W: Array) -> tuple[Array, Array]:
        """Projection of points, and how a step around them in the key-frame projects there: as on a plane parallel to
        its image."""
        T = product(T_C_W, se3_inverse(self.anchor_T))
        p = transform_points(self.anchor_T, xyz)
        guess, _ = self.ranging.project(T, p)
        warp = np.empty((len(p), 2, 2))
        for k in range(2):
            step = p.copy()
            step[:, k] += p[:, 2] / self.ranging.cam[k]
            warp[:, :, k] = self.ranging.project(T, step)[0] - guess
        return guess, warp

    def _rough_pose(self, frame: Frame, xyz: Array) -> Array | None:
        """A pose without any prediction: wide flow from the previous frame, then RANSAC."""
        index = np.flatnonzero(self.found & np.isfinite(xyz[:, 0]))
        uv, ok = follow(self.image[0], frame.image, self.uv[index], self.uv[index], self.config.flow)
        error_px = 8.0 * self.config.pose.pixel_sigma_px
        return absolute_pose(xyz[index[ok]], self.ranging.ideal(uv[ok]), self.ranging.cam, error_px)

    def _look_again(
        self,
        image: list[NDArray[np.uint8]],
        xyz: Array,
        predicted: Array,
        uv: Array,
        ok: NDArray[np.bool_],
        result: TrackedFrame,
        inlier: NDArray[np.bool_],
    ) -> tuple[Array, NDArray[np.bool_], TrackedFrame, NDArray[np.bool_]]:
        assert result.T_C_W is not None
        before, _ = self.ranging.project(predicted, xyz[inlier])
        after, _ = self.ranging.project(result.T_C_W, xyz[inlier])
        if np.median(np.linalg.norm(after - before, axis=1)) < _LOOK_AGAIN_PX:
            return uv, ok, result, inlier
        uv2, ok2 = self._find(image, xyz, result.T_C_W, ~inlier)
        uv2, ok2 = np.where(inlier[:, None], uv, uv2), inlier | ok2
        result2, inlier2 = self._pose(uv2, ok2, xyz, result.T_C_W)
        return (uv2, ok2, result2, inlier2) if result2.inliers >= result.inliers else (uv, ok, result, inlier)

    def _pose(
        self, uv: Array, ok: NDArray[np.bool_], xyz: Array, predicted: Array
    ) -> tuple[TrackedFrame, NDArray[np.bool_]]:
        settings = self.config.pose
        index = np.flatnonzero(ok)
        inlier = np.zeros(len(uv), dtype=bool)
        n = len(index)
        if n < settings.min_inliers:
            return TrackedFrame(None, 0, f"only {n} of {len(uv)} points found, need {settings.min_inliers}"), inlier
        ideal = self.ranging.ideal(uv[index])
        seen = SeenPoints.without_depth(xyz[index], ideal, np.full(n, settings.pixel_sigma_px))
        T, good, _ = refine_pose(predicted, seen, self.ranging.cam, settings.outlier_sigmas, 4)
        if good.sum() < max(settings.min_inliers, 0.5 * n):
            T_ransac = absolute_pose(xyz[index], ideal, self.ranging.cam, 4.0 * settings.pixel_sigma_px)
            if T_ransac is not None:
                T2, good2, _ = refine_pose(T_ransac, seen, self.ranging.cam, settings.outlier_sigmas, 4)
                if good2.sum() > good.sum():
                    T, good = T2, good2
        if good.sum() < settings.min_inliers or not np.isfinite(T).all():
            return TrackedFrame(
                None, int(good.sum()), f"only {good.sum()} of {n} points agree on a pose, need {settings.min_inliers}"
            ), inlier
        inlier[index] = good
        return TrackedFrame(T, int(good.sum())), inlier

    def _follow_unknown(
        self, frame: Frame, xyz: Array, uv: Array, ok: NDArray[np.bool_], T_C_W: Array
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Points of unknown position: flow from where the turn of the camera takes them; they must move along their
        epipolar line."""
        index = np.flatnonzero(np.isnan(xyz[:, 0]) & self.found)
        if not len(index):
            return uv, ok
        turn = product(T_C_W[:3, :3], self.T_C_W[:3, :3].T)
        start = self.uv[index]
        far, _ = self.ranging.project(se3(turn, np.zeros(3)), self.ranging.rays(start))
        uv, ok = uv.copy(), ok.copy()
        at, good = follow_both_ways(
            self.image[0], frame.image, start, np.where(np.isfinite(far), far, start), self.config.flow
        )
        uv[index], ok[index] = at, good & self._on_epipolar_line(start, at, T_C_W)
        return uv, ok

    def _on_epipolar_line(self, before: Array, after: Array, T_C_W: Array) -> NDArray[np.bool_]:
        T = product(T_C_W, se3_inverse(self.T_C_W))
        a, b = self.ranging.rays(before), self.ranging.rays(after)
        if np.linalg.norm(T[:3, 3]) < 1e-9:
            return np.ones(len(after), dtype=bool)
        line = np.cross(T[:3, 3], product(a, T[:3, :3].T))
        scale = np.hypot(line[:, 0], line[:, 1]) / self.ranging.cam[0]
        return np.abs((line * b).sum(axis=1)) < _EPIPOLAR_PX * scale + 1e-12
