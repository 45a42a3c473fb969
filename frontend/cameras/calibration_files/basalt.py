"""basalt's ``calibration.json``: any number of cameras at an inertial sensor; the first two are read."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, rotation_from_quat_wxyz, se3, se3_inverse

from ..calibration import RawCamera, RawRig
from .checked_camera import camera, in_opencvs_order, numbers_under_names
from .fields import Fields

_LENS = {"ds": ("xi", "alpha"), "eucm": ("alpha", "beta"), "kb4": ("k1", "k2", "k3", "k4"), "fov": ("w",)}
_RADTAN8 = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


def recognises(data: Fields) -> bool:
    """Whether these are the keys of this format."""
    inside = data.data.get("value0", data.data)
    return isinstance(inside, dict) and "T_imu_cam" in inside and "intrinsics" in inside


def read(data: Fields) -> RawRig:
    """The first camera, or the first two with how they stand."""
    data = data.inner("value0") if "value0" in data else data
    lenses, poses = data.listed("intrinsics"), data.listed("T_imu_cam")
    sizes = data.data.get("resolution") or []
    if not lenses or len(poses) < min(2, len(lenses)):
        raise data.fail("T_imu_cam", f"a pose of each of {len(lenses)} cameras")
    cameras = [_camera(lens, _size(data, sizes, i)) for i, lens in enumerate(lenses[:2])]
    if len(cameras) == 1:
        return RawRig(cameras[0], no_pair="a calibration of one camera")
    T_left_right = product(se3_inverse(_pose(poses[0])), _pose(poses[1]))
    return RawRig(cameras[0], cameras[1], T_left_right, rectified=False)


def _size(data: Fields, sizes: object, i: int) -> tuple[int, int] | None:
    if not isinstance(sizes, list) or i >= len(sizes):
        return None
    return Fields({"resolution": sizes[i]}, data.path, data.prefix).resolution("resolution")


def _pose(pose: Fields) -> NDArray[np.float64]:
    quaternion = np.array([pose.number(key) for key in ("qw", "qx", "qy", "qz")])
    length = float(np.linalg.norm(quaternion))
    if not 0.99 < length < 1.01:
        raise pose.fail("qw", "a quaternion of length 1")
    return se3(rotation_from_quat_wxyz(quaternion / length), [pose.number(key) for key in ("px", "py", "pz")])


def _camera(one: Fields, size: tuple[int, int] | None) -> RawCamera:
    kind, values = one.text("camera_type"), one.inner("intrinsics")
    intrinsics = numbers_under_names(values, ("fx", "fy", "cx", "cy"))
    if kind == "pinhole":
        return camera(values, intrinsics, size, "none", ())
    if kind == "pinhole-radtan8":
        coefficients = in_opencvs_order(dict(zip(_RADTAN8, numbers_under_names(values, _RADTAN8), strict=True)))
        return camera(values, intrinsics, size, "radtan", coefficients)
    if kind == "ucm":  # the unified model: the extended one with beta 1
        return camera(values, intrinsics, size, "eucm", (values.number("alpha"), 1.0))
    if kind not in _LENS:
        raise one.fail("camera_type", f"one of pinhole, pinhole-radtan8, ucm, {', '.join(_LENS)}")
    return camera(values, intrinsics, size, kind, numbers_under_names(values, _LENS[kind]))
