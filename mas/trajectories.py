"""From key-frames to every frame: an agent's corrections applied to its odometry."""

from __future__ import annotations

import numpy as np

from backend.geometry import se3_inverse
from frontend.trajectory import Trajectory
from mas.sequence import STAMP_TOLERANCE_NS, AgentSequence
from mas.state import AgentState, stretched


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
    stamps, poses = [], []
    for piece in state.pieces:
        if piece.frame != state.frame:
            continue
        members = list(state.members(piece.track))
        times = np.array([state.keyframes[i].time_ns for i in members], dtype=np.int64)
        rows = np.flatnonzero(tracks == piece.track)
        at_keyframes = raw.nearest(times, STAMP_TOLERANCE_NS)
        for row in rows:
            k = max(int(np.searchsorted(times, raw.stamps_ns[row] + STAMP_TOLERANCE_NS, side="right")) - 1, 0)
            leader = raw.poses[at_keyframes[k]] if at_keyframes[k] >= 0 else state.keyframes[members[k]].T_T_C
            step = stretched(se3_inverse(leader) @ raw.poses[row], piece.unit)
            stamps.append(int(raw.stamps_ns[row]))
            poses.append(state.poses[members[k]] @ step)
    return Trajectory(np.array(stamps, dtype=np.int64), np.array(poses).reshape(-1, 4, 4))
