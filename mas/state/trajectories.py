"""From key-frames to every frame: an agent's corrections, spread over its odometry."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, se3, se3_inverse, so3_exp, so3_log
from maslam.frontend.files.trajectory import Trajectory

from ..sequence import STAMP_TOLERANCE_NS, AgentSequence
from .agent_state import AgentState, stretched


def keyframe_trajectory(state: AgentState) -> Trajectory:
    """The agent's placed key-frames, ``T_F_C`` in its reference frame; times from its own start."""
    indices = state.placed()
    stamps = np.array([state.keyframes[i].time_ns for i in indices], dtype=np.int64)
    return Trajectory(stamps, np.array([state.poses[i] for i in indices]).reshape(-1, 4, 4))


def frame_trajectory(state: AgentState, sequence: AgentSequence) -> Trajectory:
    """Every frame of the placed tracks, ``T_F_C`` in the agent's reference frame; times from its own start.

    A key-frame stands where it is estimated. Both key-frames around another frame say where it is, each by its own pose
    and unit and by odometry between the two; their answers are blended by the way from one to the other. So no
    correction shows as a jump. Before the first and after the last key-frame of a track that one alone carries it.
    Frames of tracks that no match has joined to the rest are left out: where they are is not known.
    """
    raw = sequence.trajectory
    tracks = sequence.track_of(raw.stamps_ns)
    stamps, poses = [raw.stamps_ns[:0]], [raw.poses[:0]]
    for piece in state.pieces:
        if piece.frame == state.frame:
            rows = tracks == piece.track
            odometry = Trajectory(raw.stamps_ns[rows], raw.poses[rows])
            stamps.append(odometry.stamps_ns)
            poses.append(_corrected(state, piece.track, odometry))
    return Trajectory(np.concatenate(stamps), np.concatenate(poses))


def _corrected(state: AgentState, track: int, odometry: Trajectory) -> Array:
    """``(n, 4, 4)`` ``T_F_C`` of the frames of a track."""
    members = list(state.members(track))
    keyframes = [state.keyframes[i] for i in members]
    times = np.array([k.time_ns for k in keyframes], dtype=np.int64)
    at = odometry.nearest(times, STAMP_TOLERANCE_NS)
    # Odometry may have corrected a key-frame after the frame's pose was written: the frames' own poses go together.
    leaders = np.array([odometry.poses[a] if a >= 0 else k.T_T_C for a, k in zip(at, keyframes, strict=True)])
    after = np.searchsorted(times, odometry.stamps_ns + STAMP_TOLERANCE_NS, side="right")
    left, right = np.maximum(after - 1, 0), np.minimum(after, len(members) - 1)
    placed, units = np.array([state.poses[i] for i in members]), np.array([state.units[i] for i in members])
    by_left, by_right = (
        placed[k] @ stretched(se3_inverse(leaders)[k] @ odometry.poses, units[k, None]) for k in (left, right)
    )
    return _blended(by_left, by_right, _shares(odometry, times, at, left, right))


def _shares(
    odometry: Trajectory,
    times: NDArray[np.int64],
    at: NDArray[np.int64],
    left: NDArray[np.int64],
    right: NDArray[np.int64],
) -> Array:
    """``(n,)``: how far each frame is on the way from key-frame ``left`` to ``right``, 0 to 1; in time where the camera
    stood still."""
    steps = np.linalg.norm(np.diff(odometry.centres, axis=0), axis=1)
    way = np.concatenate([[0.0], np.cumsum(steps)])[: len(odometry)]
    way_of = np.where(at >= 0, way[at], np.interp(times, odometry.stamps_ns, way)) if len(way) else np.zeros(len(times))
    out = np.zeros(len(odometry))
    for here, there in ((odometry.stamps_ns, times), (way, way_of)):
        length = (there[right] - there[left]).astype(np.float64)
        known = length > 0
        out[known] = (here - there[left])[known] / length[known]
    return np.clip(out, 0.0, 1.0)


def _blended(a: Array, b: Array, share: Array) -> Array:
    """Poses ``(n, 4, 4)`` between ``a`` and ``b``: ``share`` ``(n,)`` of the turn and of the way."""
    turn = so3_log(np.swapaxes(a[:, :3, :3], 1, 2) @ b[:, :3, :3])
    rotation = a[:, :3, :3] @ so3_exp(share[:, None] * turn)
    return se3(rotation, a[:, :3, 3] + share[:, None] * (b[:, :3, 3] - a[:, :3, 3]))
