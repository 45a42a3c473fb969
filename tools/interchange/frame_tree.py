"""Coordinate frames as ROS names them: ``map``, ``agent_00/odom``, ``agent_00/camera``.

``map`` is the frame that agents share. ``agent_00/odom`` is the camera of the agent's first placed frame: it stands
still in the map, as the run is over. ``agent_00/camera`` is the optical frame: +X right, +Y down, +Z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from maslam.backend.geometry import Array, product, se3_inverse
from maslam.frontend.files.trajectory import Trajectory

from ..report.run_data import RunData


@dataclass(frozen=True, eq=False)
class FramePath:
    """One agent: ``map``, ``odom``, ``camera``: names of the frames; ``T_map_odom`` ``(4, 4)``; ``T_odom_camera`` at
    each stamp of the source, in the agent's unit."""

    agent: int
    map: str
    odom: str
    camera: str
    T_map_odom: Array
    T_odom_camera: Trajectory


def frame_paths(data: RunData, members: Sequence[int]) -> list[FramePath]:
    """Of each agent that has a placed frame. The largest group's frame is ``map``; groups that no match joins to it
    stand in ``map_1``, ``map_2`` …, which nothing relates."""
    order = sorted(data.groups, key=lambda group: (-sum(len(data.agents[a].estimate) for a in group), group))
    names = {a: "map" if k == 0 else f"map_{k}" for k, group in enumerate(order) for a in group}
    paths = []
    for a in members:
        estimate, name = data.agents[a].estimate, data.agents[a].name
        if len(estimate):
            first = estimate.poses[0]
            inside = Trajectory(estimate.stamps_ns, product(se3_inverse(first), estimate.poses))
            paths.append(FramePath(a, names[a], f"{name}/odom", f"{name}/camera", first, inside))
    return paths
