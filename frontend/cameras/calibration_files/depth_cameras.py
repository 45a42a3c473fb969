"""Cameras as Open3D and RealSense's library write them."""

from __future__ import annotations

from ..calibration import RawRig
from .checked_camera import camera
from .fields import Fields

_NO_PAIR = "the file of one camera"
_RADIAL = ("", "none", "brown_conrady", "modified_brown_conrady")  # k1 k2 p1 p2 k3, as OpenCV's


def recognises_open3d(data: Fields) -> bool:
    """Whether these are the keys of Open3D's ``PinholeCameraIntrinsic``."""
    return "intrinsic_matrix" in data


def read_open3d(data: Fields) -> RawRig:
    """Its matrix is stored column by column, and so are the numbers of a list."""
    values = data.numbers("intrinsic_matrix", 9)
    fx, fy, cx, cy = values[0], values[4], values[6], values[7]
    if any(values[i] for i in (1, 2, 3, 5)) or values[8] != 1.0:
        raise data.fail("intrinsic_matrix", "a matrix column by column (fx 0 0 0 fy 0 cx cy 1)")
    return RawRig(camera(data, (fx, fy, cx, cy), data.size("width", "height"), "none", ()), no_pair=_NO_PAIR)


def recognises_realsense(data: Fields) -> bool:
    """Whether these are the names of ``rs2_intrinsics``."""
    return "ppx" in data and "fx" in data


def read_realsense(data: Fields) -> RawRig:
    """Refused where the lens is the inverse model, and bent: that is of depth cameras."""
    coefficients = data.numbers("coeffs") if "coeffs" in data else ()
    model = data.text("model").lower().replace("distortion.", "").replace(" ", "_").replace("-", "_")
    if any(coefficients) and model not in _RADIAL:
        raise data.fail("model", "Brown Conrady (no other lens is read)")
    intrinsics = [data.number(key) for key in ("fx", "fy", "ppx", "ppy")]
    named = "radtan" if any(coefficients) else "none"
    bent = coefficients if any(coefficients) else ()
    return RawRig(camera(data, intrinsics, data.size("width", "height"), named, bent), no_pair=_NO_PAIR)
