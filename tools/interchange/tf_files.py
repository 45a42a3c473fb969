"""Transforms without ROS: ``tf.csv`` and ``tf.jsonl``, one transform a line, in order of time.

A line maps points of the child frame to the parent frame, as ROS's ``TransformStamped``; the quaternion is x y z w.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from maslam.backend.geometry import Array, quat_wxyz_from_rotation
from maslam.frontend.files.trajectory import NS_PER_S

from ..common.errors import ToolError
from ..common.progress import Progress
from ..common.text_table import counted
from ..report.run_data import RunData
from .export_request import ExportRequest
from .frame_tree import FramePath, frame_paths
from .units import ARBITRARY, agent_records, unit_of

_COLUMNS = "stamp_ns,frame_id,child_frame_id,x,y,z,qx,qy,qz,qw"


def write_tf(
    folder: Path, data: RunData, members: Sequence[int], request: ExportRequest, tell: Progress
) -> tuple[list[str], dict[str, Any]]:
    """Write both files: of each stamp of each agent map to odom, then odom to camera."""
    paths = frame_paths(data, members)
    if not paths:
        raise ToolError(f"{data.folder}: no frame has a place, so there are no transforms to export")
    task = tell.start("transforms", 1)
    rows = sorted((row for path in paths for row in _rows(path)), key=lambda row: (row[0], row[3]))
    table = [
        ",".join([str(stamp), parent, child, *(f"{v:.9g}" for v in values)]) for stamp, parent, child, _, values in rows
    ]
    (folder / "tf.csv").write_text("\n".join([_COLUMNS, *table]) + "\n", encoding="utf-8")
    lines = [json.dumps(_stamped(stamp, parent, child, values)) for stamp, parent, child, _, values in rows]
    (folder / "tf.jsonl").write_text("\n".join(lines) + "\n", encoding="utf-8")
    tell.advance(task, 1)
    said = [f"{{out}}/tf.csv, {{out}}/tf.jsonl: {counted(len(rows), 'transform')} of {counted(len(paths), 'agent')}"]
    return [*said, *frame_notes(data, members, paths)], {"agents": agent_records(data, members)}


def frame_notes(data: RunData, members: Sequence[int], paths: Sequence[FramePath]) -> list[str]:
    """Frames that nothing relates, units that are none, agents without a place."""
    lines = []
    maps = sorted({path.map for path in paths})
    if len(maps) > 1:
        lines.append(f"{len(maps)} frames that no match joins: {', '.join(maps)}")
    loose = [data.agents[p.agent].name for p in paths if unit_of(data, p.agent) == ARBITRARY]
    if loose:
        lines.append(f"{', '.join(loose)}: lengths in an arbitrary unit, no metres: one camera has no scale")
    left = [data.agents[a].name for a in members if a not in {p.agent for p in paths}]
    if left:
        lines.append(f"left out: {', '.join(left)}: no frame of theirs has a place")
    return lines


def xyz_xyzw(poses: Array) -> Array:
    """Position and quaternion x y z w ``(n, 7)`` of ``poses`` ``(n, 4, 4)``."""
    q = quat_wxyz_from_rotation(poses[:, :3, :3])
    q = np.where(q[:, :1] < 0, -q, q)
    return np.concatenate([poses[:, :3, 3], q[:, 1:], q[:, :1]], axis=1)


def _rows(path: FramePath) -> list[tuple[int, str, str, int, list[float]]]:
    """Stamp, parent, child, place among equal stamps, numbers."""
    fixed = xyz_xyzw(path.T_map_odom[None])[0].tolist()
    moving = xyz_xyzw(path.T_odom_camera.poses).tolist()
    out = []
    for stamp, values in zip(path.T_odom_camera.stamps_ns.tolist(), moving, strict=True):
        out.append((stamp, path.map, path.odom, 2 * path.agent, fixed))
        out.append((stamp, path.odom, path.camera, 2 * path.agent + 1, values))
    return out


def _stamped(stamp_ns: int, parent: str, child: str, values: Sequence[float]) -> dict[str, Any]:
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    x, y, z, qx, qy, qz, qw = values
    return {
        "header": {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": parent},
        "child_frame_id": child,
        "transform": {"translation": {"x": x, "y": y, "z": z}, "rotation": {"x": qx, "y": qy, "z": qz, "w": qw}},
    }
