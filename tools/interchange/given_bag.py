"""Poses of a ROS 1 or ROS 2 bag or an MCAP file: odometry, stamped poses and transforms, paths."""

from __future__ import annotations

from pathlib import Path

from maslam.frontend.datasets.poses_of_images import GivenPoses
from maslam.frontend.datasets.recordings.bag import Bag
from maslam.frontend.datasets.recordings.bag_poses import POSE_TYPES, read_bag_poses

from ..common.errors import ToolError


def read_given_bag(path: Path, topic: str | None) -> GivenPoses:
    """The poses on ``topic``, or on the only topic that has any. :class:`ToolError` where that is not one."""
    bag = Bag(path)
    known = [one for one in bag.topics() if one.type in POSE_TYPES]
    chosen = [one for one in known if topic in (None, one.name)]
    if len(chosen) != 1:
        there = ", ".join(sorted(one.name for one in known)) or "none"
        raise ToolError(f"{path}: topics with poses: {there}; --topic names one")
    trajectory, notes = read_bag_poses(bag, chosen[0])
    return GivenPoses(trajectory, f"bag, {chosen[0].name}", True, notes)
