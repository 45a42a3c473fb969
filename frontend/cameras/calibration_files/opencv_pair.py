"""Two cameras in OpenCV's form: ``M1 D1 M2 D2`` with ``R T``, or a file for each camera, as ROS and RTAB-Map write
them."""

from __future__ import annotations

import re
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

_MATRICES = ("M{}", "K{}", "cameraMatrix{}", "camera_matrix_{}", "camera_matrix{}", "mtx{}")
_COEFFICIENTS = (
    "D{}", "distCoeffs{}", "distortion_coefficients_{}", "distortion_coefficients{}", "dist_coeffs{}", "dist{}",
)  # fmt: skip
_OF_A_LENS = re.compile(r"(dist(?!ance)|coef)(?!.*(model|type))", re.IGNORECASE)
_SIDES = (("1", "2"), ("L", "R"), ("l", "r"), ("_left", "_right"), ("_l", "_r"), ("_L", "_R"), ("Left", "Right"))
"""What is behind the names of matrices, of the left camera and of the right one."""


def recognises(data: Fields) -> bool:
    """Whether this file holds the two cameras."""
    return _sides(data) is not None


def _sides(data: Fields) -> tuple[str, str] | None:
    """What distinguishes the keys of the two cameras; None where there are not two."""
    return next((one for one in _SIDES if all(data.first(*_named(_MATRICES, side)) in data for side in one)), None)


def _named(names: tuple[str, ...], side: str) -> list[str]:
    return [name.format(side) for name in names]


def says_how_they_stand(data: Fields) -> bool:
    """Whether this file holds how the right camera stands beside the left one."""
    return "R" in data and "T" in data and "K" not in data


def read(data: Fields) -> RawRig:
    """The two cameras of a file that holds how they stand, too; else the left one."""
    left, right = _both(data)
    if not says_how_they_stand(data):
        return RawRig(left, contradiction="M1 and M2, but not how they stand: put the file with R and T beside it")
    return _together(left, right, data.turned_and_moved("R", "T"))


def read_with_stand(cameras: Fields, stand: Fields) -> RawRig:
    """The two cameras of one file, ``R`` and ``T`` from another: ``intrinsics.yml`` and ``extrinsics.yml``."""
    left, right = _both(cameras)
    return _together(left, right, stand.turned_and_moved("R", "T"))


def _together(left: RawCamera, right: RawCamera, T_right_left: NDArray[np.float64]) -> RawRig:
    return RawRig(left, right, se3_inverse(T_right_left), rectified=False)


def _both(data: Fields) -> tuple[RawCamera, RawCamera]:
    left, right = _sides(data) or _SIDES[0]
    return _camera_of(data, left), _camera_of(data, right)


def _camera_of(data: Fields, side: str) -> RawCamera:
    matrix = data.first(*_named(_MATRICES, side))
    key = data.first(*_named(_COEFFICIENTS, side))
    coefficients = data.numbers(key) if key in data else ()
    if key not in data:
        unknown = [one for one in map(str, data.data) if _OF_A_LENS.search(one)]
        if unknown:
            raise data.fail(unknown[0], f"coefficients of a lens under another name ({key})")
    xi = f"xi{side}"
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
