"""Calibration files of other tools, recognised by their content: OpenCV, ROS camera_info, ORB-SLAM, Kalibr, and our
own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from maslam._suggestions import did_you_mean
from maslam.backend.geometry import is_se3, product, se3, se3_inverse

from ..errors import FrontendError
from ..files.text_tables import read_bytes
from .calibration import Distortion, RawCamera, RawRig

_DISTORTIONS = {
    "": Distortion.RADIAL_TANGENTIAL,
    "plumb_bob": Distortion.RADIAL_TANGENTIAL,
    "radtan": Distortion.RADIAL_TANGENTIAL,
    "radial-tangential": Distortion.RADIAL_TANGENTIAL,
    "rational_polynomial": Distortion.RADIAL_TANGENTIAL,
    "pinhole": Distortion.RADIAL_TANGENTIAL,
    "equidistant": Distortion.EQUIDISTANT,
    "fisheye": Distortion.EQUIDISTANT,
    "kannalabrandt8": Distortion.EQUIDISTANT,
    "none": Distortion.NONE,
    "rectified": Distortion.NONE,
}
_COUNTS = {Distortion.NONE: range(99), Distortion.RADIAL_TANGENTIAL: (4, 5, 8, 12, 14), Distortion.EQUIDISTANT: (4,)}


def read_calibration(path: Path) -> RawRig:
    """One or two cameras from a YAML file of any of the formats named above.

    A ROS or OpenCV file holds one camera; for a pair of such files see :func:`pair_of_files`. Raises
    :class:`FrontendError` naming the key that is missing or wrong, or for a file of no known format.
    """
    data = Fields(_load(path), path)
    if "fx" in data and "width" in data:
        return _own(data)
    if "cam0" in data:
        return _kalibr(data)
    if "Camera.fx" in data or "Camera1.fx" in data:
        return _orb_slam(data)
    if "camera_matrix" in data or "K" in data:
        return RawRig(_ros_or_opencv(data))
    raise FrontendError(
        f"{path}: no camera in this file (known: OpenCV camera_matrix, ROS camera_info, ORB-SLAM Camera.fx, "
        "Kalibr cam0, our own fx and width)"
    )


class Fields:
    """The keys of one calibration file. Each access checks the value; a wrong one raises :class:`FrontendError`, naming
    file and key."""

    def __init__(self, data: dict[str, Any], path: Path, prefix: str = "") -> None:
        self.data, self.path, self.prefix = data, path, prefix

    def __contains__(self, key: str) -> bool:
        return self.data.get(key) is not None

    def fail(self, key: str, expected: str) -> FrontendError:
        """The error that ``expected`` is missing at ``key``, to be raised."""
        found = repr(self.data.get(key))
        return FrontendError(f"{self.path}: {self.prefix}{key}: {expected} expected, found {found[:60]}")

    def number(self, key: str, default: float | None = None) -> float:
        """A finite number; ``default`` where the key is absent, an error without one."""
        if default is not None and key not in self:
            return default
        try:
            value = float(self.data[key])
        except (KeyError, TypeError, ValueError):
            raise self.fail(key, "a number") from None
        if not np.isfinite(value):
            raise self.fail(key, "a finite number")
        return value

    def numbers(self, key: str, count: int | None = None) -> tuple[float, ...]:
        """A list, a nested list, or the ``data`` of a matrix."""
        value = self.data.get(key)
        value = value.get("data") if isinstance(value, dict) else value
        try:
            flat = np.array(value, dtype=np.float64).ravel()
        except (TypeError, ValueError):
            raise self.fail(key, "a list of numbers") from None
        if value is None or not np.isfinite(flat).all() or (count is not None and len(flat) != count):
            raise self.fail(key, "finite numbers" if count is None else f"{count} finite numbers")
        return tuple(flat.tolist())

    def text(self, key: str) -> str:
        """The value at ``key`` as text; empty where the key is absent."""
        return str(self.data.get(key) or "").strip()

    def inner(self, key: str) -> Fields:
        """The group of keys at ``key``."""
        if not isinstance(self.data.get(key), dict):
            raise self.fail(key, "a group of keys")
        return Fields(self.data[key], self.path, f"{self.prefix}{key}.")

    def size(self, width: str, height: str) -> tuple[int, int] | None:
        """``(width, height)`` pixels under these two keys; None where one is absent."""
        return (int(self.number(width)), int(self.number(height))) if width in self and height in self else None

    def transform(self, key: str) -> NDArray[np.float64]:
        """A rigid transform ``(4, 4)``, of 16 numbers."""
        matrix = np.array(self.numbers(key, 16)).reshape(4, 4)
        if not is_se3(matrix, 1e-3):
            raise self.fail(key, "a rigid 4x4 transform")
        return matrix


def camera(
    fields: Fields, intrinsics: Sequence[float], size: tuple[int, int] | None, model: str, coefficients: Sequence[float]
) -> RawCamera:
    """A camera of ``fx fy cx cy`` in pixels; ``model`` by any of the names that the formats use for it."""
    distortion = _DISTORTIONS.get(model.lower())
    if distortion is None:
        raise FrontendError(
            f"{fields.path}: distortion model {model!r} is not known (radial-tangential, equidistant, none)"
        )
    kept = tuple(coefficients) if any(coefficients) else ()
    if kept and len(kept) not in _COUNTS[distortion]:
        raise FrontendError(
            f"{fields.path}: {len(kept)} coefficients for {distortion} distortion, "
            f"expected one of {list(_COUNTS[distortion])}"
        )
    fx, fy, cx, cy = intrinsics
    if min(fx, fy) <= 0:
        raise FrontendError(f"{fields.path}: focal lengths {fx}, {fy} px cannot be")
    return RawCamera(fx, fy, cx, cy, size, distortion if kept else Distortion.NONE, kept)


class _Loader(yaml.SafeLoader):
    """YAML as OpenCV writes it: its matrices are plain groups of keys."""


def _opencv_matrix(loader: yaml.SafeLoader, node: yaml.MappingNode) -> dict[Any, Any]:
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _opencv_matrix)


def _load(path: Path) -> dict[str, Any]:
    text = read_bytes(path).decode("utf-8", "replace")
    if text.startswith("%YAML"):  # OpenCV's "%YAML:1.0" is not what YAML allows there
        text = text.partition("\n")[2]
    try:
        data = yaml.load(text, Loader=_Loader)
    except (yaml.YAMLError, ValueError) as error:
        raise FrontendError(f"{path}: not YAML: {' '.join(str(error).split())}") from error
    if not isinstance(data, dict):
        raise FrontendError(f"{path}: not a calibration: keys and values expected")
    return data


def load_fields(path: Path) -> Fields:
    """The keys of any YAML file, OpenCV's dialect included."""
    return Fields(_load(path), path)


_OWN_KEYS = ("width", "height", "fx", "fy", "cx", "cy", "baseline_m", "depth_unit_m", "rate_hz")


def _own(data: Fields) -> RawRig:
    """Rectified cameras; a key that is not ours is refused: read as nothing, ``baseline: 0.5`` makes a pair one camera,
    and ``k1: -0.3`` makes straight lines of bent ones."""
    for key in map(str, data.data):
        if key not in _OWN_KEYS:
            raise FrontendError(f"{data.path}: {key}: no such key{did_you_mean(key, _OWN_KEYS)}")
    left = camera(
        data, [data.number(key) for key in ("fx", "fy", "cx", "cy")], data.size("width", "height"), "none", ()
    )
    optional = {key: data.number(key) for key in ("baseline_m", "depth_unit_m", "rate_hz") if key in data}
    T_left_right = se3(np.eye(3), [optional["baseline_m"], 0.0, 0.0]) if "baseline_m" in optional else None
    right = left if T_left_right is not None else None
    return RawRig(left, right, T_left_right, depth_unit_m=optional.get("depth_unit_m"), rate_hz=optional.get("rate_hz"))


def _ros_or_opencv(data: Fields) -> RawCamera:
    """``camera_matrix`` and friends as files have them, or ``K``, ``D`` as the ROS message has them."""
    K = data.numbers("camera_matrix" if "camera_matrix" in data else "K", 9)
    coefficients_key = next((key for key in ("distortion_coefficients", "dist_coeffs", "D") if key in data), None)
    coefficients = data.numbers(coefficients_key) if coefficients_key else ()
    sizes = (
        data.size(w, h)
        for w, h in (("image_width", "image_height"), ("image_Width", "image_Height"), ("width", "height"))
    )
    return camera(
        data, (K[0], K[4], K[2], K[5]), next(filter(None, sizes), None), data.text("distortion_model"), coefficients
    )


def pair_of_files(left: Path, right: Path) -> RawRig:
    """A stereo rig of two ROS camera_info files, whose rectification and projection matrices hold how the cameras
    stand."""
    fields = [Fields(_load(path), path) for path in (left, right)]
    rectified = [_rectified(f, "rectification_matrix", "R", "projection_matrix", "P") for f in fields]
    cameras = [_ros_or_opencv(f) for f in fields]
    return RawRig(cameras[0], cameras[1], _transform_of_rectified(rectified), rectified=False)


def _rectified(fields: Fields, *keys: str) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    rotation = next(key for key in (*keys[:2], keys[0]) if key in fields or key == keys[0])
    projection = next(key for key in (*keys[2:], keys[2]) if key in fields or key == keys[2])
    return np.array(fields.numbers(rotation, 9)).reshape(3, 3), np.array(fields.numbers(projection, 12)).reshape(3, 4)


def _transform_of_rectified(pair: Sequence[tuple[NDArray[np.float64], NDArray[np.float64]]]) -> NDArray[np.float64]:
    """``T_left_right`` of two cameras given by rectifying rotations and projection matrices after rectification."""
    (R_left, P_left), (R_right, P_right) = pair
    x = (P_left[0, 3] - P_right[0, 3]) / P_right[0, 0]
    return product(
        product(se3_inverse(se3(R_left, np.zeros(3))), se3(np.eye(3), [x, 0.0, 0.0])), se3(R_right, np.zeros(3))
    )


def _kalibr(data: Fields) -> RawRig:
    cams = [data.inner(key) for key in ("cam0", "cam1") if key in data]
    for cam in cams:
        if cam.text("camera_model") not in ("pinhole", ""):
            raise cam.fail("camera_model", "pinhole")
    cameras = [
        camera(
            cam,
            cam.numbers("intrinsics", 4),
            _resolution(cam),
            cam.text("distortion_model"),
            cam.numbers("distortion_coeffs"),
        )
        for cam in cams
    ]
    if len(cams) == 1:
        return RawRig(cameras[0])
    return RawRig(cameras[0], cameras[1], se3_inverse(cams[1].transform("T_cn_cnm1")), rectified=False)


def _resolution(fields: Fields) -> tuple[int, int]:
    width, height = fields.numbers("resolution", 2)
    return int(width), int(height)


def _orb_slam(data: Fields) -> RawRig:
    """ORB-SLAM2's and ORB-SLAM3's settings: one camera, a rectified pair (``Camera.bf`` or ``Stereo.b``), or a raw
    pair."""
    name = "Camera" if "Camera.fx" in data else "Camera1"
    left = _orb_slam_camera(data, name)
    rate = data.number("Camera.fps") if "Camera.fps" in data else None
    factor = next((data.number(key) for key in ("DepthMapFactor", "RGBD.DepthMapFactor") if key in data), None)
    depth_unit = None if factor is None else (1.0 / factor if factor > 0 else 1.0)
    if "LEFT.K" in data:
        sides = [_orb_slam_side(data, side) for side in ("LEFT", "RIGHT")]
        transform = _transform_of_rectified(
            [_rectified(data, f"{s}.R", f"{s}.R", f"{s}.P", f"{s}.P") for s in ("LEFT", "RIGHT")]
        )
        return RawRig(sides[0], sides[1], transform, rectified=False, rate_hz=rate)
    if "Stereo.T_c1_c2" in data:
        right = _orb_slam_camera(data, "Camera2")
        return RawRig(left, right, data.transform("Stereo.T_c1_c2"), rectified=False, rate_hz=rate)
    baseline = data.number("Stereo.b") if "Stereo.b" in data else None
    if baseline is None and "Camera.bf" in data and not left.distorted:
        baseline = data.number("Camera.bf") / left.fx
    if baseline is None:
        return RawRig(left, depth_unit_m=depth_unit, rate_hz=rate)
    return RawRig(left, left, se3(np.eye(3), [baseline, 0.0, 0.0]), depth_unit_m=depth_unit, rate_hz=rate)


def _orb_slam_camera(data: Fields, name: str) -> RawCamera:
    model = data.text("Camera.type")
    order = ("k1", "k2", "k3", "k4") if model == "KannalaBrandt8" else ("k1", "k2", "p1", "p2", "k3")
    coefficients = [data.number(f"{name}.{key}", 0.0) for key in order]
    if len(order) == 5 and coefficients[-1] == 0.0:
        coefficients.pop()
    return camera(
        data,
        [data.number(f"{name}.{key}") for key in ("fx", "fy", "cx", "cy")],
        data.size("Camera.width", "Camera.height"),
        model,
        coefficients,
    )


def _orb_slam_side(data: Fields, side: str) -> RawCamera:
    K = data.numbers(f"{side}.K", 9)
    return camera(
        data, (K[0], K[4], K[2], K[5]), data.size(f"{side}.width", f"{side}.height"), "", data.numbers(f"{side}.D")
    )
