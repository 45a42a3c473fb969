"""A frame in, its pose out: optical flow from the previous frame, then the robust pose of the map points found."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from backend.geometry import se3, se3_inverse
from frontend.config import OdometryConfig
from frontend.flow import follow, follow_both_ways
from frontend.frames import Frame
from frontend.map import Ints, Map
from frontend.pose import refine_pose
from frontend.stereo import Ranging

Array = NDArray[np.float64]
_EPIPOLAR_PX = 2.0


@dataclass(frozen=True)
class Tracked:
    """``T_C_W`` is None where tracking failed, and ``reason`` says why with its numbers. ``inliers`` map points agree with the pose."""

    T_C_W: Array | None
    inliers: int
    reason: str = ""


class Tracker:
    """Owns what flows: the previous image, where its points are (``uv`` ``(n, 2)``) and which map points they are (``point`` ``(n,)``)."""

    def __init__(self, ranging: Ranging, config: OdometryConfig) -> None:
        self.ranging, self.config = ranging, config
        self.image: NDArray[np.uint8] | None = None
        self.stamp_ns = 0
        self.point: Ints = np.zeros(0, dtype=np.int64)
        self.uv: Array = np.zeros((0, 2))
        self.T_C_W: Array = np.eye(4)
        self.motion: Array | None = None
        """``T_C1_C0`` of the last step, where the time between frames was regular."""
        self.step_s = 0.0

    def start(self, frame: Frame, T_C_W: Array, point: Ints, uv: Array) -> None:
        """Begin (or begin again) to follow ``point`` from this frame."""
        self.image, self.stamp_ns, self.T_C_W = frame.image, frame.stamp_ns, T_C_W
        self.point, self.uv, self.motion = point, uv, None

    def track(self, frame: Frame, map_: Map) -> Tracked:
        """Follow the points into ``frame`` and find its pose. On failure the state stays as it was."""
        assert self.image is not None
        xyz = map_.xyz[self.point]
        dt = (frame.stamp_ns - self.stamp_ns) / 1e9
        predicted = self._predict(dt)
        uv, ok = self._flow(frame, xyz, predicted)
        result, inlier = self._pose(uv, ok, xyz, predicted)
        if result.T_C_W is None and self.motion is not None:
            # The motion model may be what is wrong: once more from where the points were.
            uv, ok = self._flow(frame, xyz, self.T_C_W)
            result, inlier = self._pose(uv, ok, xyz, self.T_C_W)
        if result.T_C_W is None:
            return result
        known = np.isfinite(xyz[:, 0])
        keep = np.where(known, inlier, ok & self._on_epipolar_line(uv, result.T_C_W))
        self.motion = result.T_C_W @ se3_inverse(self.T_C_W)
        self.step_s = dt
        self.image, self.stamp_ns, self.T_C_W = frame.image, frame.stamp_ns, result.T_C_W
        self.point, self.uv = self.point[keep], uv[keep]
        return result

    def moved_by(self, T_C_W: Array) -> None:
        """The map has moved: the same frame now has this pose."""
        self.T_C_W = T_C_W

    def _predict(self, dt: float) -> Array:
        regular = self.step_s > 0.0 and 0.3 * self.step_s < dt < 3.0 * self.step_s and dt <= self.config.pose.max_frame_gap_s
        return self.motion @ self.T_C_W if self.motion is not None and regular else self.T_C_W

    def _flow(self, frame: Frame, xyz: Array, T_C_W: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Points of known position start at their projection, the others where the turn of the camera takes them."""
        assert self.image is not None
        guess, _ = self.ranging.project(T_C_W, xyz)
        turn = T_C_W[:3, :3] @ self.T_C_W[:3, :3].T
        far, _ = self.ranging.project(se3(turn, np.zeros(3)), self.ranging.rays(self.uv))
        known = np.isfinite(xyz[:, 0])
        guess = np.where(np.isfinite(guess), guess, np.where(np.isfinite(far), far, self.uv))
        size = np.array([frame.image.shape[1], frame.image.shape[0]], dtype=np.float64)
        guess = np.clip(guess, -size, 2 * size)
        uv, ok = np.zeros_like(self.uv), np.zeros(len(self.uv), dtype=bool)
        uv[known], ok[known] = follow(self.image, frame.image, self.uv[known], guess[known], self.config.flow)
        uv[~known], ok[~known] = follow_both_ways(self.image, frame.image, self.uv[~known], guess[~known], self.config.flow)
        return uv, ok

    def _pose(self, uv: Array, ok: NDArray[np.bool_], xyz: Array, predicted: Array) -> tuple[Tracked, NDArray[np.bool_]]:
        pose_config = self.config.pose
        index = np.flatnonzero(ok & np.isfinite(xyz[:, 0]))
        inlier = np.zeros(len(uv), dtype=bool)
        if len(index) < pose_config.min_inliers:
            return Tracked(None, 0, f"only {len(index)} of {len(uv)} points could be followed, need {pose_config.min_inliers}"), inlier
        n = len(index)
        args = (xyz[index], uv[index], np.full(n, np.nan), np.full(n, pose_config.pixel_sigma_px), np.full(n, 1.0), self.ranging.cam)
        T, good, _ = refine_pose(predicted, *args, pose_config.outlier_sigmas, 4)
        if good.sum() < max(pose_config.min_inliers, 0.4 * n):
            T_ransac = pnp_ransac(xyz[index], uv[index], self.ranging, 6.0 * pose_config.pixel_sigma_px)
            if T_ransac is not None:
                T2, good2, _ = refine_pose(T_ransac, *args, pose_config.outlier_sigmas, 4)
                if good2.sum() > good.sum():
                    T, good = T2, good2
        if good.sum() < pose_config.min_inliers or not np.isfinite(T).all():
            return Tracked(None, int(good.sum()), f"only {good.sum()} of {n} points agree on a pose, need {pose_config.min_inliers}"), inlier
        inlier[index] = good
        return Tracked(T, int(good.sum())), inlier

    def _on_epipolar_line(self, uv: Array, T_C_W: Array) -> NDArray[np.bool_]:
        """Points of unknown position must at least move along their epipolar line."""
        T = T_C_W @ se3_inverse(self.T_C_W)
        a, b = self.ranging.rays(self.uv), self.ranging.rays(uv)
        if np.linalg.norm(T[:3, 3]) < 1e-9:
            return np.ones(len(uv), dtype=bool)
        line = np.cross(T[:3, 3], a @ T[:3, :3].T)
        scale = np.hypot(line[:, 0], line[:, 1]) / self.ranging.cam[0]
        return np.abs((line * b).sum(axis=1)) < _EPIPOLAR_PX * np.maximum(scale, 1e-12) + 1e-12


def pnp_ransac(points: Array, uv: Array, ranging: Ranging, threshold_px: float) -> Array | None:
    """``T_C_W`` by P3P in RANSAC (OpenCV's own fixed seed: the same draw every time), or None."""
    if len(points) < 6:
        return None
    fx, fy, cx, cy, _ = ranging.cam
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]])
    try:
        found, rotation, translation, inliers = cv2.solvePnPRansac(
            points, uv, K, None, iterationsCount=300, reprojectionError=threshold_px, confidence=0.999, flags=cv2.SOLVEPNP_AP3P
        )
    except cv2.error:
        return None
    if not found or inliers is None or len(inliers) < 6:
        return None
    return se3(cv2.Rodrigues(rotation)[0], translation.ravel())
