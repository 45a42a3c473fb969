"""Starting a track: from one view where depth is measured, from two where it is not."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from frontend.cameras import RigKind
from frontend.config import OdometryConfig
from frontend.frames import Frame
from frontend.segment import Segment
from frontend.stereo import Ranging


@dataclass(frozen=True)
class Start:
    """A track that has begun, or None and the reason with its numbers."""

    segment: Segment | None
    reason: str = ""


class Starter(Protocol):
    def offer(self, frame: Frame) -> Start:
        """Try to start with this frame."""
        ...


def make_starter(ranging: Ranging, config: OdometryConfig) -> Starter:
    return MetricStarter(ranging, config)


class MetricStarter:
    """One view with depth: its points are placed at once."""

    def __init__(self, ranging: Ranging, config: OdometryConfig) -> None:
        self.ranging, self.config = ranging, config

    def offer(self, frame: Frame) -> Start:
        if self.ranging.rig.kind is RigKind.STEREO and frame.right is None:
            return Start(None, "the right image is missing")
        if self.ranging.rig.kind is RigKind.RGBD and frame.depth_m is None:
            return Start(None, "the depth image is missing")
        segment = Segment(self.ranging, self.config)
        nothing = np.zeros(0, dtype=np.int64)
        segment.latest = segment.mapper.insert(frame, np.eye(4), nothing, np.zeros((0, 2)))
        segment.follow(frame)
        placed = int(np.isfinite(segment.map.xyz[segment.tracker.point, 0]).sum())
        need = 2 * self.config.pose.min_inliers
        if placed < need:
            return Start(None, f"only {placed} points with depth in the image, need {need}")
        return Start(segment)
