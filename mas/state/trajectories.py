"""From key-frames to every frame: an agent's corrections applied to its odometry."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import se3_inverse
from maslam.frontend.files.trajectory import Trajectory

from ..sequence import STAMP_TOLERANCE_NS, AgentSequence
from .agent_state import AgentState, stretched


def keyframe_trajectory(state: AgentState) -> Trajectory:
    """The agent's placed key-frames, ``T_F_C`` in its reference frame; times from its own start."""
    indices = state.placed()
    stamps = np.array([state.keyframes[i].time_ns for i in indices], dtype=np.int64)
    return Trajectory(stamps, np.array([state.poses[i] for i in indices]).reshape(-1, 4, 4))


def frame_trajectory(state: AgentState, sequence: AgentSequence) -> Trajectory:
    """Every frame of the placed tracks: carried rigidly by the last key-frame before it (the first one, before that).

    Frames of tracks that no match has joined to the rest are left out: where they are is not known.
    """
    raw = sequence.trajectory
    tracks = sequence.track_of(raw.stamps_ns)
    stamps, poses = [raw.stamps_ns[:0]], [raw.poses[:0]]
    for piece in state.pieces:
        if piece.frame != state.frame:
            continue
        members = list(state.members(piece.track))
        times = np.array([state.keyframes[i].time_ns for i in members], dtype=np.int64)
        rows = np.flatnonzero(tracks == piece.track)
        at_keyframes = raw.nearest(times, STAMP_TOLERANCE_NS)
        leaders = np.array(
            [
                raw.poses[at] if at >= 0 else state.keyframes[i].T_T_C
                for i, at in zip(members, at_keyframes, strict=True)
            ]
        )
        k = np.maximum(np.searchsorted(times, raw.stamps_ns[rows] + STAMP_TOLERANCE_NS, side="right") - 1, 0)
        steps = stretched(se3_inverse(leaders)[k] @ raw.poses[rows], piece.unit)
        stamps.append(raw.stamps_ns[rows])
        poses.append(np.array([state.poses[i] for i in members])[k] @ steps)
    return Trajectory(np.concatenate(stamps), np.concatenate(poses))
