"""One pose in JSON: a matrix, seven numbers, or a position and a rotation under the names that people give them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from maslam.backend.geometry import se3_inverse

from ..errors import FrontendError
from .headed_table import is_number
from .pose_conventions import OPENGL

NAME_KEYS = ("name", "file", "file_name", "filename", "file_path", "image", "image_name", "image_path", "path")
_NUMBER_KEYS = ("id", "image_id", "frame_id", "frame", "index", "frame_index", "idx")
TIME_KEYS = ("time", "timestamp", "stamp", "t", "timestamp_ns", "time_ns", "timestamp_us", "timestamp_ms", "time_s")
MATRIX_KEYS = (
    *("pose", "matrix", "transform", "transform_matrix", "transformation", "T", "T_W_C", "T_wc", "Twc", "c2w"),
    *("camera_to_world", "cam_to_world", "cam2world", "T_cam2world"),
)
INVERSE_KEYS = ("w2c", "world_to_camera", "world_to_cam", "world2cam", "T_C_W", "T_cw", "Tcw", "cam_from_world")
_POSITION_KEYS = ("position", "translation", "trans", "tvec", "t", "p", "xyz", "location", "center", "centre")
_ROTATION_KEYS = ("orientation", "rotation", "quaternion", "quat", "q", "qvec", "rot", "R", "rotation_matrix")
_ORDERED_KEYS = tuple(
    f"{key}_{order}" for key in ("quaternion", "quat", "q", "orientation", "rotation") for order in ("wxyz", "xyzw")
)
_WHOLE = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_AXES = ("x", "y", "z")
_NERFSTUDIO = {"transform_matrix", "file_path"}  # of each frame in transforms.json
OPENGL_NOTE = (
    "transform_matrix of its frames: the camera's axes turned from OpenGL's; in the unit of whatever made it, which "
    "need not be metres"
)
AS_XYZW = "taken as x, y, z, w"
_DEEPEST = 3  # ROS: pose.pose.position
POSES_MEANT = (
    "a list of 4x4 matrices T_W_C, or one by each image's name or number, is read, or entries with position and "
    "orientation; or lines time tx ty tz qx qy qz qw"
)


@dataclass(frozen=True)
class PoseEntry:
    """``cells`` of a row as a text file would have it, with ``headings`` or none; the image's ``name`` or number and
    the ``time`` as written, or empty; ``notes``: what to know of all like it; ``opengl``: in the axes of OpenGL's
    camera."""

    cells: tuple[str, ...]
    headings: tuple[str, ...] = ()
    name: str = ""
    time: str = ""
    notes: tuple[str, ...] = ()
    opengl: bool = False


def pose_of_entry(where: str, name: str, entry: Any) -> PoseEntry:
    """An entry of a list, or of an object under ``name``; numbers in it are texts as written. :class:`FrontendError`,
    which ``where`` begins, for what is no pose."""
    if not isinstance(entry, Mapping):
        return replace(_of_numbers(where, flat_cells(entry)), name=name)
    found = _of_mapping(where, entry, 0)
    own = name or str(first_of(entry, NAME_KEYS) or "")
    number = first_of(entry, _NUMBER_KEYS)
    own = own or (number if isinstance(number, str) else "")
    opengl = set(entry) >= _NERFSTUDIO
    return replace(found, name=own, time=_time_of(entry), opengl=opengl)


def in_opencv(pose: PoseEntry, scale: str) -> PoseEntry:
    """A pose of ``transforms.json``, in the axes of OpenGL's camera and times ``applied_scale``, in OpenCV's axes and
    the unit before that; others as they are."""
    if not pose.opengl or not is_number(scale) or not float(scale) > 0:
        return pose
    T = np.array([float(cell) for cell in pose.cells]).reshape(-1, 4)[:3] @ OPENGL
    T[:, 3] /= float(scale)
    return replace(pose, cells=tuple(map(repr, T.ravel().tolist())), notes=(*pose.notes, OPENGL_NOTE), opengl=False)


def first_of(entry: Mapping[str, Any], keys: Sequence[str]) -> Any:
    """The value of the first of ``keys`` that is there, or None."""
    return next((entry[key] for key in keys if key in entry), None)


def flat_cells(matrix: Any) -> list[str]:
    """The cells of a matrix row by row, of lists or of lists of lists; none of anything else."""
    if not isinstance(matrix, list):
        return []
    cells = [cell for row in matrix for cell in (row if isinstance(row, list) else [row])]
    return cells if all(isinstance(cell, str) and is_number(cell.replace("-Inf", "-inf")) for cell in cells) else []


def _of_numbers(where: str, cells: Sequence[str]) -> PoseEntry:
    if len(cells) not in (7, 8, 12, 16):
        raise FrontendError(f"{where}: in a form that is not read; {POSES_MEANT}")
    return PoseEntry(tuple(cells))


def _of_mapping(where: str, entry: Mapping[str, Any], depth: int) -> PoseEntry:
    whole = flat_cells([entry.get(key) for key in _WHOLE])
    if whole:
        return _of_parts(where, whole[:3], dict(zip(("x", "y", "z", "w"), whole[3:], strict=True)), "")
    position = _three(next((entry[key] for key in _POSITION_KEYS if _three(entry.get(key))), None) or entry)
    key = next((key for key in (*_ORDERED_KEYS, *_ROTATION_KEYS) if key in entry), "")
    if position and key:
        return _of_parts(where, position, entry[key], key)
    if position and all(isinstance(entry.get(one), str) for one in _WHOLE[3:]):
        return _of_parts(where, position, {one[1:]: entry[one] for one in _WHOLE[3:]}, "")
    for inverse, keys in ((False, MATRIX_KEYS), (True, INVERSE_KEYS)):
        key = next((key for key in keys if key in entry), "")
        if key and isinstance(entry[key], Mapping) and depth < _DEEPEST:
            return _of_mapping(where, entry[key], depth + 1)
        if key:
            return (
                _turned(where, key, flat_cells(entry[key])) if inverse else _of_numbers(where, flat_cells(entry[key]))
            )
    raise FrontendError(
        f"{where}: in a form that is not read (its keys: {', '.join(map(str, list(entry)[:8]))}); {POSES_MEANT}"
    )


def _turned(where: str, key: str, cells: Sequence[str]) -> PoseEntry:
    """A pose that maps the world to the camera, inverted."""
    if len(cells) not in (12, 16):
        raise FrontendError(f"{where}: {key} is no 4x4 matrix; {POSES_MEANT}")
    T = np.eye(4)
    T[: len(cells) // 4] = np.array([float(cell) for cell in cells]).reshape(-1, 4)
    note = f"its {key} map the world to the camera, and are inverted"
    return PoseEntry(tuple(map(repr, se3_inverse(T)[:3].ravel().tolist())), notes=(note,))


def _of_parts(where: str, position: Sequence[str], rotation: Any, key: str) -> PoseEntry:
    """A position and a quaternion or a matrix, of which the order of the former is named or not."""
    if isinstance(rotation, Mapping):
        parts = [rotation.get(axis, rotation.get(f"q{axis}")) for axis in ("x", "y", "z", "w")]
        if all(isinstance(cell, str) for cell in parts):
            return PoseEntry((*position, *parts), _WHOLE)
        raise FrontendError(f"{where}: a rotation of {', '.join(map(str, rotation))}, where x, y, z, w are meant")
    cells = flat_cells(rotation)
    if len(cells) == 4 and (key == "qvec" or key.endswith("_wxyz")):
        return PoseEntry((*position, *cells[1:], cells[0]), _WHOLE)
    if len(cells) == 4:
        note = () if key.endswith("_xyzw") else (f"its {key} of four numbers is {AS_XYZW}; {key}_wxyz says otherwise",)
        return PoseEntry((*position, *cells), _WHOLE if key.endswith("_xyzw") else (), notes=note)
    if len(cells) == 9:
        return PoseEntry(tuple(cell for k in range(3) for cell in (*cells[3 * k : 3 * k + 3], position[k])))
    what = "angles, or a rotation vector? " if len(cells) == 3 else ""
    raise FrontendError(
        f"{where}: {key} has {len(cells)} numbers: {what}four of a quaternion (x, y, z, w) or nine of a matrix are "
        "meant"
    )


def _three(value: Any) -> list[str]:
    """Three numbers in a list, or x, y and z of an object; else none."""
    if isinstance(value, Mapping):
        value = [value.get(axis) for axis in _AXES]
    cells = flat_cells(value)
    return cells if len(cells) == 3 else []


def _time_of(entry: Mapping[str, Any]) -> str:
    """The time as written; of ROS's messages from seconds and nanoseconds."""
    header = entry.get("header")
    time = first_of(entry, TIME_KEYS)
    if isinstance(time, list):  # t: a translation
        time = first_of(entry, [key for key in TIME_KEYS if key != "t"])
    if time is None and isinstance(header, Mapping):
        time = header.get("stamp")
    if isinstance(time, Mapping):
        seconds, rest = (first_of(time, keys) for keys in (("sec", "secs"), ("nanosec", "nsecs", "nsec")))
        known = isinstance(seconds, str) and isinstance(rest, str) and seconds.isdigit() and rest.isdigit()
        return f"{seconds}.{int(rest):09d}" if known else ""
    return time if isinstance(time, str) else ""
