"""Poses of a ROS 1 or ROS 2 bag or an MCAP file: odometry, stamped poses and transforms, paths."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from maslam.backend.geometry import rotation_from_quat_wxyz, se3
from maslam.frontend.datasets.poses_of_images import GivenPoses
from maslam.frontend.files.trajectory import NS_PER_S, Trajectory

from ..common.errors import ToolError

_TYPES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "nav_msgs/msg/Odometry": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
}
"""As evo reads them; the last message of a path holds all of it."""
_PATH = "nav_msgs/msg/Path"


def read_bag_poses(path: Path, topic: str | None) -> GivenPoses:
    """The poses on ``topic``, or on the only topic that has any. :class:`ToolError` where that is not one."""
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise ToolError(f"{path}: bags are read by rosbags, which is not installed: pip install rosbags") from error
    found: list[Any] = []
    try:
        with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
            known = [c for c in reader.connections if c.msgtype in (*_TYPES, _PATH)]
            chosen = [c for c in known if topic in (None, c.topic)]
            names = sorted({c.topic for c in chosen})
            if len(names) != 1:
                there = ", ".join(sorted({c.topic for c in known})) or "none"
                raise ToolError(f"{path}: topics with poses: {there}; --topic names one")
            for connection, _, raw in reader.messages(connections=chosen):
                message: Any = reader.deserialize(raw, connection.msgtype)
                if connection.msgtype == _PATH:
                    found = [_row(m, _TYPES["geometry_msgs/msg/PoseStamped"](m)) for m in message.poses]
                else:
                    found.append(_row(message, _TYPES[connection.msgtype](message)))
    except (AnyReaderError, OSError) as error:
        raise ToolError(f"{path}: cannot be read as a bag: {' '.join(str(error).split())}") from error
    if not found:
        raise ToolError(f"{path}: no poses on {names[0]}")
    return _trajectory(path, names[0], found)


def _row(message: Any, pose: tuple[Any, Any]) -> tuple[int, list[float]]:
    stamp, (p, q) = message.header.stamp, pose
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec), [p.x, p.y, p.z, q.w, q.x, q.y, q.z]


def _trajectory(path: Path, topic: str, found: list[tuple[int, list[float]]]) -> GivenPoses:
    found.sort(key=lambda row: row[0])  # messages may overtake each other
    stamps = np.array([stamp for stamp, _ in found], dtype=np.int64)
    values = np.array([row for _, row in found], dtype=np.float64)
    lengths = np.linalg.norm(values[:, 3:], axis=1)
    if not np.isfinite(values).all() or (np.abs(lengths - 1.0) > 0.05).any():
        row = int(np.argmax(~np.isfinite(values).all(axis=1) | (np.abs(lengths - 1.0) > 0.05)))
        raise ToolError(f"{path}: {topic}: message {row} is no pose: its quaternion's length is {lengths[row]:.3f}")
    first = np.concatenate([[True], np.diff(stamps) > 0])
    poses = se3(rotation_from_quat_wxyz(values[first, 3:] / lengths[first, None]), values[first, :3])
    twice = int((~first).sum())
    notes = (f"{topic}: {twice} poses have the time of another; the first is kept",) * bool(twice)
    return GivenPoses(Trajectory(stamps[first], poses), f"bag, {topic}", True, notes)
