"""Camera files and configurations of VINS-Mono and VINS-Fusion (camodocal's models)."""

from __future__ import annotations

from pathlib import Path

from maslam.backend.geometry import product, se3_inverse

from ..calibration import RawCamera, RawRig
from .checked_camera import camera, in_opencvs_order, numbers_under_names
from .fields import Fields
from .loading import load_fields

_RADIAL = ("k1", "k2", "k3", "k4", "k5", "k6", "p1", "p2")


def recognises(data: Fields) -> bool:
    """Whether these are the keys of one camera."""
    return "model_type" in data and "projection_parameters" in data


def read(data: Fields) -> RawRig:
    """The one camera of the file."""
    return RawRig(_camera(data), no_pair="the file of one camera: a pair needs the configuration with cam0_calib too")


def recognises_configuration(data: Fields) -> bool:
    """Whether these are the keys of VINS-Fusion's configuration, which names the cameras' files."""
    return "cam0_calib" in data


def read_configuration(data: Fields) -> RawRig:
    """The camera, or the pair, of the files that the configuration names, beside it."""
    left = _camera(load_fields(_beside(data, "cam0_calib")))
    if "cam1_calib" not in data or data.text("num_of_cam") == "1":
        return RawRig(left, no_pair="one camera: a pair needs num_of_cam 2, cam1_calib and body_T_cam1")
    right = _camera(load_fields(_beside(data, "cam1_calib")))
    T_left_right = product(se3_inverse(data.transform("body_T_cam0")), data.transform("body_T_cam1"))
    return RawRig(left, right, T_left_right, rectified=False)


def _beside(data: Fields, key: str) -> Path:
    path = data.path.parent / Path(data.text(key)).name
    if not path.is_file():
        raise data.fail(key, f"the name of a file in {data.path.parent}")
    return path


def _camera(data: Fields) -> RawCamera:
    model = data.text("model_type").upper()
    projection, size = data.inner("projection_parameters"), data.size("image_width", "image_height")
    if model == "KANNALA_BRANDT":
        mu, mv, u0, v0 = numbers_under_names(projection, ("mu", "mv", "u0", "v0"))
        coefficients = numbers_under_names(projection, ("k2", "k3", "k4", "k5"))
        return camera(data, (mu, mv, u0, v0), size, "fisheye", coefficients)
    if model not in ("PINHOLE", "PINHOLE_FULL", "MEI"):
        raise data.fail("model_type", "PINHOLE, KANNALA_BRANDT or MEI (no other lens is read)")
    bent = data.inner("distortion_parameters")
    coefficients = list(in_opencvs_order({name: bent.number(name, 0.0) for name in _RADIAL}))
    if model == "MEI":
        intrinsics = numbers_under_names(projection, ("gamma1", "gamma2", "u0", "v0"))
        xi = data.inner("mirror_parameters").number("xi")
        return camera(data, intrinsics, size, "mei", (xi, *coefficients))
    return camera(data, numbers_under_names(projection, ("fx", "fy", "cx", "cy")), size, "pinhole", coefficients)
