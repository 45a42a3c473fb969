"""Settings of ORB-SLAM2 and ORB-SLAM3: one camera, a rectified pair (``Camera.bf``, ``Stereo.b``), or a raw pair."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3, se3_inverse

from ..calibration import RawCamera, RawRig
from .checked_camera import camera, camera_matrix, in_opencvs_order, transform_of_rectified
from .fields import Fields
from .opencv_pair import baseline_of, rectifying_rotation, states_baseline

_TYPES = {"": "pinhole", "pinhole": "pinhole", "kannalabrandt8": "fisheye", "rectified": "none"}
_SAME_DISTANCE = 0.05  # share by which two keys that tell one distance may differ
_NEEDS_RECTIFIED = (
    "needs rectified images, and this file's are distorted: for a raw pair give Stereo.T_c1_c2 (or Tlr) with Camera2, "
    "or LEFT and RIGHT; --rig mono reads the left images alone"
)


def recognises(data: Fields) -> bool:
    """Whether these are the keys of this format."""
    return "Camera.fx" in data or "Camera1.fx" in data


def read(data: Fields) -> RawRig:
    """One camera, a rectified pair, or a raw one; the unit of depth where ``DepthMapFactor`` says it."""
    return replace(_rig(data), notes=_new_size_notes(data))


def _new_size_notes(data: Fields) -> tuple[str, ...]:
    """ORB-SLAM3 scales images and intrinsics to this size; the camera is the same without."""
    given = [key for key in ("Camera.newWidth", "Camera.newHeight") if key in data]
    if not given:
        return ()
    text = " and ".join(f"{key} {data.number(key):.6g}" for key in given)
    verb = "are" if len(given) > 1 else "is"
    return (f"{text} {verb} not used: images stay of the size that Camera.width and Camera.height say",)


def _rig(data: Fields) -> RawRig:
    left = _camera(data, "Camera" if "Camera.fx" in data else "Camera1")
    rate = data.number("Camera.fps") if "Camera.fps" in data else None
    if "LEFT.K" in data:
        return _raw_pair_of_sides(data, rate)
    for key in ("Stereo.T_c1_c2", "Tlr"):
        if key in data:
            return RawRig(left, _camera(data, "Camera2"), data.transform(key), rectified=False, rate_hz=rate)
    unit = depth_unit_m(data, "DepthMapFactor", "RGBD.DepthMapFactor")
    key, baseline = _stated_baseline(data, left)
    if baseline is not None and not left.distorted:
        return RawRig(left, left, se3(np.eye(3), [baseline, 0.0, 0.0]), depth_unit_m=unit, rate_hz=rate)
    no_pair = "one camera: a pair has Stereo.b (rectified) or Stereo.T_c1_c2 with Camera2"
    contradiction = f"{key} {_NEEDS_RECTIFIED}" if key else ""
    return RawRig(left, depth_unit_m=unit, rate_hz=rate, no_pair=no_pair, contradiction=contradiction)


def depth_unit_m(data: Fields, *keys: str) -> float | None:
    """Metres of one step of the depth, by the factor under one of the ``keys``; 0 is 1, as ORB-SLAM takes it."""
    key = data.first(*keys)
    if key not in data:
        return None
    factor = data.number(key)
    if factor < 0.0:
        raise data.fail(key, "steps of depth in a metre")
    return 1.0 / factor if factor > 0.0 else 1.0


def _stated_baseline(data: Fields, left: RawCamera) -> tuple[str, float | None]:
    """The key that tells the distance of a rectified pair, and the distance in metres. Of RGB-D, whose file has
    ``DepthMapFactor``, it is the projector's, and used where there are right images."""
    if "Stereo.b" in data:
        return "Stereo.b", data.number("Stereo.b")
    if "Camera.bf" in data:
        return "Camera.bf", data.number("Camera.bf") / left.fx
    return "", None


def _camera(data: Fields, name: str) -> RawCamera:
    given = data.text("Camera.type")
    model = _TYPES.get(given.lower())
    if model is None:
        raise data.fail("Camera.type", "PinHole, KannalaBrandt8 or Rectified")
    if model == "fisheye":
        coefficients = tuple(data.number(f"{name}.k{i}") for i in (1, 2, 3, 4))
    else:
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        coefficients = in_opencvs_order({key: data.number(f"{name}.{key}", 0.0) for key in names})
        coefficients = coefficients if model == "pinhole" or any(coefficients) else ()
    size = data.size("Camera.width", "Camera.height") or data.size("Camera.cols", "Camera.rows")
    intrinsics = [data.number(f"{name}.{key}") for key in ("fx", "fy", "cx", "cy")]
    return camera(data, intrinsics, size, model, coefficients)


def _raw_pair_of_sides(data: Fields, rate: float | None) -> RawRig:
    """ORB-SLAM2's ``LEFT.K LEFT.D LEFT.R LEFT.P`` and ``RIGHT`` alike."""
    left, right = (_side(data, side) for side in ("LEFT", "RIGHT"))
    P_left, P_right = (np.array(data.numbers(f"{side}.P", 12)).reshape(3, 4) for side in ("LEFT", "RIGHT"))
    if not states_baseline(P_left, P_right):
        return RawRig(left, right, _of_millimetres(data, P_right), rectified=False, rate_hz=rate)
    rotations = [rectifying_rotation(data, f"{side}.R") for side in ("LEFT", "RIGHT")]
    T_left_right = transform_of_rectified(rotations[0], rotations[1], baseline_of(data, P_left, P_right))
    return RawRig(left, right, T_left_right, rectified=False, rate_hz=rate)


def _of_millimetres(data: Fields, P_right: NDArray[np.float64]) -> NDArray[np.float64]:
    """``T_left_right`` of S3E's files, whose ``RIGHT.R`` and the last column of whose ``RIGHT.P`` are the transform
    from the left to the right camera, in millimetres; ``Camera.bf`` must say the same distance."""
    bf = data.number("Camera.bf", 0.0) / data.number("Camera.fx")
    distance = float(np.linalg.norm(P_right[:, 3])) / 1000.0
    if abs(distance - bf) > _SAME_DISTANCE * bf:
        raise data.fail("RIGHT.P", "a projection matrix of rectified images, whose third row is 0 0 1 0,")
    R = rectifying_rotation(data, "RIGHT.R")
    return se3_inverse(se3(R, P_right[:, 3] / 1000.0))


def _side(data: Fields, side: str) -> RawCamera:
    size = data.size(f"{side}.width", f"{side}.height")
    return camera(data, camera_matrix(data, f"{side}.K"), size, "pinhole", data.numbers(f"{side}.D"))
