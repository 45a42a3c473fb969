"""The mapper: adds a key-frame, makes new points, finds known points again, adjusts the window, culls."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import product, rotation_angle_deg, se3_inverse, transform_points

from ..config import OdometryConfig
from ..estimation.bundle_adjustment import window_residuals
from ..estimation.triangulation import triangulate
from ..frames import Frame
from ..image.guided_matching import OrbFeatures, guided_match
from ..image.orb_features import Detector, Keypoints, Pyramid, describe, spread_cells, undescribed
from ..stopwatch import Stopwatch, TimedStage
from .local_bundle_adjustment import adjust_locally, window_keyframes
from .map import Array, FrameObservations, Ints, Map, MapKeyFrame, union, without
from .more_views import MoreViews
from .range_sensor import Ranging

_TRIANGULATION_SIGMAS = 4.0
"""Reprojection error, in standard deviations of a pixel, that a new point may have at worst."""


class Mapper:
    """Grows and refines one :class:`Map`."""

    def __init__(self, map_: Map, ranging: Ranging, config: OdometryConfig, watch: Stopwatch | None = None) -> None:
        self.map, self.ranging, self.config = map_, ranging, config
        self._stage = (watch or Stopwatch()).stage
        self.more_views = MoreViews(map_, ranging, config.flow, config.mapping.view_neighbours)
        self._detector = Detector(config.features)
        self._log_scale = np.log(config.features.scale_factor)

    def insert(self, frame: Frame, T_C_W: Array, followed: FrameObservations) -> MapKeyFrame:
        """Make ``frame`` a key-frame that sees the points ``followed`` into it, and improve the map with it."""
        with self._stage(TimedStage.DETECT):
            keyframe = self._make(frame, T_C_W, followed)
        with self._stage(TimedStage.TRIANGULATE):
            self.map.insert(keyframe)
            self._position_new(keyframe)
            self._triangulate_waiting(keyframe)
        with self._stage(TimedStage.MATCH):
            self._fuse(keyframe)
        with self._stage(TimedStage.ADJUST):
            adjust_locally(self.map, self.ranging, self.config)
        with self._stage(TimedStage.CULL):
            self._cull_keyframes()
        if keyframe.stays:
            with self._stage(TimedStage.VIEWS):
                self.more_views.add(keyframe, frame.image, frame.used)
        return keyframe

    def _make(self, frame: Frame, T_C_W: Array, seen: FrameObservations) -> MapKeyFrame:
        """Observations of the new key-frame: what was followed, what fills empty cells, and (if it stays) more ORB
        key-points."""
        point, uv = seen
        features, stays = self.config.features, self._stays(T_C_W, point)
        pyramid = Pyramid(frame.image, features.levels if stays else 2, features.scale_factor, frame.used)
        extra = features.landmarks if stays else 0
        new_uv, new_level, _ = self._detector.detect(pyramid, features.tracks + extra, uv, None if stays else 1)
        fill = spread_cells(new_uv, uv, frame.image.shape[1], frame.image.shape[0], features.tracks)
        if not stays:
            new_uv, new_level, fill = new_uv[fill], new_level[fill], np.arange(len(fill))
        n = len(uv)
        all_uv = np.concatenate([uv, new_uv])
        level = np.clip(np.rint(self._expected_level(T_C_W, point)), 0, features.levels - 1).astype(np.int8)
        level = np.concatenate([level, new_level])
        keypoints = describe(pyramid, all_uv, level) if stays else undescribed(all_uv, level)
        described = np.isfinite(keypoints.angle_deg)
        with self._stage(TimedStage.MATCH):
            points = np.concatenate([point, self._seen_again(T_C_W, point, keypoints, n)])
        matched = (np.arange(len(points)) >= n) & (points >= 0)
        followed = np.arange(len(points)) < n
        followed[n + fill[points[n + fill] < 0]] = True
        fresh = points < 0
        points[fresh] = self.map.add_points(int(fresh.sum()))
        _, depth = self.ranging.project(T_C_W, self.map.xyz[points])
        with self._stage(TimedStage.STEREO):
            disparity, row = self.ranging.measure(frame, all_uv, np.where(depth > 0, depth, np.nan))
        sigma = np.where(matched, features.scale_factor ** level.astype(np.float64), self.config.pose.pixel_sigma_px)
        return MapKeyFrame(
            number=len(self.map.keyframes) + len(self.map.culled),
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            T_C_W=T_C_W.copy(),
            uv=all_uv,
            disparity=disparity,
            row=row,
            point=points,
            sigma=sigma,
            level=level,
            descriptors=keypoints.descriptors,
            described=described,
            followed=followed,
            stays=stays,
            surface=self.ranging.surface(frame),
        )

    def _stays(self, T_C_W: Array, point: Ints) -> bool:
        """Whether the view differs enough from the last key-frame that stays."""
        kept = next((k for k in reversed(self.map.keyframes.values()) if k.stays), None)
        settings = self.config.keyframes
        if kept is None or settings.policy == "thesis":
            return True
        step = product(T_C_W, se3_inverse(kept.T_C_W))
        _, depth = self.ranging.project(T_C_W, self.map.xyz[point])
        median_depth = float(np.nanmedian(depth)) if np.isfinite(depth).any() else 1.0
        far = float(np.linalg.norm(step[:3, 3])) >= settings.keep_distance * median_depth
        return far or float(rotation_angle_deg(step[:3, :3])) >= settings.keep_angle_deg

    def _expected_level(self, T_C_W: Array, point: Ints) -> Array:
        """The pyramid level a point shows itself on from here: coarser when nearer; its old level where its depth is
        unknown."""
        _, depth = self.ranging.project(T_C_W, self.map.xyz[point])
        ratio = self.map.depth[point] / np.where(depth > 0, depth, np.nan)
        known = np.isfinite(ratio) & (ratio > 0)
        return self.map.level[point].astype(np.float64) + np.where(
            known, np.log(np.where(known, ratio, 1.0)) / self._log_scale, 0.0
        )

    def _seen_again(self, T_C_W: Array, followed: Ints, keypoints: Keypoints, n: int) -> Ints:
        """Map point ``(m,)`` of each key-point from row ``n`` on that is a known point come back, else -1: guided ORB
        search."""
        out = np.full(len(keypoints) - n, -1, dtype=np.int64)
        local = self.local_points()
        local = without(local[self.map.described[local]], followed)
        if not len(local) or not len(out):
            return out
        uv, depth = self.ranging.project(T_C_W, self.map.xyz[local])
        camera = self.ranging.rig.camera
        seen = (depth > 0) & (uv[:, 0] >= 0) & (uv[:, 1] >= 0) & (uv[:, 0] < camera.width) & (uv[:, 1] < camera.height)
        local, uv = local[seen], uv[seen]
        level = self._expected_level(T_C_W, local)
        usable = np.flatnonzero(np.isfinite(keypoints.angle_deg[n:])) + n
        settings = self.config.mapping
        radius = settings.match_radius_px * self.config.features.scale_factor ** np.clip(level, 0, 8)
        predicted = OrbFeatures(uv, level, self.map.descriptors[local])
        match = guided_match(predicted, radius, keypoints.features(usable), settings)
        hit = match >= 0
        out[usable[match[hit]] - n] = local[hit]
        return out

    def local_points(self) -> Ints:
        """Living points of known position seen by the window's key-frames and those covisible with it."""
        recent, older = window_keyframes(self.map, self.config)
        if not recent:
            return np.zeros(0, dtype=np.int64)
        ids = union([self.map.keyframes[k].point for k in older + recent])
        return ids[self.map.alive[ids] & np.isfinite(self.map.xyz[ids, 0])]

    def _position_new(self, keyframe: MapKeyFrame) -> None:
        """Points without a position get one where this key-frame measured their disparity."""
        rows = np.flatnonzero(keyframe.point >= 0)
        rows = rows[np.isnan(self.map.xyz[keyframe.point[rows], 0])]
        p_C = self.ranging.back_project(keyframe.uv[rows], keyframe.disparity[rows])
        good = np.isfinite(p_C[:, 0])
        ids = keyframe.point[rows[good]]
        self.map.xyz[ids] = transform_points(keyframe.T_W_C, p_C[good])
        self.map.metric[ids] = True
        self.map.depth[ids] = p_C[good, 2]
        if self.ranging.rig.metric:
            # What has no depth here is hardly worth following: the next key-frame fills its cell anew.
            keyframe.followed &= (keyframe.point < 0) | np.isfinite(self.map.xyz[keyframe.point, 0])

    def _triangulate_waiting(self, keyframe: MapKeyFrame) -> None:
        """Points without a position get one where their rays have parallax by now."""
        ids = keyframe.point[keyframe.followed & (keyframe.point >= 0)]
        ids = ids[np.isnan(self.map.xyz[ids, 0]) & (self.map.views[ids] >= 2)]
        if not len(ids):
            return
        views = [(number, row) for i in ids.tolist() for number, row in self.map.observers[i]]
        numbers, kf = np.unique([number for number, _ in views], return_inverse=True)
        keyframes = [self.map.keyframes[int(number)] for number in numbers]
        start = np.concatenate([[0], np.cumsum(self.map.views[ids])]).astype(np.int64)
        uv = np.array([self.map.keyframes[number].uv[row] for number, row in views])
        poses = np.stack([k.T_C_W for k in keyframes])
        points, parallax = triangulate(poses, start, kf.astype(np.int64), self.ranging.rays(uv))
        good = np.isfinite(points[:, 0]) & (parallax > np.radians(self.config.mapping.min_parallax_deg))
        pt = np.repeat(np.arange(len(ids)), np.diff(start))
        unknown = np.full(len(kf), np.nan)
        r = window_residuals(poses, points, kf.astype(np.int64), pt, self.ranging.ideal(uv), unknown, self.ranging.cam)
        error = np.nan_to_num(np.hypot(r[:, 0], r[:, 1]), nan=np.inf)
        good &= np.maximum.reduceat(error, start[:-1]) < _TRIANGULATION_SIGMAS * self.config.pose.pixel_sigma_px
        self.map.xyz[ids[good]] = points[good]
        _, self.map.depth[ids[good]] = self.ranging.project(keyframe.T_C_W, points[good])

    def _fuse(self, keyframe: MapKeyFrame) -> None:
        """Local points that look the same as, and fall on, a point this key-frame sees are that point: the older one
        stays."""
        rows = np.flatnonzero((keyframe.point >= 0) & keyframe.described)
        rows = rows[np.isfinite(self.map.xyz[keyframe.point[rows], 0])]
        local = without(self.local_points(), keyframe.point)
        local = local[self.map.described[local]]
        uv, depth = self.ranging.project(keyframe.T_C_W, self.map.xyz[local])
        near = np.flatnonzero(depth > 0)
        local, uv, depth = local[near], uv[near], depth[near]
        settings = self.config.mapping
        predicted = OrbFeatures(uv, self._expected_level(keyframe.T_C_W, local), self.map.descriptors[local])
        radius = np.full(len(local), settings.fuse_radius_px)
        match = guided_match(predicted, radius, keyframe.features(rows), settings)
        hit = np.flatnonzero(match >= 0)
        twins = keyframe.point[rows[match[hit]]]
        _, depth_twin = self.ranging.project(keyframe.T_C_W, self.map.xyz[twins])
        same = np.abs(depth_twin - depth[hit]) < settings.fuse_depth_share * depth[hit]
        for a, b in zip(local[hit[same]].tolist(), twins[same].tolist(), strict=True):
            if not self.map.seen_together(a, b):
                self.map.merge_points(min(a, b), max(a, b))

    def _forget_waiting(self, keyframe: MapKeyFrame) -> None:
        """Points that never got a position and that nobody follows any more go."""
        ids = np.unique(keyframe.point[keyframe.point >= 0])
        for point in ids[np.isnan(self.map.xyz[ids, 0])].tolist():
            self.map.drop_point(point)

    def _cull_keyframes(self) -> None:
        """Key-frames that only supported the window go when they leave it; the one before carries their frames."""
        window = self.config.mapping.window
        outside = self.map.latest(window + 2)[:-window]  # what left the window just now, and the one before it
        if outside:
            self._forget_waiting(self.map.keyframes[outside[-1]])
        if len(outside) == 2 and not self.map.keyframes[outside[1]].stays:
            self.map.cull_keyframe(outside[1], outside[0])
