"""Starting a track: from one view where depth is measured, from two or more where it is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..cameras.models import RigKind
from ..config import OdometryConfig
from ..estimation.several_views import SeveralViews
from ..frames import Frame
from ..image.optical_flow import follow_both_ways
from ..image.orb_features import Detector, Pyramid, spread_cells
from ..image.used_pixels import are_used
from ..mapping.map import FrameObservations, MapKeyFrame
from ..mapping.range_sensor import Ranging
from ..reason import NO_REASON, Reason
from ..stopwatch import Stopwatch
from .first_view import UNMOVED, FirstView, least_matches
from .track import Segment

_RENEW = 0.75
"""Share of a first view's corners below which the next first view is taken beside it."""
_FIRST_VIEWS = 3
TOO_FEW_FEATURES = "too few features in the image"
SAME_IMAGES = "all disparities are 0: left and right are the same image"
SAME_IMAGE_PX = 0.1
"""Disparity that nearly all points of a pair of equal images stay below, also where each was compressed by itself."""
WITHOUT_SECOND = ("the right image is missing", "the depth image is missing")
"""Refusals that are not about the image itself."""


@dataclass(frozen=True)
class Start:
    """A track that has begun, or None and the refusal. ``first``: the earlier of the two views it began with
    (monocular)."""

    segment: Segment | None
    refusal: Reason = NO_REASON
    first: Frame | None = None

    @property
    def reason(self) -> str:
        """Why no track has begun, with figures."""
        return self.refusal.text


class Starter(Protocol):
    """Strategy that starts a track from the frames offered to it."""

    def offer(self, frame: Frame) -> Start:
        """Try to start with this frame."""
        ...


def make_starter(ranging: Ranging, config: OdometryConfig, watch: Stopwatch | None = None) -> Starter:
    """The starter that the rig allows."""
    return MetricStarter(ranging, config, watch) if ranging.rig.metric else MonoStarter(ranging, config, watch)


class MetricStarter:
    """One view with depth: its points are placed at once."""

    def __init__(self, ranging: Ranging, config: OdometryConfig, watch: Stopwatch | None = None) -> None:
        self.ranging, self.config, self.watch = ranging, config, watch

    def offer(self, frame: Frame) -> Start:
        """Refuses a frame without its second image, and one with too few points with depth."""
        if self.ranging.rig.kind is RigKind.STEREO and frame.right is None:
            return Start(None, _without(0, frame))
        if self.ranging.rig.kind is RigKind.RGBD and frame.depth_m is None:
            return Start(None, _without(1, frame))
        segment = Segment(self.ranging, self.config, self.watch)
        nothing = FrameObservations(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
        segment.latest = segment.mapper.insert(frame, np.eye(4), nothing)
        segment.follow(frame)
        placed = int(np.isfinite(segment.map.xyz[segment.tracker.followed.point, 0]).sum())
        need = 2 * self.config.pose.min_inliers
        if placed < need:
            return Start(None, self._unplaced(segment.latest, placed, need))
        return Start(segment)

    def _unplaced(self, keyframe: MapKeyFrame, placed: int, need: int) -> Reason:
        """Why a view has too few points with depth: hardly any feature (fog, blur, a bare wall), twice the same image,
        or neither."""
        if len(keyframe.uv) < need:
            return Reason.few(TOO_FEW_FEATURES, len(keyframe.uv), need, "features in the image")
        known = np.abs(keyframe.disparity[np.isfinite(keyframe.disparity)])
        if self.ranging.rig.kind is RigKind.STEREO and len(known) >= need and np.quantile(known, 0.95) < SAME_IMAGE_PX:
            return Reason(SAME_IMAGES, f"{SAME_IMAGES}: {len(known)} points lie at the same place in both")
        return Reason.few("too few points with depth", placed, need, "points with depth in the image")


def _without(second: int, frame: Frame) -> Reason:
    return Reason(WITHOUT_SECOND[second], frame.problem or WITHOUT_SECOND[second])


class MonoStarter:
    """Views far enough apart: corners of a first view are followed until their motion gives away the camera's (thesis
    2.1.3). When a part of them is lost, a second first view is taken beside it, so that no parallax gained is thrown
    away, and near points that came into view later have their turn."""

    def __init__(self, ranging: Ranging, config: OdometryConfig, watch: Stopwatch | None = None) -> None:
        self.ranging, self.config, self.watch = ranging, config, watch
        self._views: list[FirstView] = []
        self._last: Frame | None = None
        self._rested = False

    def offer(self, frame: Frame) -> Start:
        """Refuses views by a camera that stands or only turns, and views that leave two motions open."""
        self._follow(frame)
        refusals: list[Reason] = []
        for view in self._views:
            motion = view.motion()
            started = self._build(view, frame, motion) if motion.T_2_1 is not None else Start(None, motion.refusal)
            if started.segment is not None:
                return started
            refusals.append(started.refusal)
        self._rested = any(view.rested for view in self._views) if self._views else self._rested
        kept = [k for k, refusal in enumerate(refusals) if not self._spent(self._views[k], frame, refusal)]
        self._views = [self._views[k] for k in kept]
        # The reason is that of the oldest view that goes on; of one that ends here where none does.
        refusals = [refusals[k] for k in kept] or refusals[-1:]
        return Start(None, self._renew(frame, refusals[0] if refusals else None))

    def _follow(self, frame: Frame) -> None:
        if self._last is not None and self._views:
            before = np.concatenate([view.uv for view in self._views])
            uv, ok = follow_both_ways(self._last.image, frame.image, before, before, self.config.flow)
            ok &= are_used(frame.used, uv)
            ends = np.cumsum([len(view) for view in self._views])[:-1]
            for view, at, found in zip(self._views, np.split(uv, ends), np.split(ok, ends), strict=True):
                view.follow(at, found)
        self._last = frame

    def _spent(self, view: FirstView, frame: Frame, refusal: Reason) -> bool:
        """Whether a first view has too few corners left, or was refused too long although the camera moved."""
        mono = self.config.mono
        old = frame.index - view.frame.index >= mono.max_frames and refusal.kind not in UNMOVED
        return old or len(view) < least_matches(mono)

    def _renew(self, frame: Frame, refusal: Reason | None) -> Reason:
        """Take ``frame`` as a first view where none is left, or beside the newest where that has lost many corners;
        return the reason of this frame."""
        if self._views and self._views[-1].left >= _RENEW:
            return refusal or NO_REASON
        features, least = self.config.features, least_matches(self.config.mono)
        pyramid = Pyramid(frame.image, features.levels, features.scale_factor, frame.used)
        uv, _, _ = Detector(features).detect(pyramid, 2 * features.tracks, np.zeros((0, 2)))
        chosen = spread_cells(uv, np.zeros((0, 2)), frame.image.shape[1], frame.image.shape[0], 2 * features.tracks)
        if len(chosen) >= least:
            view = FirstView(frame, uv[chosen], self.ranging, self.config, self._rested)
            # The oldest has the most parallax, the newest the most points.
            self._views = [*self._views[:1], *self._views[1:][2 - _FIRST_VIEWS :], view]
            return refusal or Reason("first view of a start", "first view taken, waiting for a second")
        if self._views and refusal is not None:
            return refusal
        return Reason.few(TOO_FEW_FEATURES, len(chosen), least, "features in the image")

    def _build(self, view: FirstView, frame: Frame, motion: SeveralViews) -> Start:
        """The map of two key-frames; its unit is the median depth in the first."""
        assert motion.T_2_1 is not None
        unit = float(np.median(motion.points[:, 2]))
        T = motion.T_2_1.copy()
        T[:3, 3] /= unit
        segment = Segment(self.ranging, self.config, self.watch)
        ids = segment.map.add_points(len(motion.points))
        segment.map.xyz[ids] = motion.points / unit
        for seen, pose, uv in ((view.frame, np.eye(4), view.first_uv), (frame, T, view.uv)):
            segment.latest = segment.mapper.insert(seen, pose, FrameObservations(ids, uv[motion.good]))
            segment.follow(seen)
        known = int(np.isfinite(segment.map.xyz[segment.tracker.followed.point, 0]).sum())
        need = min(self.config.mono.min_points, len(motion.points) * 3 // 4)
        if known < need:
            return Start(None, Reason.few("too few points left", known, need, "points left after bundle adjustment"))
        return Start(segment, first=view.frame.original or view.frame)
