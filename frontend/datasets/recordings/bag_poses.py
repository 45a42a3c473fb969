"""Poses in a bag: stamped poses, odometry, transforms and paths, as ground truth or as another system's trajectory."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_from_quat_wxyz, se3

from ...errors import FrontendError
from ...files.timestamps import NS_PER_S
from ...files.trajectory import Trajectory
from .bag import Bag
from .message_file import Topic

_PATH = "nav_msgs/msg/Path"
_POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "nav_msgs/msg/Odometry": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
}
POSE_TYPES = frozenset((*_POSES, _PATH))
"""As evo reads them; the last message of a path holds all of it."""
_OFF_LENGTH = 0.05  # of a quaternion: rounded digits are fine


def read_bag_poses(bag: Bag, topic: Topic) -> tuple[Trajectory, tuple[str, ...]]:
    """All poses of a topic, at the times of their headers, the first of each time, and notes that count what was left
    out. NaN, or a quaternion of zeros, is a moment without a pose. :class:`FrontendError` where one is none, or there
    are none."""
    where = f"{bag.path}: {topic.name}"
    if not topic.count:
        raise FrontendError(f"{where}: no poses on this topic")
    if topic.type == _PATH:
        stamps, values = _of_path(bag.ends(topic)[1])
    else:
        messages = bag.messages(topic)
        stamps = messages.stamps_ns
        values = _rows([_POSES[topic.type](bag.read(messages, i, topic)) for i in range(len(stamps))])
    lengths = np.linalg.norm(values[:, 3:], axis=1)
    known = np.isfinite(values).all(axis=1) & (lengths > 0)
    off = known & (np.abs(lengths - 1.0) > _OFF_LENGTH)
    if off.any():
        row = int(np.argmax(off))
        raise FrontendError(f"{where}: message {row} is no pose: its quaternion's length is {lengths[row]:.3f}")
    if not known.any():
        raise FrontendError(f"{where}: no poses on this topic")
    first = known.copy()
    first[known] = np.diff(stamps[known], prepend=stamps[known][:1] - 1) > 0
    notes = []
    if not known.all():
        notes.append(f"{topic.name}: {int((~known).sum())} of {len(known)} messages hold no pose (NaN or zeros)")
    twice = int(known.sum() - first.sum())
    if twice:
        notes.append(f"{topic.name}: {twice} poses have the time of another; the first is kept")
    rotations = rotation_from_quat_wxyz(values[first, 3:] / lengths[first, None])
    return Trajectory(stamps[first], se3(rotations, values[first, :3])), tuple(notes)


def _of_path(message: Any) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Times ``(N,)`` ascending, and rows as of :func:`_rows`, of a path."""
    times = [int(m.header.stamp.sec) * NS_PER_S + int(m.header.stamp.nanosec) for m in message.poses]
    stamps = np.array(times, dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    return stamps[order], _rows([(m.pose.position, m.pose.orientation) for m in message.poses])[order]


def _rows(poses: list[tuple[Any, Any]]) -> NDArray[np.float64]:
    """Position and quaternion (w first) of each pose, ``(N, 7)``."""
    rows = [(p.x, p.y, p.z, q.w, q.x, q.y, q.z) for p, q in poses]
    return np.array(rows, dtype=np.float64).reshape(-1, 7)
