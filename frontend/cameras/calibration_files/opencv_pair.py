"""Two cameras in OpenCV's form: ``M1 D1 M2 D2`` with ``R T``, or a file for each camera, as ROS and RTAB-Map write
them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import is_se3, se3, se3_inverse

from ...errors import FrontendError
from ..calibration import RawCamera, RawRig
from .checked_camera import camera, camera_matrix, transform_of_rectified
from .fields import Fields
from .loading import load_fields
from .opencv import read_one

_MATRICES = ("M{}", "K{}", "cameraMatrix{}", "camera_matrix_{}", "camera_matrix{}")
_COEFFICIENTS = ("D{}", "distCoeffs{}", "distortion_coefficients_{}", "distortion_coefficients{}", "dist_coeffs{}")


def recognises(data: Fields) -> bool:
    """Whether this file holds the two cameras."""
    return any(name.format(1) in data and name.format(2) in data for name in _MATRICES)


def says_how_they_stand(data: Fields) -> bool:
    """Whether this file holds how the right camera stands beside the left one."""
    return "R" in data and "T" in data and "K" not in data


def read(data: Fields) -> RawRig:
    """The two cameras of a file that holds how they stand, too; else the left one."""
    left, right = (_numbered(data, number) for number in (1, 2))
    if not says_how_they_stand(data):
        return RawRig(left, contradiction="M1 and M2, but not how they stand: put the file with R and T beside it")
    return _together(left, right, data.turned_and_moved("R", "T"))


def read_with_stand(cameras: Fields, stand: Fields) -> RawRig:
    """The two cameras of one file, ``R`` and ``T`` from another: ``intrinsics.yml`` and ``extrinsics.yml``."""
    left, right = (_numbered(cameras, number) for number in (1, 2))
    return _together(left, right, stand.turned_and_moved("R", "T"))


def _together(left: RawCamera, right: RawCamera, T_right_left: NDArray[np.float64]) -> RawRig:
    return RawRig(left, right, se3_inverse(T_right_left), rectified=False)


def _numbered(data: Fields, number: int) -> RawCamera:
    matrix = data.first(*(name.format(number) for name in _MATRICES))
    key = data.first(*(name.format(number) for name in _COEFFICIENTS))
    coefficients = data.numbers(key) if key in data else ()
    xi = f"xi{number}"
    if xi in data:
        return camera(data, camera_matrix(data, matrix), _size(data), "mei", (data.number(xi), *coefficients))
    model = "fisheye" if data.says_fisheye else ""
    return camera(data, camera_matrix(data, matrix), _size(data), model, coefficients)


def _size(data: Fields) -> tuple[int, int] | None:
    for keys in (("image_width", "image_height"), ("width", "height")):
        if keys[0] in data:
            return data.size(*keys)
    return data.resolution(data.first("imageSize", "image_size", "size"))


def pair_of_files(left: Path, right: Path, stand: Path | None = None) -> RawRig:
    """A stereo rig of two files of one camera each.

    How the cameras stand is in ``stand`` (RTAB-Map's ``NAME_pose.yaml``), else in their rectification and projection
    matrices; where these are missing, the rig has the left camera alone and its ``contradiction`` says why.
    """
    fields = [load_fields(path) for path in (left, right)]
    cameras = [read_one(f) for f in fields]
    if stand is not None:
        T_right_left = load_fields(stand).turned_and_moved("rotation_matrix", "translation_matrix")
        return _together(cameras[0], cameras[1], T_right_left)
    if not all(_has_rectified(f) for f in fields):
        return RawRig(
            cameras[0],
            contradiction=f"{left.name} and {right.name} hold no rectification_matrix and projection_matrix (R, P): "
            "how the cameras stand is not known; --rig mono reads the left images alone",
        )
    return RawRig(cameras[0], cameras[1], transform_of_files(*fields), rectified=False)


_ROTATION = ("rectification_matrix", "R", "r")
_PROJECTION = ("projection_matrix", "P", "p")


def _has_rectified(fields: Fields) -> bool:
    return fields.first(*_ROTATION) in fields and fields.first(*_PROJECTION) in fields


def transform_of_files(left: Fields, right: Fields) -> NDArray[np.float64]:
    """``T_left_right`` of the rectification and projection matrices of two files."""
    rotations = [rectifying_rotation(f, f.first(*_ROTATION)) for f in (left, right)]
    P_left, P_right = (np.array(f.numbers(f.first(*_PROJECTION), 12)).reshape(3, 4) for f in (left, right))
    return transform_of_rectified(rotations[0], rotations[1], baseline_of(left, P_left, P_right))


def rectifying_rotation(fields: Fields, key: str) -> NDArray[np.float64]:
    """The rotation ``(3, 3)`` at ``key``."""
    rotation = np.array(fields.numbers(key, 9)).reshape(3, 3)
    if not is_se3(se3(rotation, np.zeros(3)), 1e-3):
        raise fields.fail(key, "a rotation matrix")
    return rotation


def states_baseline(P_left: NDArray[np.float64], P_right: NDArray[np.float64]) -> bool:
    """Whether two projection matrices are of rectified images, whose third row is 0 0 1 0: with anything else in it,
    the fourth column is a transform of another kind (S3E writes millimetres there)."""
    return bool(np.allclose(np.stack([P_left[2], P_right[2]]), [0.0, 0.0, 1.0, 0.0], atol=1e-6))


def baseline_of(fields: Fields, P_left: NDArray[np.float64], P_right: NDArray[np.float64]) -> float:
    """Where the right camera stands along x, metres, by two projection matrices ``(3, 4)`` after rectification."""
    if P_right[0, 0] <= 0.0:
        raise FrontendError(f"{fields.path}: the projection matrix of the right camera has the focal length 0")
    if not states_baseline(P_left, P_right):
        raise FrontendError(
            f"{fields.path}: projection matrices whose third row is not 0 0 1 0 are not of rectified images: how the "
            "cameras stand is not known; --rig mono reads the left images alone"
        )
    return float((P_left[0, 3] - P_right[0, 3]) / P_right[0, 0])
