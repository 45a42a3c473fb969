"""Map points of images whose poses another system gave: the poses stay as they are, points are placed by them.

Key-frames are chosen by motion, ORB key-points are matched with known points where these fall by the poses, and along
epipolar lines with points that wait for a second ray. A point takes its place from depth or a second camera where there
is one, else from its rays; all rays together refine it at the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, rotation_angle_deg, se3_inverse, transform_points

from ..cameras.models import Rig
from ..config import OdometryConfig
from ..estimation.fixed_pose_points import PointRays, refine_points
from ..estimation.triangulation import triangulate
from ..files.point_views import PointViews
from ..frames import Frame
from ..image.guided_matching import OrbFeatures, guided_match
from ..image.optical_flow import follow
from ..image.orb_features import Detector, Keypoints, Pyramid, describe
from .map import Array, Ints, Map, MapKeyFrame, union
from .pose_agreement import (
    MatchedRays,
    PairAgreement,
    PosedView,
    all_epipolar_distances,
    matched_rays,
    mutual_matches,
    rays_agreement,
    relative,
)
from .range_sensor import Ranging

_START_PARALLAX_DEG = 1.5
"""Median angle between rays that makes a key-frame as long as no depth is known."""
_LEAST_DEPTHS = 30
_IN_SIGHT = 0.6
"""Share of the last key-frame's points below which a new key-frame is made, however little the camera moved."""
_KEPT_PAIRS = 120
_WAITING_KEYFRAMES = 2
"""Key-frames back in which points that wait for a second ray are looked for."""
_EPIPOLAR_PX, _EPIPOLAR_SHARE = 2.0, 0.004
_RAYS = 3
"""Key-frames that must see a point whose depth nothing measured: two rays always meet nearly."""


@dataclass(frozen=True, eq=False)
class GivenMap:
    """K key-frames, P points, N observations of one track with given poses.

    ``frames`` ``(K,)`` frame indices, ``stamps_ns`` ``(K,)``, ``poses`` ``(K, 4, 4)`` ``T_W_C`` as given, ``points``
    ``(P, 3)``, ``views`` with ``descriptors`` ``(N, 32)`` in their order. ``error_px``: median distance of a point from
    where it was seen; ``agreement``: of each key-frame with the one before, where they could be compared; ``matched``:
    by what, of some pairs all along the path; ``measured``: points whose depth was measured.
    """

    frames: Ints
    stamps_ns: Ints
    poses: Array
    points: Array
    views: PointViews
    descriptors: NDArray[np.uint8]
    error_px: float
    agreement: tuple[PairAgreement, ...]
    matched: tuple[MatchedRays, ...]
    measured: int

    def __len__(self) -> int:
        return len(self.frames)


class GivenPoseMapper:
    """Builds the map of one track; frames in order of time. ``wants`` and ``wants_image`` choose key-frames, ``insert``
    takes one, ``finish`` returns the map."""

    def __init__(self, rig: Rig, config: OdometryConfig) -> None:
        self.ranging, self.config, self.map = Ranging(rig, config.stereo, config.flow), config, Map()
        self.agreement: list[PairAgreement] = []
        self._matched: list[MatchedRays] = []
        self._every, self._compared = 1, 0
        self._detector = Detector(config.features)
        self._log_scale = np.log(config.features.scale_factor)
        self._last: MapKeyFrame | None = None
        self._image: NDArray[np.uint8] | None = None

    def wants(self, T_W_C: Array) -> bool | None:
        """Whether a camera there becomes a key-frame; None where only its image can say."""
        last, settings = self._last, self.config.keyframes
        if last is None:
            return True
        step = product(last.T_C_W, T_W_C)
        if float(rotation_angle_deg(step[:3, :3])) >= settings.keep_angle_deg:
            return True
        points = self.map.xyz[last.point[last.point >= 0]]
        points = points[np.isfinite(points[:, 0])]
        if len(points) < _LEAST_DEPTHS:
            return None
        depth = float(np.median(transform_points(last.T_C_W, points)[:, 2]))
        if float(np.linalg.norm(step[:3, 3])) >= settings.keep_distance * depth:
            return True
        uv, z = self.ranging.project(se3_inverse(T_W_C), points)
        return bool(self._inside(uv, z).mean() < _IN_SIGHT)

    def wants_image(self, image: NDArray[np.uint8], T_W_C: Array) -> bool:
        """As :meth:`wants`, by the parallax that the image shows against the last key-frame's."""
        last = self._last
        assert last is not None and self._image is not None
        rows = np.arange(0, len(last.uv), max(1, len(last.uv) // 200))
        R, _ = relative(last.T_C_W, se3_inverse(T_W_C))
        rays = self.ranging.rays(last.uv[rows])
        far, z = self.ranging.project(np.eye(4), product(rays, R.T))
        guess = np.where((z > 0)[:, None] & np.isfinite(far), far, last.uv[rows])
        uv, found = follow(self._image, image, last.uv[rows], guess, self.config.flow)
        if found.sum() < _LEAST_DEPTHS:
            return True
        a, b = product(rays[found], R.T), self.ranging.rays(uv[found])
        cosine = (a * b).sum(axis=1) / (np.linalg.norm(a, axis=1) * np.linalg.norm(b, axis=1))
        return float(np.median(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))) >= _START_PARALLAX_DEG

    def insert(self, frame: Frame, T_W_C: Array) -> None:
        """Make ``frame``, seen from the given ``T_W_C``, a key-frame."""
        features, T_C_W = self.config.features, se3_inverse(T_W_C)
        pyramid = Pyramid(frame.image, features.levels, features.scale_factor, frame.used)
        uv, level, _ = self._detector.detect(pyramid, features.tracks + features.landmarks, np.zeros((0, 2)))
        every = describe(pyramid, uv, level)
        rows = np.flatnonzero(np.isfinite(every.angle_deg))
        seen = Keypoints(every.uv[rows], every.level[rows], every.angle_deg[rows], every.descriptors[rows])
        point = self._known(T_C_W, seen)
        self._find_waiting(T_C_W, seen, point)
        fresh = point < 0
        point[fresh] = self.map.add_points(int(fresh.sum()))
        depth = transform_points(T_C_W, self.map.xyz[point])[:, 2]
        disparity, row = self.ranging.measure(frame, seen.uv, np.where(depth > 0, depth, np.nan))
        number = len(self.map.keyframes)
        keyframe = MapKeyFrame(
            number=number,
            frame_index=frame.index,
            stamp_ns=frame.stamp_ns,
            T_C_W=T_C_W,
            uv=seen.uv,
            disparity=disparity,
            row=row,
            point=point,
            sigma=features.scale_factor ** seen.level.astype(np.float64),
            level=seen.level,
            descriptors=seen.descriptors,
            described=np.ones(len(point), dtype=bool),
            followed=np.ones(len(point), dtype=bool),
        )
        self.map.insert(keyframe)
        self._place(keyframe)
        self._triangulate(keyframe)
        self._compare(keyframe)
        self._last, self._image = keyframe, frame.image

    def finish(self) -> GivenMap:
        """The map with refined points; those that too few views agree on are left out."""
        keyframes = list(self.map.keyframes.values())
        kf = np.concatenate([np.full(len(k.point), n) for n, k in enumerate(keyframes)])
        point = np.concatenate([k.point for k in keyframes])
        known = np.isfinite(self.map.xyz[point, 0])
        rows = np.flatnonzero(known)[np.lexsort((kf[known], point[known]))]
        uv = np.concatenate([self.ranging.ideal(k.uv) for k in keyframes])
        disparity = np.concatenate([self.ranging.corrected(k.uv, k.disparity) for k in keyframes])
        sigma = np.concatenate([k.sigma for k in keyframes])
        ids, number = np.unique(point[rows], return_inverse=True)
        rays = PointRays(
            kf[rows], number.astype(np.int64), uv[rows], sigma[rows], disparity[rows], self.ranging.sigma_d
        )
        T_C_W = np.stack([k.T_C_W for k in keyframes])
        points, kept, error_px = refine_points(T_C_W, self.map.xyz[ids], rays, self.ranging.cam)
        enough = np.bincount(number[kept], minlength=len(ids)) >= np.where(
            self.map.metric[ids], 1, min(_RAYS, len(keyframes))
        )
        kept &= enough[number]
        used, again = np.unique(number[kept], return_inverse=True)
        order = np.lexsort((again, kf[rows][kept]))
        chosen = rows[kept][order]
        descriptors = np.concatenate([k.descriptors for k in keyframes])[chosen]
        return GivenMap(
            frames=np.array([k.frame_index for k in keyframes], dtype=np.int64),
            stamps_ns=np.array([k.stamp_ns for k in keyframes], dtype=np.int64),
            poses=np.stack([k.T_W_C for k in keyframes]),
            points=points[used],
            views=PointViews.sorted(kf[chosen], again[order], uv[chosen]),
            descriptors=descriptors,
            error_px=error_px,
            agreement=tuple(self.agreement),
            matched=tuple(self._matched),
            measured=int(self.map.metric[ids[used]].sum()),
        )

    def _inside(self, uv: Array, depth: Array) -> NDArray[np.bool_]:
        camera = self.ranging.rig.camera
        high = np.array([camera.width, camera.height])
        return np.asarray((depth > 0) & (uv >= 0).all(axis=1) & (uv < high).all(axis=1))

    def _known(self, T_C_W: Array, seen: Keypoints) -> Ints:
        """Map point ``(n,)`` of each key-point that falls where a known point should and looks like it, else -1."""
        out = np.full(len(seen), -1, dtype=np.int64)
        ids = union([self.map.keyframes[k].point for k in self.map.latest(self.config.mapping.window)])
        ids = ids[np.isfinite(self.map.xyz[ids, 0])]
        if not len(ids) or not len(out):
            return out
        uv, depth = self.ranging.project(T_C_W, self.map.xyz[ids])
        shown = self._inside(uv, depth)
        ids, uv, depth = ids[shown], uv[shown], depth[shown]
        closer = np.maximum(self.map.depth[ids], 1e-12) / depth
        level = self.map.level[ids] + np.log(np.where(np.isfinite(closer), closer, 1.0)) / self._log_scale
        settings = self.config.mapping
        radius = settings.match_radius_px * self.config.features.scale_factor ** np.clip(level, 0, 8)
        predicted = OrbFeatures(uv, level, self.map.descriptors[ids])
        match = guided_match(predicted, radius, seen.features(), settings)
        hit = match >= 0
        out[match[hit]] = ids[hit]
        return out

    def _find_waiting(self, T_C_W: Array, seen: Keypoints, point: Ints) -> None:
        """Give ``point`` ``(n,)`` the points of the latest key-frames that wait for a second ray and are seen here."""
        camera = self.ranging.rig.camera
        limit = max(_EPIPOLAR_PX, _EPIPOLAR_SHARE * camera.width) / camera.fx
        rays = self.ranging.rays(seen.uv)
        for number in reversed(self.map.latest(_WAITING_KEYFRAMES)):
            keyframe = self.map.keyframes[number]
            mine, free = np.flatnonzero(np.isnan(self.map.xyz[keyframe.point, 0])), np.flatnonzero(point < 0)
            mine = mine[~np.isin(keyframe.point[mine], point)]
            R, t = relative(keyframe.T_C_W, T_C_W)
            if not len(mine) or not len(free) or float(np.linalg.norm(t)) < 1e-9:
                continue
            near = all_epipolar_distances(self.ranging.rays(keyframe.uv[mine]), rays[free], R, t) < limit
            level = np.abs(keyframe.level[mine, None].astype(int) - seen.level[None, free])
            pairs = mutual_matches(keyframe.descriptors[mine], seen.descriptors[free], near & (level <= 1))
            point[free[pairs[:, 1]]] = keyframe.point[mine[pairs[:, 0]]]

    def _place(self, keyframe: MapKeyFrame) -> None:
        """Points without a place get the one that this key-frame measured."""
        rows = np.flatnonzero(np.isnan(self.map.xyz[keyframe.point, 0]))
        p_C = self.ranging.back_project(keyframe.uv[rows], keyframe.disparity[rows])
        good = np.isfinite(p_C[:, 0])
        ids = keyframe.point[rows[good]]
        self.map.xyz[ids] = transform_points(keyframe.T_W_C, p_C[good])
        self.map.metric[ids] = True
        self.map.depth[ids] = p_C[good, 2]

    def _triangulate(self, keyframe: MapKeyFrame) -> None:
        """Points without a place get one where their rays have parallax by now."""
        ids = keyframe.point[np.isnan(self.map.xyz[keyframe.point, 0]) & (self.map.views[keyframe.point] >= 2)]
        if not len(ids):
            return
        views = [view for i in ids.tolist() for view in self.map.observers[i]]
        numbers, kf = np.unique([number for number, _ in views], return_inverse=True)
        poses = np.stack([self.map.keyframes[int(number)].T_C_W for number in numbers])
        start = np.concatenate([[0], np.cumsum(self.map.views[ids])]).astype(np.int64)
        uv = np.array([self.map.keyframes[number].uv[row] for number, row in views])
        points, parallax = triangulate(poses, start, kf.astype(np.int64), self.ranging.rays(uv))
        good = np.isfinite(points[:, 0]) & (parallax > np.radians(self.config.mapping.min_parallax_deg))
        self.map.xyz[ids[good]] = points[good]
        self.map.depth[ids[good]] = transform_points(keyframe.T_C_W, points[good])[:, 2]

    def _compare(self, keyframe: MapKeyFrame) -> None:
        """Note how far this key-frame and the one before agree with their poses."""
        if self._last is None:
            return
        camera = self.ranging.rig.camera
        matched = matched_rays(self._view(self._last), self._view(keyframe))
        found = None if matched is None else rays_agreement(matched, camera.fx, camera.width)
        if matched is not None and found is not None:
            self.agreement.append(found)
            self._keep(matched)

    def _keep(self, matched: MatchedRays) -> None:
        """Every so-manieth pair, so that a long path's are few and lie all along it."""
        if self._compared % self._every == 0:
            self._matched.append(matched)
        self._compared += 1
        if len(self._matched) > _KEPT_PAIRS:
            self._matched, self._every = self._matched[::2], 2 * self._every

    def _view(self, keyframe: MapKeyFrame) -> PosedView:
        depth = self.ranging.back_project(keyframe.uv, keyframe.disparity)[:, 2]
        return PosedView(self.ranging.rays(keyframe.uv), keyframe.descriptors, depth, keyframe.T_C_W)
