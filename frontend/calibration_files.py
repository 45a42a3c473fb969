"""Calibration files that people bring, read by what is in them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from backend.geometry import se3
from frontend.calibration import RawCamera, RawRig
from frontend.errors import FrontendError
from frontend.tables import read_bytes


def read_calibration(path: Path) -> RawRig:
    """One or two cameras from a YAML file. Formats: our own ``camera.yaml``."""
    data = _load(path)
    return _own(data, path)


def _load(path: Path) -> dict[str, Any]:
    text = read_bytes(path).decode("utf-8", "replace")
    if text.startswith("%YAML"):
        text = text.split("\n", 1)[1]
    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise FrontendError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise FrontendError(f"{path}: not a calibration")
    return data


def _number(data: dict[str, Any], key: str, path: Path) -> float:
    try:
        return float(data[key])
    except (KeyError, TypeError, ValueError):
        raise FrontendError(f"{path}: {key}: a number is expected, found {data.get(key)!r}") from None


def _own(data: dict[str, Any], path: Path) -> RawRig:
    size = (int(_number(data, "width", path)), int(_number(data, "height", path)))
    left = RawCamera(*(_number(data, key, path) for key in ("fx", "fy", "cx", "cy")), size=size)
    optional = {key: _number(data, key, path) for key in ("baseline_m", "depth_unit_m", "rate_hz") if data.get(key) is not None}
    T_left_right = se3(np.eye(3), [optional["baseline_m"], 0.0, 0.0]) if "baseline_m" in optional else None
    right = left if T_left_right is not None else None
    return RawRig(left, right, T_left_right, depth_unit_m=optional.get("depth_unit_m"), rate_hz=optional.get("rate_hz"))
