"""A camera from the numbers and names of a file, refused where they contradict each other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from maslam._suggestions import did_you_mean
from maslam.backend.geometry import product, se3, se3_inverse

from ...errors import FrontendError
from ..calibration import Distortion, RawCamera
from .fields import Fields

_DISTORTIONS = {
    "": Distortion.RADIAL_TANGENTIAL,
    "plumb_bob": Distortion.RADIAL_TANGENTIAL,
    "radtan": Distortion.RADIAL_TANGENTIAL,
    "radial-tangential": Distortion.RADIAL_TANGENTIAL,
    "rational_polynomial": Distortion.RADIAL_TANGENTIAL,
    "pinhole": Distortion.RADIAL_TANGENTIAL,
    "perspective": Distortion.RADIAL_TANGENTIAL,
    "equidistant": Distortion.EQUIDISTANT,
    "fisheye": Distortion.EQUIDISTANT,
    "kannalabrandt8": Distortion.EQUIDISTANT,
    "kannala_brandt": Distortion.EQUIDISTANT,
    "kb4": Distortion.EQUIDISTANT,
    "fov": Distortion.FIELD_OF_VIEW,
    "ds": Distortion.DOUBLE_SPHERE,
    "eucm": Distortion.EXTENDED_UNIFIED,
    "mei": Distortion.OMNIDIRECTIONAL,
    "none": Distortion.NONE,
    "rectified": Distortion.NONE,
}
_COUNTS: dict[Distortion, tuple[int, ...]] = {
    Distortion.NONE: (0,),
    Distortion.RADIAL_TANGENTIAL: (4, 5, 8, 12, 14),
    Distortion.EQUIDISTANT: (4,),
    Distortion.FIELD_OF_VIEW: (1,),
    Distortion.DOUBLE_SPHERE: (2,),
    Distortion.EXTENDED_UNIFIED: (2,),
    Distortion.OMNIDIRECTIONAL: (5,),
}
_MAY_BE_ZERO = (Distortion.NONE, Distortion.RADIAL_TANGENTIAL)
_MAX_SKEW = 1e-4  # of the focal length: a hundredth of a pixel or two at the image's edge


def camera(
    fields: Fields, intrinsics: Sequence[float], size: tuple[int, int] | None, model: str, coefficients: Sequence[float]
) -> RawCamera:
    """A camera of ``fx fy cx cy`` in pixels; ``model`` by any of the names that the formats use for it,
    ``coefficients`` in the order of :data:`COEFFICIENT_NAMES`."""
    distortion = _DISTORTIONS.get(model.lower())
    if distortion is None:
        raise FrontendError(
            f"{fields.path}: {fields.prefix}distortion model {model!r} is not known (radial-tangential, equidistant, "
            "fov, double sphere, omnidirectional, none)"
        )
    kept = tuple(coefficients)
    if distortion in _MAY_BE_ZERO and not any(kept):
        distortion, kept = Distortion.NONE, ()
    if len(kept) not in _COUNTS[distortion]:
        raise FrontendError(
            f"{fields.path}: {fields.prefix}{len(kept)} coefficients for {distortion} distortion, "
            f"expected one of {list(_COUNTS[distortion])}"
        )
    _check_coefficients(fields, distortion, kept)
    fx, fy, cx, cy = intrinsics
    if min(fx, fy) <= 0:
        raise FrontendError(f"{fields.path}: {fields.prefix}focal lengths {fx}, {fy} px cannot be")
    return RawCamera(fx, fy, cx, cy, size, distortion, kept)


def _check_coefficients(fields: Fields, distortion: Distortion, kept: tuple[float, ...]) -> None:
    """Refuse what no lens of the model has."""
    name, value, least, most = {
        Distortion.FIELD_OF_VIEW: lambda: ("w", kept[0], 0.0, np.pi),
        Distortion.DOUBLE_SPHERE: lambda: ("alpha", kept[1], 0.0, 1.0),
        Distortion.EXTENDED_UNIFIED: lambda: ("alpha", kept[0], 0.0, 1.0),
        Distortion.OMNIDIRECTIONAL: lambda: ("xi", kept[0], 0.0, 100.0),
    }.get(distortion, lambda: ("", 0.0, 0.0, 1.0))()
    if not least <= value <= most:
        raise FrontendError(
            f"{fields.path}: {fields.prefix}{name} {value:g} of {distortion} distortion is outside "
            f"{least:g} to {most:.4g}"
        )
    if distortion is Distortion.EXTENDED_UNIFIED and kept[1] <= 0.0:
        raise FrontendError(f"{fields.path}: {fields.prefix}beta {kept[1]:g} of {distortion} distortion is not above 0")


def camera_matrix(fields: Fields, key: str) -> tuple[float, float, float, float]:
    """``fx fy cx cy`` of the camera matrix at ``key``; other numbers in it than a camera without skew has are
    refused."""
    K = np.array(fields.numbers(key, 9)).reshape(3, 3)
    if not K.any():
        raise fields.fail(key, "the matrix of a calibrated camera")
    if not np.allclose([K[1, 0], K[2, 0], K[2, 1], K[2, 2]], [0.0, 0.0, 0.0, 1.0], atol=1e-6):
        raise fields.fail(key, "a camera matrix, row by row (fx 0 cx 0 fy cy 0 0 1),")
    if abs(K[0, 1]) > _MAX_SKEW * abs(K[0, 0]):
        raise fields.fail(key, f"a camera without skew (here {K[0, 1]:g} px; calibrate with it fixed to 0)")
    return float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2])


def refuse_other_names(fields: Fields, word: str, known: Sequence[str]) -> None:
    """Refuse a key with ``word`` in it that is none of the ``known``: passed over, a lens would be without
    distortion."""
    for key in map(str, fields.data):
        if word in key.lower() and key not in known:
            raise FrontendError(f"{fields.path}: {fields.prefix}{key}: no such key{did_you_mean(key, known)}")


def in_opencvs_order(k: dict[str, float]) -> tuple[float, ...]:
    """Radial and tangential coefficients under their names, as many as OpenCV has a model for."""
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    values = [k.get(name, 0.0) for name in names]
    count = 8 if any(values[5:]) else 5 if values[4] else 4
    return tuple(values[:count])


def numbers_under_names(fields: Fields, names: Sequence[str], prefix: str = "") -> list[float]:
    """The numbers under ``prefix`` with each of the ``names``; all must be there."""
    return [fields.number(f"{prefix}{name}") for name in names]


def transform_of_rectified(
    R_left: NDArray[np.float64], R_right: NDArray[np.float64], baseline_m: float
) -> NDArray[np.float64]:
    """``T_left_right`` of two cameras of which each is turned into a common orientation by its rotation, in which the
    right one stands at ``x = baseline_m``."""
    moved = product(se3_inverse(se3(R_left, np.zeros(3))), se3(np.eye(3), [baseline_m, 0.0, 0.0]))
    return product(moved, se3(R_right, np.zeros(3)))
