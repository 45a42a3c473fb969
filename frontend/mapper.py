"""A key-frame in, a better map out: new points, known points seen again, window bundle adjustment, culling."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from backend.geometry import rotation_angle_deg, se3_inverse, transform_points
from frontend.config import OdometryConfig
from frontend.features import Detector, Keypoints, Pyramid, describe, spread_cells, undescribed
from frontend.frames import Frame
from frontend.map import Ints, KeyFrame, Map
from frontend.matching import guided_match
from frontend.stereo import Ranging
from frontend.triangulate import triangulate
from frontend.window import adjust_window, window_residuals

Array = NDArray[np.float64]


class Mapper:
    """Grows and refines one :class:`Map`."""

    def __init__(self, map_: Map, ranging: Ranging, config: OdometryConfig) -> None:
        self.map, self.ranging, self.config = map_, ranging, config
        self._detector = Detector(config.features)
        self._log_scale = np.log(config.features.scale_factor)

    def insert(self, frame: Frame, T_C_W: Array, point: Ints, uv: Array) -> KeyFrame:
        """Make ``frame`` a key-frame that sees map points ``point`` at ``uv`` (followed by flow), and improve the map with it."""
        keyframe = self._make(frame, T_C_W, point, uv)
        self.map.insert(keyframe)
        self._position_new(keyframe)
        self._triangulate_waiting(keyframe)
        self.adjust()
        self._cull_keyframes()
        return keyframe

    def _make(self, frame: Frame, T_C_W: Array, point: Ints, uv: Array) -> KeyFrame:
        """Observations of the new key-frame: what was followed, what fills empty cells, and (if it stays) more ORB key-points."""
        features, stays = self.config.features, self._stays(T_C_W, point)
        pyramid = Pyramid(frame.image, features.levels if stays else 2, features.scale_factor)
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
        points = np.concatenate([point, self._seen_again(T_C_W, point, keypoints, n)])
        matched = (np.arange(len(points)) >= n) & (points >= 0)
        followed = np.arange(len(points)) < n
        followed[n + fill[points[n + fill] < 0]] = True
        fresh = points < 0
        points[fresh] = self.map.add_points(int(fresh.sum()))
        _, depth = self.ranging.project(T_C_W, self.map.xyz[points])
        disparity = self.ranging.measure(frame, all_uv, np.where(depth > 0, depth, np.nan))
        sigma = np.where(matched, features.scale_factor ** level.astype(np.float64), self.config.pose.pixel_sigma_px)
        return KeyFrame(
            number=len(self.map.keyframes) + len(self.map.culled), frame_index=frame.index, stamp_ns=frame.stamp_ns, T_C_W=T_C_W.copy(),
            uv=all_uv, disparity=disparity, point=points, sigma=sigma, level=level, descriptors=keypoints.descriptors,
            described=described, followed=followed, stays=stays,
        )  # fmt: skip

    def _stays(self, T_C_W: Array, point: Ints) -> bool:
        """Whether the view differs enough from the last key-frame that stays."""
        kept = [k for k in sorted(self.map.keyframes) if self.map.keyframes[k].stays]
        settings = self.config.keyframes
        if not kept or settings.policy == "thesis":
            return True
        step = T_C_W @ se3_inverse(self.map.keyframes[kept[-1]].T_C_W)
        _, depth = self.ranging.project(T_C_W, self.map.xyz[point])
        median_depth = float(np.nanmedian(depth)) if np.isfinite(depth).any() else 1.0
        far = float(np.linalg.norm(step[:3, 3])) >= settings.keep_distance * median_depth
        return far or float(rotation_angle_deg(step[:3, :3])) >= settings.keep_angle_deg

    def _expected_level(self, T_C_W: Array, point: Ints) -> Array:
        """The pyramid level a point shows itself on from here: coarser when nearer; its old level where its depth is unknown."""
        _, depth = self.ranging.project(T_C_W, self.map.xyz[point])
        ratio = self.map.depth[point] / np.where(depth > 0, depth, np.nan)
        known = np.isfinite(ratio) & (ratio > 0)
        return self.map.level[point] + np.where(known, np.log(np.where(known, ratio, 1.0)) / self._log_scale, 0.0)

    def _seen_again(self, T_C_W: Array, followed: Ints, keypoints: Keypoints, n: int) -> Ints:
        """Map point ``(m,)`` of each key-point from row ``n`` on that is a known point come back, else -1: guided ORB search."""
        out = np.full(len(keypoints) - n, -1, dtype=np.int64)
        local = self.local_points()
        local = np.setdiff1d(local[self.map.described[local]], followed)
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
        match = guided_match(
            uv, level, self.map.descriptors[local], keypoints.uv[usable], keypoints.level[usable], keypoints.descriptors[usable], radius,
            settings.match_distance, settings.match_ratio,
        )  # fmt: skip
        hit = match >= 0
        out[usable[match[hit]] - n] = local[hit]
        return out

    def local_points(self) -> Ints:
        """Living points of known position seen by the window's key-frames and those covisible with it."""
        numbers = self.window_keyframes()
        if not numbers:
            return np.zeros(0, dtype=np.int64)
        ids = np.unique(np.concatenate([self.map.keyframes[k].point for k in numbers]))
        ids = ids[ids >= 0]
        return ids[self.map.alive[ids] & np.isfinite(self.map.xyz[ids, 0])]

    def window_keyframes(self) -> list[int]:
        """The latest key-frames, oldest first, after older ones of the same place."""
        recent = sorted(self.map.keyframes)[-self.config.mapping.window :]
        if not recent:
            return []
        last = self.map.keyframes[recent[-1]]
        older = self.map.covisible(last.point[last.point >= 0], set(recent))[: self.config.mapping.covisible]
        return sorted(older) + recent

    def _position_new(self, keyframe: KeyFrame) -> None:
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

    def _triangulate_waiting(self, keyframe: KeyFrame) -> None:
        """Points without a position get one where their rays have parallax by now."""
        ids = keyframe.point[keyframe.followed & (keyframe.point >= 0)]
        ids = [i for i in ids[np.isnan(self.map.xyz[ids, 0])].tolist() if len(self.map.observers[i]) >= 2]
        if not ids:
            return
        numbers = sorted({number for i in ids for number, _ in self.map.observers[i]})
        place = {number: k for k, number in enumerate(numbers)}
        views = [(place[number], number, row) for i in ids for number, row in self.map.observers[i]]
        start = np.concatenate([[0], np.cumsum([len(self.map.observers[i]) for i in ids])])
        kf = np.array([v[0] for v in views], dtype=np.int64)
        uv = np.array([self.map.keyframes[number].uv[row] for _, number, row in views])
        poses = np.stack([self.map.keyframes[k].T_C_W for k in numbers])
        points, parallax = triangulate(poses, start.astype(np.int64), kf, self.ranging.rays(uv))
        good = np.isfinite(points[:, 0]) & (parallax > np.radians(self.config.mapping.min_parallax_deg))
        if not good.any():
            return
        pt = np.repeat(np.arange(len(ids)), np.diff(start))
        r = window_residuals(poses, np.where(good[:, None], points, 1.0), kf, pt, uv, np.full(len(kf), np.nan), self.ranging.cam, np.zeros(3))
        error = np.nan_to_num(np.hypot(r[:, 0], r[:, 1]), nan=1e9)
        worst = np.maximum.reduceat(error, start[:-1])
        good &= worst < 4.0 * self.config.pose.pixel_sigma_px
        chosen = np.array(ids)[good]
        self.map.xyz[chosen] = points[good]
        _, self.map.depth[chosen] = self.ranging.project(keyframe.T_C_W, points[good])

    def adjust(self) -> None:
        """Window bundle adjustment; poses, points and the rig's calibration are updated, outliers dropped."""
        settings = self.config.mapping
        numbers = self.window_keyframes()
        recent = sorted(self.map.keyframes)[-settings.window :]
        # At the start only the first key-frame is the anchor; later the oldest of the window and all older ones.
        fixed = set(numbers) - set(recent[1:] if len(recent) < settings.window else recent[settings.fixed :])
        if len(recent) < 2:
            return
        slot = np.full(len(numbers), -1, dtype=np.int64)
        free = [k for k, number in enumerate(numbers) if number not in fixed]
        slot[free] = np.arange(len(free))
        problem = self._gather(numbers, slot)
        if problem is None:
            return
        ids, start, kf, row, pt, uv, disparity, sigma = problem
        keyframes = [self.map.keyframes[k] for k in numbers]
        poses = np.stack([k.T_C_W for k in keyframes])
        prior = np.array([self.config.stereo.offset_prior_px, self.config.stereo.slope_prior_px, self.config.stereo.slope_prior_px])
        sigma_d = np.full(len(kf), self.ranging.sigma_d)
        new_poses, points, calib, _, _ = adjust_window(
            poses, slot, self.map.xyz[ids], start, kf, pt, uv, disparity, sigma, sigma_d, self.ranging.cam, self.ranging.calib,
            np.zeros(3), prior**-2.0, self.ranging.estimates_calib, settings.iterations,
        )  # fmt: skip
        if not (np.isfinite(new_poses).all() and np.isfinite(points).all()):
            return
        for k in free:
            keyframes[k].T_C_W = new_poses[k]
        self.map.xyz[ids] = points
        self.ranging.calib = calib
        self._reposition_single(keyframes)
        self._drop_outliers(keyframes, new_poses, points, ids, kf, row, pt, uv, disparity, sigma)

    def _gather(self, numbers: list[int], slot: Ints) -> tuple | None:
        """Observations of the window sorted by point; points seen once bring nothing and stay out."""
        kf, row, point = [], [], []
        for k, number in enumerate(numbers):
            keyframe = self.map.keyframes[number]
            rows = np.flatnonzero(keyframe.point >= 0)
            rows = rows[np.isfinite(self.map.xyz[keyframe.point[rows], 0])]
            kf.append(np.full(len(rows), k))
            row.append(rows)
            point.append(keyframe.point[rows])
        kf, row, point = np.concatenate(kf), np.concatenate(row), np.concatenate(point)
        count = np.bincount(point, minlength=len(self.map))
        moving = np.zeros(len(self.map), dtype=bool)
        moving[point[slot[kf] >= 0]] = True
        use = (count[point] >= 2) & moving[point]
        kf, row, point = kf[use], row[use], point[use]
        if len(point) < 20:
            return None
        order = np.argsort(point, kind="stable")
        kf, row, point = kf[order], row[order], point[order]
        ids, start = np.unique(point, return_index=True)
        start = np.append(start, len(point)).astype(np.int64)
        pt = np.repeat(np.arange(len(ids)), np.diff(start))
        keyframes = [self.map.keyframes[n] for n in numbers]
        offset = np.concatenate([[0], np.cumsum([len(k.uv) for k in keyframes])])[:-1]
        flat = offset[kf] + row
        uv = np.concatenate([k.uv for k in keyframes])[flat]
        disparity = np.concatenate([k.disparity for k in keyframes])[flat]
        sigma = np.concatenate([k.sigma for k in keyframes])[flat]
        return ids, start, kf, row, pt, uv, disparity, sigma

    def _reposition_single(self, keyframes: list[KeyFrame]) -> None:
        """Points seen once hang on their key-frame: they move with it and with the calibration."""
        for keyframe in keyframes:
            rows = np.flatnonzero((keyframe.point >= 0) & np.isfinite(keyframe.disparity))
            rows = rows[self.map.views[keyframe.point[rows]] == 1]
            p_C = self.ranging.back_project(keyframe.uv[rows], keyframe.disparity[rows])
            good = np.isfinite(p_C[:, 0])
            self.map.xyz[keyframe.point[rows[good]]] = transform_points(keyframe.T_W_C, p_C[good])

    def _drop_outliers(
        self, keyframes: list[KeyFrame], poses: Array, points: Array, ids: Ints, kf: Ints, row: Ints, pt: Ints, uv: Array,
        disparity: Array, sigma: Array,
    ) -> None:
        limit = 1.5 * self.config.pose.outlier_sigmas
        r = window_residuals(poses, points, kf, pt, uv, disparity, self.ranging.cam, self.ranging.calib)
        bad = ~(np.hypot(r[:, 0], r[:, 1]) < limit * sigma)
        bad_d = np.abs(r[:, 2]) > 1.5 * limit * self.ranging.sigma_d
        for i in np.flatnonzero(bad_d).tolist():
            keyframes[kf[i]].disparity[row[i]] = np.nan
        for i in np.flatnonzero(bad).tolist():
            self.map.drop_observation(keyframes[kf[i]].number, int(row[i]))
        for point in np.unique(pt[bad]).tolist():
            if len(self.map.observers[ids[point]]) < 2:
                self.map.drop_point(int(ids[point]))

    def _cull_keyframes(self) -> None:
        """Key-frames that only supported the window go when they leave it; the one before carries their frames."""
        numbers = sorted(self.map.keyframes)
        for k in range(1, len(numbers) - self.config.mapping.window):
            if not self.map.keyframes[numbers[k]].stays:
                parent = next(n for n in reversed(numbers[:k]) if n in self.map.keyframes)
                self.map.cull_keyframe(numbers[k], parent)
