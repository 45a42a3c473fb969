"""Where an agent is now: the latest frame of its camera, by odometry since a key-frame, in the frame of its team."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, se3_inverse

from ..protocol.ids import FrameId
from ..state.agent_state import AgentState, stretched
from ..state.keyframe import KeyFrame


@dataclass(frozen=True, eq=False)
class TeamPose:
    """``T_F_C`` ``(4, 4)``: camera to ``frame``, at ``stamp_ns`` of the image.

    ``frame``: the camera of the first key-frame of one agent's track; poses of two agents belong together where it is
    the same. ``members``: agents that matches join with this one. ``metric``: whether lengths are metres.
    """

    stamp_ns: int
    T_F_C: Array
    frame: FrameId
    members: frozenset[int]
    metric: bool


@dataclass(frozen=True, eq=False)
class TeamMap:
    """The points ``(n, 3)`` of an agent's own map and of its copies of others', each once, in ``frame``; ``owners``
    ``(n,)``: whose they are (of several: the first)."""

    frame: FrameId
    points: Array
    owners: NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class LatestFrame:
    """The latest frame with a pose: ``T_K_C`` ``(4, 4)`` relative to ``keyframe``, number ``keyframe.index`` of the
    agent, by odometry."""

    stamp_ns: int
    keyframe: KeyFrame
    T_K_C: Array


class PlacedKeyFrames:
    """An agent's key-frames as they are placed at one moment; never changed, so any thread may read it."""

    def __init__(self, state: AgentState) -> None:
        self._poses, self._units = list(state.poses), list(state.units)
        self._keyframes = list(state.keyframes)
        self._pieces = list(state.pieces)
        self._members = frozenset(state.group)

    def place(self, latest: LatestFrame) -> TeamPose | None:
        """The pose of a frame; None before the agent has a key-frame of its track."""
        count, new = len(self._keyframes), latest.keyframe
        at = min(new.index, count - 1)
        if at < 0 or self._keyframes[at].track != new.track:
            return None
        T_K_C = latest.T_K_C
        if at < new.index:  # passed on, and not yet acted on: odometry leads there
            T_K_C = se3_inverse(self._keyframes[at].T_T_C) @ new.T_T_C @ T_K_C
        piece = next(piece for piece in reversed(self._pieces) if piece.track == new.track)
        T_F_C = self._poses[at] @ stretched(T_K_C, self._units[at])
        return TeamPose(latest.stamp_ns, T_F_C, piece.frame, self._members, piece.metric)
