"""An agent's own map in the thesis's form: floating-point numbers and descriptors."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Sim3

from ..protocol.map_messages import SubMap
from ..protocol.tensors import Tensor, pack_poses, pack_sim3s
from ..state.agent_state import AgentState, thinned
from ..state.keyframe import KeyFrame
from .map_copy import MapCopy, copy_of_submap


def own_submap(state: AgentState, max_points: int) -> SubMap:
    """The agent's own map as it stands: key-frames in its reference frame, each point once, where it was first seen,
    at most ``max_points`` with a key-frame."""
    indices = state.placed()
    keyframes = [state.keyframes[i] for i in indices]
    fresh = [fresh_rows(k, max_points) for k in keyframes]
    counts = [len(rows) for rows in fresh]
    stack = [k.points_C[rows] for k, rows in zip(keyframes, fresh, strict=True)]
    descriptors = [k.descriptors[rows] for k, rows in zip(keyframes, fresh, strict=True)]
    unit = state.units[indices[0]]
    drifting = any(state.units[i] != unit for i in indices)
    poses = np.array([state.poses[i] for i in indices]).reshape(-1, 4, 4)
    return SubMap(
        owner=state.me,
        version=state.version,
        unit=unit,
        keyframes=Tensor.of(indices, "<i4"),
        stamps_ns=Tensor.of([k.stamp_ns for k in keyframes], "<i8"),
        poses=pack_sim3s([state.pose(i) for i in indices]) if drifting else pack_poses(poses),
        references=Tensor.of(np.repeat(np.arange(len(indices)), counts), "<i4"),
        points=Tensor.of(np.concatenate([np.zeros((0, 3)), *stack]), "<f4"),
        descriptors=Tensor.of(np.concatenate([np.zeros((0, 32), dtype=np.uint8), *descriptors]), "|u1"),
        matches=tuple(m.id for m in state.accepted_matches()),
        transforms=pack_sim3s([m.T_M_Q for m in state.accepted_matches()]),
    )


def fresh_rows(keyframe: KeyFrame, max_points: int) -> NDArray[np.int64]:
    """The points that a key-frame is sold with, always the same ones: seen first by it, at most ``max_points``."""
    return thinned(np.flatnonzero(keyframe.first_seen & (keyframe.points_C[:, 2] > 0)), max_points)


def own_map(state: AgentState) -> MapCopy:
    """The agent's own map with all its points, seen like a copy: for export."""
    limit = max((len(k.points_C) for k in state.keyframes), default=0)
    return copy_of_submap(own_submap(state, limit), state.frame, Sim3.identity(), state.me)
