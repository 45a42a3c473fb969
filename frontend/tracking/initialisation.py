"""Starting a track: from one view where depth is measured, from two where it is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..cameras.models import RigKind
from ..config import OdometryConfig
from ..estimation.two_view import PointPairs, TwoViews, solve_two_views
from ..frames import Frame
from ..image.optical_flow import follow_both_ways
from ..image.orb_features import Detector, Pyramid, spread_cells
from ..mapping.map import FrameObservations
from ..mapping.range_sensor import Ranging
from ..stopwatch import Stopwatch
from .track import Segment

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Start:
    """A track that has begun, or None and the reason with its numbers. ``first``: the earlier of the two views it
    began with (monocular)."""

    segment: Segment | None
    reason: str = ""
    first: Frame | None = None


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
            return Start(None, frame.problem or "the right image is missing")
        if self.ranging.rig.kind is RigKind.RGBD and frame.depth_m is None:
            return Start(None, frame.problem or "the depth image is missing")
        segment = Segment(self.ranging, self.config, self.watch)
        nothing = FrameObservations(np.zeros(0, dtype=np.int64), np.zeros((0, 2)))
        segment.latest = segment.mapper.insert(frame, np.eye(4), nothing)
        segment.follow(frame)
        placed = int(np.isfinite(segment.map.xyz[segment.tracker.followed.point, 0]).sum())
        need = 2 * self.config.pose.min_inliers
        if placed < need:
            return Start(None, f"only {placed} points with depth in the image, need {need}")
        return Start(segment)


class MonoStarter:
    """Two views far enough apart: corners of the first are followed until their motion gives away the camera's
    (thesis 2.1.3)."""

    def __init__(self, ranging: Ranging, config: OdometryConfig, watch: Stopwatch | None = None) -> None:
        self.ranging, self.config, self.watch = ranging, config, watch
        self._first: Frame | None = None
        self._last: Frame | None = None
        self._first_uv: Array = np.zeros((0, 2))
        self._uv: Array = np.zeros((0, 2))

    def offer(self, frame: Frame) -> Start:
        """Refuses static, purely rotating and ambiguous pairs of views; the first view is renewed when too little of
        it is left."""
        if self._first is None or self._last is None:
            return self._begin(frame, "")
        uv, ok = follow_both_ways(self._last.image, frame.image, self._uv, self._uv, self.config.flow)
        self._first_uv, self._uv, self._last = self._first_uv[ok], uv[ok], frame
        settings = self.config.mono
        if len(self._uv) < settings.min_matches:
            return self._begin(
                frame, f"only {len(self._uv)} points followed from the first view, need {settings.min_matches}; "
            )
        flow = float(np.median(np.linalg.norm(self._uv - self._first_uv, axis=1)))
        need = settings.min_flow_px * frame.image.shape[1] / 640
        if flow < need:
            return Start(None, f"static: the points have moved by {flow:.2f} px (median), need {need:.1f} px")
        ideal = self.ranging.ideal(self._first_uv), self.ranging.ideal(self._uv)
        pairs = PointPairs(*ideal, self.ranging.rig.camera.K, self.config.pose.pixel_sigma_px)
        views = solve_two_views(pairs, settings)
        if views.T_2_1 is not None:
            return self._build(frame, views)
        if frame.index - self._first.index >= settings.max_frames:
            return self._begin(frame, views.reason + "; ")
        return Start(None, views.reason)

    def _begin(self, frame: Frame, why: str) -> Start:
        """Take ``frame`` as first view."""
        features = self.config.features
        pyramid = Pyramid(frame.image, features.levels, features.scale_factor)
        uv, _, _ = Detector(features).detect(pyramid, 2 * features.tracks, np.zeros((0, 2)))
        chosen = spread_cells(uv, np.zeros((0, 2)), frame.image.shape[1], frame.image.shape[0], 2 * features.tracks)
        if len(chosen) < self.config.mono.min_matches:
            self._first = None
            return Start(None, f"{why}only {len(chosen)} corners in the image, need {self.config.mono.min_matches}")
        self._first, self._last = frame, frame
        self._first_uv, self._uv = uv[chosen], uv[chosen]
        return Start(None, f"{why}first view taken, waiting for a second")

    def _build(self, frame: Frame, views: TwoViews) -> Start:
        """The map of two key-frames; its unit is the median depth in the first."""
        assert self._first is not None and views.T_2_1 is not None
        unit = float(np.median(views.points[:, 2]))
        T = views.T_2_1.copy()
        T[:3, 3] /= unit
        segment = Segment(self.ranging, self.config, self.watch)
        ids = segment.map.add_points(len(views.points))
        segment.map.xyz[ids] = views.points / unit
        for view, pose, uv in ((self._first, np.eye(4), self._first_uv), (frame, T, self._uv)):
            segment.latest = segment.mapper.insert(view, pose, FrameObservations(ids, uv[views.good]))
            segment.follow(view)
        known = int(np.isfinite(segment.map.xyz[segment.tracker.followed.point, 0]).sum())
        if known < self.config.mono.min_points:
            return self._begin(
                frame, f"only {known} points left after bundle adjustment, need {self.config.mono.min_points}; "
            )
        return Start(segment, first=self._first)
