"""Our own ``camera.yaml``: one rectified camera or pair."""

from __future__ import annotations

import numpy as np

from maslam._suggestions import did_you_mean
from maslam.backend.geometry import se3

from ...errors import FrontendError
from ..calibration import RawRig
from .checked_camera import camera
from .fields import Fields

_KEYS = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m", "depth_unit_m", "rate_hz")
_DISTORTION = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2", "d", "distortion", "distortion_model")
_SOME = 4  # of our keys: then it is meant to be this format, whatever key is missing
_POSITIVE = ("depth_unit_m", "rate_hz")


def recognises(data: Fields) -> bool:
    """Whether these are the keys of this format."""
    return "fx" in data or sum(key in data for key in _KEYS) >= _SOME


def read(data: Fields) -> RawRig:
    """Rectified cameras; a key that is not ours is refused: read as nothing, ``baseline: 0.5`` makes a pair one camera,
    and ``k1: -0.3`` makes straight lines of bent ones."""
    _refuse_unknown(data)
    intrinsics = [data.number(key) for key in ("fx", "fy", "cx", "cy")]
    left = camera(data, intrinsics, data.size("width", "height"), "none", ())
    optional = {key: data.number(key) for key in ("baseline_m", *_POSITIVE) if key in data}
    for key in _POSITIVE:
        if optional.get(key, 1.0) <= 0.0:
            raise data.fail(key, "a number above 0")
    T_left_right = se3(np.eye(3), [optional["baseline_m"], 0.0, 0.0]) if "baseline_m" in optional else None
    right = left if T_left_right is not None else None
    no_pair = "" if right is not None else "no baseline of a rectified pair: add baseline_m"
    unit, rate = optional.get("depth_unit_m"), optional.get("rate_hz")
    return RawRig(left, right, T_left_right, depth_unit_m=unit, rate_hz=rate, no_pair=no_pair)


def _refuse_unknown(data: Fields) -> None:
    """One line that names every key which is not ours, and what to write instead."""
    unknown = [key for key in map(str, data.data) if key not in _KEYS]
    lens = [key for key in unknown if key.lower() in _DISTORTION]
    parts = [f"{key}: no such key{did_you_mean(key, _KEYS)}" for key in unknown if key not in lens]
    if lens:
        parts.append(
            f"{', '.join(lens)}: no such key: this format is of rectified images; for distorted ones use OpenCV's "
            "form (camera_matrix, distortion_coefficients)"
        )
    if parts:
        raise FrontendError(f"{data.path}: {'; '.join(parts)}")
