"""COLMAP's ``cameras.txt`` and ``cameras.bin``: one camera, of any model that another name of ours stands for."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ...errors import FrontendError
from ...files.text_tables import read_bytes, read_text
from ..calibration import RawCamera, RawRig
from .checked_camera import camera
from .fields import Fields

FILES = ("cameras.txt", "cameras.bin")
_HALF_PX = 0.5  # the centre of COLMAP's first pixel is at (0.5, 0.5)
_HEAD = struct.Struct("<IiQQ")
_Numbers = Sequence[float]

# Number, name and how many parameters; a model without a reader is known by its length and refused by its name.
_MODELS: tuple[tuple[int, str, int, str, Callable[[_Numbers], _Numbers] | None], ...] = (
    (0, "SIMPLE_PINHOLE", 3, "none", lambda k: ()),
    (1, "PINHOLE", 4, "none", lambda k: ()),
    (2, "SIMPLE_RADIAL", 4, "radtan", lambda k: (*k, 0.0, 0.0, 0.0)),
    (3, "RADIAL", 5, "radtan", lambda k: (*k, 0.0, 0.0)),
    (4, "OPENCV", 8, "radtan", lambda k: k),
    (5, "OPENCV_FISHEYE", 8, "equidistant", lambda k: k),
    (6, "FULL_OPENCV", 12, "radtan", lambda k: k),
    (7, "FOV", 5, "fov", lambda k: k),
    (8, "SIMPLE_RADIAL_FISHEYE", 4, "equidistant", lambda k: (*k, 0.0, 0.0, 0.0)),
    (9, "RADIAL_FISHEYE", 5, "equidistant", lambda k: (*k, 0.0, 0.0)),
    (10, "THIN_PRISM_FISHEYE", 12, "", None),
    (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16, "", None),
    (12, "SIMPLE_DIVISION", 4, "", None),
    (13, "DIVISION", 5, "", None),
    (14, "SIMPLE_FISHEYE", 3, "equidistant", lambda k: (0.0,) * 4),
    (15, "FISHEYE", 4, "equidistant", lambda k: (0.0,) * 4),
    (16, "EUCM", 6, "eucm", lambda k: k),
    (17, "EQUIRECTANGULAR", 2, "", None),
)
_ONE_FOCAL = ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "SIMPLE_FISHEYE")


def read(path: Path) -> RawRig:
    """The camera of all images; a file with several unlike ones is refused."""
    found = _binary(path) if path.suffix == ".bin" else _text(path)
    cameras = [_camera(path, *one) for one in found]
    if not cameras:
        raise FrontendError(f"{path}: no camera in this file")
    if any(one != cameras[0] for one in cameras):
        raise FrontendError(f"{path}: {len(cameras)} unlike cameras; one folder of images for each is needed")
    return RawRig(cameras[0], form="COLMAP", no_pair="a pair's distance is not in COLMAP's file of cameras")


def _camera(path: Path, name: str, size: tuple[int, int], parameters: _Numbers) -> RawCamera:
    _, _, count, model, coefficients = next(one for one in _MODELS if one[1] == name)
    if coefficients is None:
        readable = ", ".join(one[1] for one in _MODELS if one[4] is not None)
        raise FrontendError(f"{path}: the model {name} is not read (known: {readable})")
    if len(parameters) != count or not np.isfinite(parameters).all():
        raise FrontendError(f"{path}: {name} has {count} finite parameters, found {len(parameters)}")
    focals = 1 if name in _ONE_FOCAL else 2
    fx, fy, (cx, cy) = parameters[0], parameters[focals - 1], parameters[focals : focals + 2]
    middle = (fx, fy, cx - _HALF_PX, cy - _HALF_PX)
    return camera(Fields({}, path), middle, size, model, tuple(coefficients(parameters[focals + 2 :])))


def _text(path: Path) -> list[tuple[str, tuple[int, int], list[float]]]:
    """Name, size and parameters on each line: number, model, width, height, parameters."""
    names, found = {one[1] for one in _MODELS}, []
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        if len(words) < 5 or not all(word.isdecimal() for word in (words[0], *words[2:4])):
            raise FrontendError(f"{path}:{number}: a camera's number, model, width, height and parameters expected")
        if words[1] not in names:
            raise FrontendError(f"{path}:{number}: the model {words[1][:40]!r} is not known")
        fields = Fields({"parameters": words[4:]}, path, f"line {number}: ")
        found.append((words[1], (int(words[2]), int(words[3])), list(fields.numbers("parameters"))))
    return found


def _binary(path: Path) -> list[tuple[str, tuple[int, int], list[float]]]:
    data, found = read_bytes(path), []
    models = {one[0]: one for one in _MODELS}
    try:
        (count,) = struct.unpack_from("<Q", data)
        at = 8
        for _ in range(min(count, len(data))):
            _, model, width, height = _HEAD.unpack_from(data, at)
            if model not in models:
                raise FrontendError(f"{path}: the model number {model} is not known")
            _, name, length, _, _ = models[model]
            found.append((name, (width, height), list(struct.unpack_from(f"<{length}d", data, at + _HEAD.size))))
            at += _HEAD.size + 8 * length
    except struct.error:
        raise FrontendError(f"{path}: cut off after {len(data)} bytes") from None
    if at != len(data):
        raise FrontendError(f"{path}: {len(data) - at} bytes behind the last camera")
    return found
