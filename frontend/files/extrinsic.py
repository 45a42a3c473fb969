"""The pose of a camera on a body, from numbers or from a file that names it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import is_se3, project_to_so3, rotation_from_quat_wxyz, se3, se3_inverse

from ..errors import FrontendError
from .text_tables import read_bytes

_TOLERANCE = 0.02
_FORWARD = ("T_body_camera", "T_B_C", "T_BS", "T_imu_cam", "T_imu_camera")
"""Names of matrices that map the camera to the body."""
_BACKWARD = ("T_camera_body", "T_C_B", "T_cam_imu", "Tr", "Tr_velo_to_cam", "Tr_imu_to_cam")
"""Names of those that map the body (LiDAR, IMU) to the camera: inverted."""
_MEANT = (
    "16 or 12 numbers (4x4 or 3x4, row by row) or 7 (x y z qx qy qz qw) of T_body_camera, which maps the camera to the "
    f"body; or a file with them, or with one of {', '.join((*_FORWARD, *_BACKWARD))}"
)


def read_extrinsic(given: str) -> NDArray[np.float64]:
    """``T_B_C`` ``(4, 4)``: the camera's pose in the frame of the body whose poses a trajectory holds.

    ``given``: numbers, separated by commas or blanks, or a file. :class:`FrontendError` for anything else.
    """
    numbers = _numbers(given)
    if numbers is not None:
        return _pose(numbers, given)
    path = Path(given)
    if not path.is_file():
        raise FrontendError(f"{given}: no such file; {_MEANT}")
    text = read_bytes(path).removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
    numbers = _numbers(" ".join(line for line in text.splitlines() if not line.lstrip().startswith("#")))
    return _pose(numbers, str(path)) if numbers is not None else _named(text, path)


def _named(text: str, path: Path) -> NDArray[np.float64]:
    """From a file of keys and values: YAML, or KITTI's ``Tr: 12 numbers``."""
    found: dict[str, NDArray[np.float64]] = {}
    for line in text.splitlines():
        name, colon, rest = line.partition(":")
        numbers = _numbers(rest) if colon and rest.strip() else None
        if numbers is not None and len(numbers) == 12:
            found[name.strip()] = _pose(numbers, f"{path}: {name.strip()}")
    for name, value in _leaves(_yaml(text)):
        if name in (*_FORWARD, *_BACKWARD):
            flat = np.asarray(value, dtype=np.float64).ravel()
            found.setdefault(name, _pose(flat, f"{path}: {name}"))
    hits = [name for name in (*_FORWARD, *_BACKWARD) if name in found]
    if not hits:
        raise FrontendError(f"{path}: no pose of a camera on a body here; {_MEANT}")
    if len(hits) > 1 and not all(np.allclose(_forward(h, found), _forward(hits[0], found), atol=1e-6) for h in hits):
        raise FrontendError(f"{path}: {hits[0]} and {hits[1]} differ; give the numbers themselves")
    return _forward(hits[0], found)


def _forward(name: str, found: dict[str, NDArray[np.float64]]) -> NDArray[np.float64]:
    return found[name] if name in _FORWARD else se3_inverse(found[name])


def _yaml(text: str) -> Any:
    import yaml

    lines = [line for line in text.splitlines() if not line.startswith(("%", "---"))]
    try:
        return yaml.safe_load("\n".join(lines).replace("!!opencv-matrix", ""))
    except (yaml.YAMLError, RecursionError):
        return None


def _leaves(node: Any, name: str = "", depth: int = 0) -> list[tuple[str, list[Any]]]:
    """Lists of numbers under each key; OpenCV's matrices hold theirs in ``data``. The first camera's stand first."""
    if depth > 6:
        return []
    if isinstance(node, dict):
        if isinstance(node.get("data"), list):
            return _leaves(node["data"], name, depth + 1)
        return [leaf for key, value in node.items() for leaf in _leaves(value, str(key), depth + 1)]
    if isinstance(node, list) and node:
        flat = [v for row in node for v in (row if isinstance(row, list) else [row])]
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in flat):
            return [(name, flat)]
    return []


def _numbers(text: str) -> NDArray[np.float64] | None:
    fields = text.replace(",", " ").replace("[", " ").replace("]", " ").replace(";", " ").split()
    try:
        return np.array([float(field) for field in fields]) if fields else None
    except ValueError:
        return None


def _pose(numbers: NDArray[np.float64], where: str) -> NDArray[np.float64]:
    if len(numbers) not in (7, 12, 16) or not np.isfinite(numbers).all():
        raise FrontendError(f"{where}: {len(numbers)} numbers; {_MEANT}")
    if len(numbers) == 7:
        length = float(np.linalg.norm(numbers[3:]))
        if abs(length - 1.0) > 0.05:
            raise FrontendError(f"{where}: the quaternion's length is {length:.3f}, expected 1")
        return se3(rotation_from_quat_wxyz(numbers[[6, 3, 4, 5]] / length), numbers[:3])
    matrix = np.eye(4)
    matrix[: len(numbers) // 4] = numbers.reshape(-1, 4)
    if not is_se3(matrix, _TOLERANCE):
        raise FrontendError(f"{where}: not a rotation and a position")
    return se3(project_to_so3(matrix[:3, :3]), matrix[:3, 3])
