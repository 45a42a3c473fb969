"""Image files: found in natural order, looked at before they are decoded, decoded once."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.text_tables import read_bytes
from .image_headers import ImageHeader, read_header

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"})
_AS_STORED = cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
"""Calibrations and poses are of images as stored: an orientation in the file is not applied."""
_MAX_BYTES = 1 << 30
MASK_FILES = ("mask.png", "camera_mask.png")
"""Masks of all images, that may lie among them."""


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key by which ``frame2`` comes before ``frame10``."""
    return tuple((0, int(part), part) if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name) if part)


def list_images(folder: Path) -> list[Path]:
    """Image files directly in ``folder``, in natural order; hidden files and masks of all images are left out."""
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if is_image(path)), key=lambda p: natural_key(p.name))


def is_image(path: Path) -> bool:
    """Whether a file is one by its name; hidden files and masks of all images are not."""
    name = path.name
    return (
        path.suffix.lower() in IMAGE_SUFFIXES and not name.startswith(".") and name not in MASK_FILES and path.is_file()
    )


def read_grey(path: Path) -> NDArray[Any]:
    """``(H, W)`` grey as stored: uint8, or uint16 where the file holds more than 8 bits (see
    :class:`~.pixel_values.PixelValues`). :class:`FrontendError` where the file is missing, cut off, too large or not an
    image that is read."""
    return decode(_stored_bytes(path), path, cv2.IMREAD_GRAYSCALE | _AS_STORED)


def read_colour(path: Path) -> NDArray[Any]:
    """``(H, W, 3)`` BGR, uint8 or uint16, whatever the file holds; errors as :func:`read_grey`'s."""
    return decode(_stored_bytes(path), path, cv2.IMREAD_COLOR | _AS_STORED)


def read_numbers(path: Path) -> NDArray[Any]:
    """The values of a depth image as stored, which may be real numbers; errors as :func:`read_grey`'s."""
    return decode(_stored_bytes(path), path, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION, depth=True)


def first_size(paths: Sequence[Path]) -> tuple[int, int]:
    """Width and height in pixels of the first image that can be decoded; the first one's error where none can."""
    errors = []
    for path in paths:
        try:
            height, width = read_grey(path).shape
        except FrontendError as error:
            errors.append(error)
        else:
            return width, height
    raise errors[0]


def header_of(path: Path) -> ImageHeader:
    """What the file says of itself; :class:`FrontendError` where it is missing, empty, or refused undecoded."""
    return _checked(_stored_bytes(path), path)[1]


def _stored_bytes(path: Path) -> bytes:
    try:
        size = path.stat().st_size
    except OSError as error:
        raise FrontendError(f"{path}: cannot be read: {error.strerror}") from error
    if size > _MAX_BYTES:
        raise FrontendError(f"{path}: a file of {size / 2**20:.0f} MB, more than the {_MAX_BYTES >> 20} of an image")
    return read_bytes(path)


def _checked(data: bytes, name: object, depth: bool = False) -> tuple[bytes, ImageHeader]:
    """The bytes of the image alone, and its header, which refuses nothing."""
    if not data:
        raise FrontendError(f"{name}: the file is empty")
    header = read_header(data)
    if header.refusal and not (depth and header.only_depth):
        raise FrontendError(f"{name}: {header.refusal}")
    if not header.whole:
        raise FrontendError(f"{name}: the image is cut off after {len(data)} bytes")
    return data[: header.end], header


def decode(data: bytes, name: object, flags: int, depth: bool = False) -> NDArray[Any]:
    """Pixels of an image file's bytes, by OpenCV's ``flags``; ``name`` in messages; ``depth``: also what only depth is
    stored as. Errors as :func:`read_grey`'s."""
    data, _ = _checked(data, name, depth)
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as error:
        raise FrontendError(f"{name}: cannot be decoded: {error.err}") from error
    if image is None or not image.size:
        raise FrontendError(
            f"{name}: not an image that can be decoded (damaged, or of another format than its name says)"
        )
    return image
