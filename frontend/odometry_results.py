"""What odometry gives: the result of a frame, and that of a sequence."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .files.point_views import PointViews
from .files.trajectory import Trajectory
from .files.vo_files import VoTrack
from .frames import Frame
from .tracking.pose_log import DoubtfulInterval, LostInterval


class TrackingState(StrEnum):
    """State of the odometry after a frame: no map yet, following a map, or searching for it."""

    STARTING = "starting"
    TRACKING = "tracking"
    LOST = "lost"


@dataclass(frozen=True)
class FrameResult:
    """Result of one frame.

    ``T_W_C`` ``(4, 4)`` maps the camera to the frame of the current track (metres, or the track's own unit with one
    camera); None without a pose, and ``reason`` then says why, with numbers, ``kind`` without. ``problem``: the damage
    of a second image (right, depth) that was needed; the key-frame was made without it. ``stays``: the key-frame
    belongs to the track unless it is culled (False: it only supports the window). ``first``: an earlier frame that has
    become a key-frame with this one, the first view of a monocular track. ``doubt``: why the pose may be wrong, with
    figures; what only the finished trajectory shows is in :class:`OdometryResult`.
    """

    stamp_ns: int
    T_W_C: NDArray[np.float64] | None
    state: TrackingState
    is_keyframe: bool
    reason: str = ""
    problem: str = ""
    stays: bool = False
    first: Frame | None = None
    kind: str = ""
    doubt: str = ""


@dataclass(frozen=True)
class OdometryResult:
    """Tracks of one sequence, with final values.

    ``tracks``: one for each uninterrupted track. ``views``: for each track where its key-frames see its points.
    ``keyframe_indices`` ``(K,)`` for each track: frame index of each key-frame.
    ``trajectories``: for each track ``T_W_C`` of every frame with a pose. ``lost``: the intervals without a pose,
    before, between and after the tracks. ``doubtful``: the intervals whose poses may be wrong. ``stats``: counts, and
    the estimated calibration of the rig.
    """

    tracks: list[VoTrack]
    views: list[PointViews]
    keyframe_indices: list[NDArray[np.int64]]
    trajectories: list[Trajectory]
    lost: list[LostInterval]
    doubtful: list[DoubtfulInterval]
    stats: dict[str, float]
