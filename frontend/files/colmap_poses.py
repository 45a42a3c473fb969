"""Poses of COLMAP's ``images.txt`` and ``images.bin``: of the world in each image's camera, by the images' names."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import rotation_from_quat_wxyz, se3, se3_inverse

from ..errors import FrontendError
from .headed_table import is_number
from .text_tables import read_bytes, read_text

FILES = ("images.txt", "images.bin")
MODELS = (".", "sparse", "sparse/0", "colmap/sparse/0")
"""Folders where a model lies beside images."""
NOTE = "COLMAP's poses, which map the world to the camera: inverted; in a unit of its own, which need not be metres"
_HEAD = struct.Struct("<I7dI")  # number, quaternion (w x y z), translation, camera
_POINT_BYTES = 24  # of a key-point: x, y and the number of its 3-D point
_FIELDS = 10
_UNIT_LENGTH = 0.05


def find_colmap_images(folder: Path) -> Path | None:
    """The file of poses of the model in ``folder``, or where a model lies beside images; None without. A list of names
    that is called ``images.txt``, too, is none."""
    places = (folder / inside / name for inside in MODELS for name in FILES)
    return next((path for path in places if is_colmap_images(path)), None)


def is_colmap_images(path: Path) -> bool:
    """Whether ``path`` is such a file, by its name and, of text, its first line."""
    if path.name.lower() not in FILES or not path.is_file():
        return False
    if path.suffix.lower() == ".bin":
        return True
    with path.open("rb") as file:
        for raw in file:
            words = raw.decode("utf-8-sig", "replace").split()
            if words and not words[0].startswith("#"):
                return _is_image(words)
    return False


def read_colmap_poses(path: Path) -> tuple[tuple[str, ...], NDArray[np.float64]]:
    """Names of the images and their poses ``T_W_C`` ``(N, 4, 4)``, in order of the file. :class:`FrontendError` with
    the line for what is no image, and for a file that is cut off."""
    names, rows = _binary(path) if path.suffix.lower() == ".bin" else _text(path)
    if not rows:
        raise FrontendError(f"{path}: no poses in this file")
    values = np.array(rows)
    lengths = np.linalg.norm(values[:, :4], axis=1)
    for k in np.flatnonzero(~(np.abs(lengths - 1.0) <= _UNIT_LENGTH) | ~np.isfinite(values).all(axis=1))[:1]:
        raise FrontendError(f"{path}: {names[k]}: the quaternion's length is {lengths[k]:.3f}, expected 1")
    T_C_W = se3(rotation_from_quat_wxyz(values[:, :4] / lengths[:, None]), values[:, 4:])
    return tuple(names), np.asarray(se3_inverse(T_C_W)).reshape(-1, 4, 4)


def numbers_of_names(path: Path) -> dict[str, str]:
    """Names of the images of ``images.txt`` by their numbers, as points name them."""
    return {words[0]: " ".join(words[_FIELDS - 1 :]) for _, words in _images(path)}


def _text(path: Path) -> tuple[list[str], list[list[float]]]:
    names, rows = [], []
    for _, words in _images(path):
        names.append(" ".join(words[_FIELDS - 1 :]))
        rows.append([float(word) for word in words[1:8]])
    return names, rows


def _images(path: Path) -> list[tuple[int, list[str]]]:
    """The first of the two lines of each image; the second one holds key-points, may be empty, and is missing in some
    files that are made by hand."""
    found: list[tuple[int, list[str]]] = []
    points = False
    for number, line in enumerate(read_text(path).splitlines(), 1):
        words = line.split()
        if line.startswith("#"):
            continue
        if points and (not words or (len(words) % 3 == 0 and all(map(is_number, words)))):
            points = False
            continue
        if not words:
            continue
        if not _is_image(words):
            raise FrontendError(
                f"{path}:{number}: an image's number, qw qx qy qz, tx ty tz, camera and name expected, found "
                f"{line.strip()[:60]!r}"
            )
        found.append((number, words))
        points = True
    return found


def _is_image(words: list[str]) -> bool:
    return len(words) >= _FIELDS and words[0].isdecimal() and words[8].isdecimal() and all(map(is_number, words[1:8]))


def _binary(path: Path) -> tuple[list[str], list[list[float]]]:
    data = read_bytes(path)
    names: list[str] = []
    rows: list[list[float]] = []
    try:
        (count,) = struct.unpack_from("<Q", data)
        at = 8
        for _ in range(min(count, len(data))):
            row = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            end = data.index(b"\0", at)
            (points,) = struct.unpack_from("<Q", data, end + 1)
            names.append(data[at:end].decode("utf-8", "replace"))
            rows.append(list(row[1:8]))
            at = end + 9 + _POINT_BYTES * points
    except (struct.error, ValueError):
        raise FrontendError(f"{path}: cut off after {len(data)} bytes") from None
    if at != len(data):
        raise FrontendError(f"{path}: {abs(at - len(data))} bytes {'missing' if at > len(data) else 'too many'}")
    return names, rows
