"""True poses in a bag: messages with a stamped pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_from_quat_wxyz, se3

from ...errors import FrontendError
from ...files.trajectory import Trajectory
from .bag import Bag
from .message_file import Topic

_POSES: dict[str, Callable[[Any], tuple[Any, Any]]] = {
    "geometry_msgs/msg/PoseStamped": lambda m: (m.pose.position, m.pose.orientation),
    "geometry_msgs/msg/PoseWithCovarianceStamped": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "nav_msgs/msg/Odometry": lambda m: (m.pose.pose.position, m.pose.pose.orientation),
    "geometry_msgs/msg/TransformStamped": lambda m: (m.transform.translation, m.transform.rotation),
}
POSE_TYPES = frozenset(_POSES)


def read_truth(bag: Bag, topic: Topic) -> Trajectory:
    """All poses of a topic, at the times of their headers, one for each time. :class:`FrontendError` where they are
    none."""
    messages = bag.messages(topic)
    kept = np.flatnonzero(np.r_[True, np.diff(messages.stamps_ns) > 0])
    poses = [_pose(bag.read(messages, int(i), topic), topic, bag) for i in kept]
    return Trajectory(messages.stamps_ns[kept], np.stack(poses))


def _pose(message: Any, topic: Topic, bag: Bag) -> NDArray[np.float64]:
    position, turn = _POSES[topic.type](message)
    quaternion = np.array([turn.w, turn.x, turn.y, turn.z], dtype=np.float64)
    place = np.array([position.x, position.y, position.z], dtype=np.float64)
    if not np.isfinite(place).all() or not np.isfinite(quaternion).all() or np.linalg.norm(quaternion) < 0.5:
        raise FrontendError(f"{bag.path}: {topic.name}: a pose of {place} m, quaternion {quaternion} is none")
    return se3(rotation_from_quat_wxyz(quaternion / np.linalg.norm(quaternion)), place)
