"""The tracker: finds patches of the last key-frame where the predicted pose projects them, then estimates the robust
pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3, se3_inverse, transform_points

from ..config import OdometryConfig
from ..estimation.absolute_pose import absolute_pose
from ..estimation.pose_refinement import SeenPoints, refine_pose
from ..frames import Frame
from ..image.optical_flow import follow, follow_both_ways
from ..image.patch_alignment import half_sized
from ..image.used_pixels import are_used
from ..mapping.map import FrameObservations, Map
from ..mapping.range_sensor import Ranging
from ..reason import NO_REASON, Reason
from .carried import MotionSoFar, PossibleStep, borne_out, doubt_carried, hidden_still, proven
from .doubt import PointsFound, doubt
from .epipolar import depth_around, on_epipolar_line
from .followed_points import FollowedPoints, TrackedFrame
from .point_search import PointSearch
from .standing import StandingCamera, doubt_held

Array = NDArray[np.float64]
_DEPTHS = (1.0, 0.5, 2.0)
"""Shares of that depth at which they are looked for."""
_FLOW_HOLDS = 0.5
"""Where flow finds this share of points no other search is worth its time."""
_FEW_KNOWN = 35
"""Nor where this many points of known position agree: the track is safe, and points found at a supposed depth are less
exact than those that flow finds."""
_LOOK_AGAIN_PX = 3.0
"""A prediction this wrong (median) has misled the search: what was not found is looked for again from the pose
found."""


@dataclass(frozen=True)
class _Fit:
    """The pose that explains where points were found. ``predicted``: the pose that the search began from; ``uv``
    ``(n, 2)`` pixels, ``found`` ``(n,)``; ``inlier`` ``(n,)``: those that agree with ``result``."""

    predicted: Array
    uv: Array
    found: NDArray[np.bool_]
    result: TrackedFrame
    inlier: NDArray[np.bool_]


class Tracker:
    """Owns the points that are followed, and the last frame: its image, time and pose ``T_C_W``."""

    def __init__(self, ranging: Ranging, config: OdometryConfig) -> None:
        self.ranging, self.config = ranging, config
        self.image: list[NDArray[np.uint8]] = []
        self.stamp_ns = 0
        nothing = FrameObservations(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
        self.followed = FollowedPoints.at_keyframe(nothing, [])
        self.anchor_T: Array = np.eye(4)
        self.T_C_W: Array = np.eye(4)
        self.standing = StandingCamera()
        self.motion: Array | None = None
        """``T_C1_C0`` of the last step ..."""
        self.step_s = 0.0
        """... and its duration; unknown is 0."""
        self.so_far = MotionSoFar(ranging.rig.metric)
        """That step, and those before, for what a camera can do."""
        self.lost = False
        """Whether the frame before has no pose."""

    def start(self, frame: Frame, T_C_W: Array, seen: FrameObservations) -> None:
        """Follow the points ``seen`` in this frame from here on."""
        if self.stamp_ns != frame.stamp_ns or not self.image:
            self.image = half_sized(frame.image, self.config.flow.align_levels)
        self.stamp_ns = frame.stamp_ns
        self.T_C_W, self.anchor_T = T_C_W, T_C_W
        self.followed = FollowedPoints.at_keyframe(seen, self.image)
        self.motion, self.lost = None, False

    def track(self, frame: Frame, map_: Map, predicted: Array | None = None) -> TrackedFrame:
        """Find the points in ``frame`` and its pose, which is ``predicted``, or by the motion so far. On failure the
        state stays as it was."""
        image = half_sized(frame.image, self.config.flow.align_levels)
        search = self._searched(frame, image, map_)
        dt = (frame.stamp_ns - self.stamp_ns) / 1e9
        # Patches of the key-frame, searched where the motion so far would put them ...
        fit = self._fit_from(search, self.predict(frame) if predicted is None else predicted)
        known = np.isfinite(search.xyz[:, 0])
        if fit.result.T_C_W is None or fit.result.inliers < self.config.pose.trusted_share * int(known.sum()):
            # ... and where that finds too few, where flow from the previous frame has taken them.
            rough = self._rough_pose(search)
            again = None if rough is None else self._fit_from(search, rough)
            if again is not None and again.result.inliers > fit.result.inliers:
                fit = again
        fit = self._unless_carried(search, self._stand(search, self._look_again(search, fit)), dt)
        T_C_W = fit.result.T_C_W
        self.lost = T_C_W is None
        if T_C_W is None:
            return fit.result
        points = self._points_found(search, fit)
        if self.standing.held:
            why = doubt_held(points, len(fit.found))
        elif fit.result.doubt.kind:
            why = fit.result.doubt
        else:
            why = doubt(T_C_W, points, self.ranging, self.config.pose.pixel_sigma_px)
        result = replace(fit.result, doubt=why)
        uv, found = self._follow_unknown(search, fit, T_C_W)
        self.so_far = self.so_far.after(self.T_C_W, T_C_W, dt)
        self.motion, self.step_s = product(T_C_W, se3_inverse(self.T_C_W)), dt
        self.image, self.stamp_ns, self.T_C_W = image, frame.stamp_ns, T_C_W
        found = np.where(known, fit.inlier, found & self.followed.found)
        uv = np.where(found[:, None], uv, self.followed.uv)
        self.followed = replace(self.followed, uv=uv, found=found, agreed=self.followed.agreed + fit.inlier)
        return result

    def _searched(self, frame: Frame, image: list[NDArray[np.uint8]], map_: Map) -> PointSearch:
        followed, at = self.followed, self.followed.point
        known = proven(map_.views[at], followed.agreed)
        return PointSearch(frame, image, map_.xyz[at], known, followed, self.anchor_T, self.ranging, self.config)

    def _points_found(self, search: PointSearch, fit: _Fit) -> PointsFound:
        before = np.where(self.followed.found[:, None], self.followed.uv, np.nan)
        at = fit.found
        return PointsFound(search.xyz[at], fit.uv[at], before[at], fit.inlier[at])

    def _stand(self, search: PointSearch, fit: _Fit) -> _Fit:
        """Where a part of a standing camera's points stands on, the pose is theirs, not that of what moves, and where
        they are too few, the last one."""
        points = self._points_found(search, fit)
        if fit.result.T_C_W is None:
            left = self.standing.left_alone(points)
            if left is None:
                return fit
            self.standing = left
        else:
            at = search.xyz[fit.found]
            away = self.ranging.project(fit.result.T_C_W, at)[0] - self.ranging.project(self.T_C_W, at)[0]
            self.standing = self.standing.after(points, np.nan_to_num(np.hypot(*away.T)), len(fit.found))
        if not self.standing.held:
            return fit
        still = np.zeros(len(fit.found), dtype=bool)
        still[np.flatnonzero(fit.found)[points.still]] = True
        standing = self._fit(search, self.T_C_W, fit.uv, still)
        T_C_W = standing.result.T_C_W
        if T_C_W is None and not self.standing.certain:
            return fit
        inlier = search.agreeing(fit.uv, fit.found, self.T_C_W if T_C_W is None else T_C_W)
        kept = TrackedFrame(self.T_C_W if T_C_W is None else T_C_W, int(inlier.sum()))
        return replace(fit, result=kept, inlier=inlier)

    def _unless_carried(self, search: PointSearch, fit: _Fit, dt: float) -> _Fit:
        """Where the camera cannot have moved so and most of what was known is hidden, the pose is that of the points
        known not to move, or none at all."""
        if fit.result.T_C_W is None or self.standing.held:
            return fit
        expected = search.proven & search.in_view(fit.result.T_C_W)
        hidden = hidden_still(int(fit.inlier.sum()), int(expected.sum())) if self.lost else NO_REASON
        if hidden.kind:
            return replace(fit, result=TrackedFrame(None, fit.result.inliers, hidden))
        step = self._step(search, fit, dt)
        if step.possible or borne_out(fit.inlier, expected):
            return fit
        steady = self._fit(search, self.predict(search.frame), fit.uv, fit.found & search.proven).result
        if steady.T_C_W is not None:
            inlier = search.agreeing(fit.uv, fit.found, steady.T_C_W)
            count = int(inlier.sum())
            why = doubt_carried(count, int(fit.found.sum()))
            kept = replace(fit, result=TrackedFrame(steady.T_C_W, count, doubt=why), inlier=inlier)
            if count and self._step(search, kept, dt).beyond <= step.bound:
                return kept
        return replace(fit, result=TrackedFrame(None, 0, step.refusal))

    def _step(self, search: PointSearch, fit: _Fit, dt: float) -> PossibleStep:
        assert fit.result.T_C_W is not None
        depth = float(np.median(transform_points(fit.result.T_C_W, search.xyz[fit.inlier])[:, 2]))
        return self.so_far.step(self.T_C_W, fit.result.T_C_W, dt, depth)

    def predict(self, frame: Frame) -> Array:
        """``T_C_W`` of ``frame`` by the last step, where that is of use; else the last pose."""
        dt = (frame.stamp_ns - self.stamp_ns) / 1e9
        regular = (
            self.step_s > 0.0 and 0.3 * self.step_s < dt < 3.0 * self.step_s and dt <= self.config.pose.max_frame_gap_s
        )
        return product(self.motion, self.T_C_W) if self.motion is not None and regular else self.T_C_W

    def _fit_from(self, search: PointSearch, T_C_W: Array) -> _Fit:
        """The pose by points looked for where ``T_C_W`` predicts them."""
        return self._fit(search, T_C_W, *search.find(T_C_W))

    def _rough_pose(self, search: PointSearch) -> Array | None:
        """A pose without any prediction: wide flow from the previous frame, then RANSAC."""
        index = np.flatnonzero(self.followed.found & np.isfinite(search.xyz[:, 0]))
        before = self.followed.uv[index]
        uv, ok = follow(self.image[0], search.frame.image, before, before, self.config.flow)
        ok &= are_used(search.frame.used, uv)
        error_px = 8.0 * self.config.pose.pixel_sigma_px
        return absolute_pose(search.xyz[index[ok]], self.ranging.ideal(uv[ok]), self.ranging.cam, error_px)

    def _look_again(self, search: PointSearch, fit: _Fit) -> _Fit:
        """Where the prediction was wrong, look from the pose found for the points that do not agree with it."""
        if fit.result.T_C_W is None:
            return fit
        before, _ = self.ranging.project(fit.predicted, search.xyz[fit.inlier])
        after, _ = self.ranging.project(fit.result.T_C_W, search.xyz[fit.inlier])
        if np.median(np.linalg.norm(after - before, axis=1)) < _LOOK_AGAIN_PX:
            return fit
        uv, found = search.find(fit.result.T_C_W, ~fit.inlier)
        uv, found = np.where(fit.inlier[:, None], fit.uv, uv), fit.inlier | found
        again = self._fit(search, fit.result.T_C_W, uv, found)
        return again if again.result.inliers >= fit.result.inliers else fit

    def _fit(self, search: PointSearch, predicted: Array, uv: Array, found: NDArray[np.bool_]) -> _Fit:
        """The pose by the points ``found`` ``(n,)`` at ``uv`` ``(n, 2)``; with RANSAC where ``predicted`` misleads."""
        settings, inlier = self.config.pose, np.zeros(len(uv), dtype=bool)
        index = np.flatnonzero(found)
        n = len(index)
        if n < settings.min_inliers:
            refusal = Reason.few("too few points found again", n, settings.min_inliers, f"of {len(uv)} points found")
            return _Fit(predicted, uv, found, TrackedFrame(None, 0, refusal), inlier)
        sigma = np.full(n, settings.pixel_sigma_px)
        seen = SeenPoints.without_depth(search.xyz[index], self.ranging.ideal(uv[index]), sigma)
        T, good, _ = refine_pose(predicted, seen, self.ranging.cam, settings.outlier_sigmas, 4)
        if good.sum() < max(settings.min_inliers, 0.5 * n):
            T_ransac = absolute_pose(seen.points, seen.uv, self.ranging.cam, 4.0 * settings.pixel_sigma_px)
            if T_ransac is not None:
                T2, good2, _ = refine_pose(T_ransac, seen, self.ranging.cam, settings.outlier_sigmas, 4)
                if good2.sum() > good.sum():
                    T, good = T2, good2
        count = int(good.sum())
        if count < settings.min_inliers or not np.isfinite(T).all():
            what = f"of {n} points agree on a pose"
            refusal = Reason.few("too few points agree on a pose", count, settings.min_inliers, what)
            return _Fit(predicted, uv, found, TrackedFrame(None, count, refusal), inlier)
        inlier[index] = good
        return _Fit(predicted, uv, found, TrackedFrame(T, count), inlier)

    def _follow_unknown(self, search: PointSearch, fit: _Fit, T_C_W: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Pixels ``(n, 2)`` and found ``(n,)`` of ``fit``, joined by the points of unknown position: flow from where
        the turn of the camera takes them, then their patches as they would look at the depth of their neighbours; they
        must move along their epipolar line."""
        index = np.flatnonzero(np.isnan(search.xyz[:, 0]) & self.followed.found)
        if not len(index):
            return fit.uv, fit.found
        turn = product(T_C_W[:3, :3], self.T_C_W[:3, :3].T)
        start = self.followed.uv[index]
        far, _ = self.ranging.project(se3(turn, np.zeros(3)), self.ranging.rays(start))
        guess = np.where(np.isfinite(far), far, start)
        at, good = follow_both_ways(self.image[0], search.frame.image, start, guess, self.config.flow)
        good &= are_used(search.frame.used, at) & self._on_line(start, at, T_C_W)
        uv, found = fit.uv.copy(), fit.found.copy()
        uv[index], found[index] = at, good
        in_need = fit.result.inliers < _FEW_KNOWN and good.sum() < _FLOW_HOLDS * len(index)
        for share in _DEPTHS if in_need else ():
            lost = index[~found[index]]
            at, good = self._find_at_depth(search, fit, T_C_W, lost, share)
            uv[lost[good]], found[lost[good]] = at[good], True
        return uv, found

    def _find_at_depth(
        self, search: PointSearch, fit: _Fit, T_C_W: Array, index: NDArray[np.intp], share: float
    ) -> tuple[Array, NDArray[np.bool_]]:
        """Pixels and found of points ``index`` of unknown position, looked for by their patches as if they were at
        ``share`` of the depth of what is seen around them: where much passes near the camera flow loses them."""
        start = self.followed.uv[index]
        known = np.flatnonzero(fit.inlier & self.followed.found)
        depth = transform_points(self.T_C_W, search.xyz[known])[:, 2]
        supposed = self.ranging.rays(start) * (share * depth_around(start, self.followed.uv[known], depth))[:, None]
        xyz = np.full((len(self.followed.uv), 3), np.nan)
        xyz[index] = transform_points(se3_inverse(self.T_C_W), supposed)
        uv, found = replace(search, xyz=xyz).find(T_C_W)
        return uv[index], found[index] & self._on_line(start, uv[index], T_C_W)

    def _on_line(self, before: Array, after: Array, T_C_W: Array) -> NDArray[np.bool_]:
        return on_epipolar_line(self.ranging, product(T_C_W, se3_inverse(self.T_C_W)), before, after)
