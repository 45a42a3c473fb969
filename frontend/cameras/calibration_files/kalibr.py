"""Kalibr's chain of cameras, and the ``sensor.yaml`` of one camera that EuRoC and Kimera have."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse

from ..calibration import RawCamera, RawRig
from .checked_camera import camera, refuse_other_names
from .fields import Fields

_FIRST = {"pinhole": (), "": (), "omni": ("xi",), "eucm": ("alpha", "beta"), "ds": ("xi", "alpha")}
_SHIFT, _ONE_MOMENT_MS = "timeshift_cam_imu", 1.0
_DISTORTIONS = {
    "pinhole": ("radtan", "radial-tangential", "equidistant", "fov", "none", ""),
    "omni": ("radtan", "radial-tangential", "none", ""),
    "eucm": ("none", ""),
    "ds": ("none", ""),
}


def recognises(data: Fields) -> bool:
    """Whether these are the keys of a chain."""
    return isinstance(data.data.get("cam0"), dict)


def read(data: Fields) -> RawRig:
    """The first camera, or the first two with how they stand."""
    cams = [data.inner(key) for key in ("cam0", "cam1") if key in data]
    cameras = [one_camera(cam, "distortion_coeffs") for cam in cams]
    if len(cams) == 1:
        missing = "a chain of one camera: cam1 with T_cn_cnm1 is missing"
        return RawRig(cameras[0], no_pair=missing, notes=_shift_notes(cams))
    return RawRig(
        cameras[0],
        cameras[1],
        _transform(*cams),
        rectified=False,
        notes=_shift_notes(cams),
        doubts=_shift_doubts(*cams),
    )


def _shift_notes(cams: Sequence[Fields]) -> tuple[str, ...]:
    """Clocks against the inertial sensor's, of which nothing is read."""
    shifts = [cam.number(_SHIFT) for cam in cams if _SHIFT in cam]
    text = ", ".join(f"{1000.0 * shift:+.4g}" for shift in shifts)
    return (f"{_SHIFT} ({text} ms) is not used: times stay those of the images",) if any(shifts) else ()


def _shift_doubts(cam0: Fields, cam1: Fields) -> tuple[str, ...]:
    """Two cameras whose images with one time stamp are of two moments."""
    if _SHIFT not in cam0 or _SHIFT not in cam1:
        return ()
    apart_ms = 1000.0 * (cam1.number(_SHIFT) - cam0.number(_SHIFT))
    if abs(apart_ms) < _ONE_MOMENT_MS:
        return ()
    when = "after" if apart_ms > 0 else "before"
    return (
        f"{_SHIFT} of cam0 and cam1 differ by {abs(apart_ms):.4g} ms: a right image is taken that long {when} the left "
        "one of the same time stamp, and pairs are used as of one moment: while the rig moves depth is off; "
        "give each camera's times corrected, or use --rig mono",
    )


def _transform(cam0: Fields, cam1: Fields) -> NDArray[np.float64]:
    """``T_left_right`` by the chain, or by where each camera stands at the inertial sensor."""
    if "T_cn_cnm1" not in cam1 and "T_cam_imu" in cam0 and "T_cam_imu" in cam1:
        return product(cam0.transform("T_cam_imu"), se3_inverse(cam1.transform("T_cam_imu")))
    if "T_cn_cnm1" not in cam1 and "T_imu_cam" in cam0 and "T_imu_cam" in cam1:
        return product(se3_inverse(cam0.transform("T_imu_cam")), cam1.transform("T_imu_cam"))
    return se3_inverse(cam1.transform("T_cn_cnm1"))


def one_camera(cam: Fields, coefficients_key: str) -> RawCamera:
    """A camera by Kalibr's names of models, which put the lens's own numbers before the focal lengths."""
    model, distortion = cam.text("camera_model").lower(), cam.text("distortion_model").lower()
    if model not in _FIRST:
        raise cam.fail("camera_model", "pinhole, omni, eucm or ds")
    if distortion not in _DISTORTIONS[model or "pinhole"]:
        raise cam.fail("distortion_model", f"one of {', '.join(filter(None, _DISTORTIONS[model or 'pinhole']))}")
    refuse_other_names(cam, "dist", (coefficients_key, "distortion_model"))
    count = len(_FIRST[model])
    values = cam.numbers("intrinsics", count + 4)
    lens = values[:count]
    unbent = distortion == "none" or (lens and not distortion)
    bent = () if unbent and coefficients_key not in cam else cam.numbers(coefficients_key)
    if model == "omni":
        distortion, bent = "mei", (*lens, *(bent or (0.0,) * 4))
    elif lens:
        if any(bent):
            raise cam.fail(coefficients_key, "no coefficient of a distortion none")
        distortion, bent = model, lens
    return camera(cam, values[count:], cam.resolution("resolution"), distortion, bent)


def recognises_sensor(data: Fields) -> bool:
    """Whether these are the keys of one camera's ``sensor.yaml``."""
    return "intrinsics" in data and "camera_model" in data


def read_sensor(data: Fields) -> RawRig:
    """The one camera of such a file."""
    no_pair = "the file of one camera: a pair needs one for each, with T_BS"
    return RawRig(one_camera(data, "distortion_coefficients"), no_pair=no_pair)


def pair_of_sensors(left: Fields, right: Fields) -> RawRig:
    """Two cameras, each with its ``T_BS``: from the camera to the body."""
    cameras = [one_camera(data, "distortion_coefficients") for data in (left, right)]
    T_left_right = product(se3_inverse(left.transform("T_BS")), right.transform("T_BS"))
    return RawRig(cameras[0], cameras[1], T_left_right, rectified=False)
