"""Settings of OpenVSLAM and stella_vslam: ``Camera.model`` says the lens, ``Camera.setup`` the rig."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import se3

from ..calibration import RawCamera, RawRig
from .checked_camera import camera, camera_matrix, transform_of_rectified
from .fields import Fields
from .opencv_pair import rectifying_rotation
from .orb_slam import depth_unit_m

_MODELS = {"perspective": ("k1", "k2", "p1", "p2", "k3"), "fisheye": ("k1", "k2", "k3", "k4")}
_BASELINE = ("Camera.focal_x_baseline", "Camera.bf")


def recognises(data: Fields) -> bool:
    """Whether these are the keys of this format, flat or in groups."""
    return "Camera.model" in flattened(data)


def flattened(data: Fields) -> Fields:
    """The keys with those of groups as ``Group.key``: both ways are in use."""
    flat: dict[str, object] = {}
    for key, value in data.data.items():
        inside = value if isinstance(value, dict) and "data" not in value else None
        flat |= {f"{key}.{name}": one for name, one in inside.items()} if inside else {key: value}
    return Fields(flat, data.path)


def read(data: Fields) -> RawRig:
    """One camera, a rectified pair, or a raw pair by ``StereoRectifier``."""
    data = flattened(data)
    left = _camera(data)
    rate = data.number("Camera.fps") if "Camera.fps" in data else None
    unit = depth_unit_m(data, "depthmap_factor", "Preprocessing.depthmap_factor", "Camera.depthmap_factor")
    setup = data.text("Camera.setup").lower()
    if setup not in ("", "monocular", "stereo", "rgbd"):
        raise data.fail("Camera.setup", "monocular, stereo or RGBD")
    if setup != "stereo":
        no_pair = f"Camera.setup is {setup or 'missing'}: a pair needs stereo, with Camera.focal_x_baseline"
        return RawRig(left, depth_unit_m=unit, rate_hz=rate, no_pair=no_pair)
    baseline = data.number(data.first(*_BASELINE)) / left.fx
    if "StereoRectifier.K_left" in data:
        return _raw_pair(data, baseline, rate)
    if left.distorted:
        why = "the pair of a distorted camera needs a StereoRectifier; --rig mono reads the left images alone"
        return RawRig(left, rate_hz=rate, contradiction=why)
    return RawRig(left, left, se3(np.eye(3), [baseline, 0.0, 0.0]), depth_unit_m=unit, rate_hz=rate)


def _camera(data: Fields) -> RawCamera:
    model = data.text("Camera.model").lower()
    if model not in _MODELS:
        raise data.fail("Camera.model", "perspective or fisheye (no other lens is read)")
    coefficients = [data.number(f"Camera.{key}", None if model == "fisheye" else 0.0) for key in _MODELS[model]]
    size = data.size("Camera.cols", "Camera.rows") or data.size("Camera.width", "Camera.height")
    return camera(data, [data.number(f"Camera.{key}") for key in ("fx", "fy", "cx", "cy")], size, model, coefficients)


def _raw_pair(data: Fields, baseline_m: float, rate: float | None) -> RawRig:
    model = data.text("StereoRectifier.model").lower() or "perspective"
    if model not in _MODELS:
        raise data.fail("StereoRectifier.model", "perspective or fisheye")
    size = data.size("Camera.cols", "Camera.rows")
    left, right = (
        camera(
            data,
            camera_matrix(data, f"StereoRectifier.K_{side}"),
            size,
            model,
            data.numbers(f"StereoRectifier.D_{side}"),
        )
        for side in ("left", "right")
    )
    rotations = [rectifying_rotation(data, f"StereoRectifier.R_{side}") for side in ("left", "right")]
    return RawRig(
        left, right, transform_of_rectified(rotations[0], rotations[1], baseline_m), rectified=False, rate_hz=rate
    )
