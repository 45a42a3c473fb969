"""Image files: found in natural order, decoded once, and distinguished from half-written ones."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.text_tables import read_bytes

IMAGE_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm", ".ppm", ".webp"})
_PNG_START = b"\x89PNG\r\n\x1a\n"
_JPEG_START = b"\xff\xd8"


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key by which ``frame2`` comes before ``frame10``."""
    return tuple((0, int(part), part) if part.isdigit() else (1, 0, part) for part in re.split(r"(\d+)", name) if part)


def list_images(folder: Path) -> list[Path]:
    """Image files directly in ``folder``, in natural order; hidden files are not images."""
    if not folder.is_dir():
        return []
    return sorted((path for path in folder.iterdir() if is_image(path)), key=lambda p: natural_key(p.name))


def is_image(path: Path) -> bool:
    """Whether a file is one by its name; hidden files are not."""
    return path.suffix.lower() in IMAGE_SUFFIXES and not path.name.startswith(".") and path.is_file()


def read_grey(path: Path) -> NDArray[np.uint8]:
    """``(H, W)`` uint8 grey, whatever the file holds. :class:`FrontendError` where the file is missing, cut off or
    not an image."""
    image = decode_file(path, cv2.IMREAD_GRAYSCALE)
    return image.astype(np.uint8, copy=False)


def read_colour(path: Path) -> NDArray[np.uint8]:
    """``(H, W, 3)`` uint8 BGR, whatever the file holds; errors as :func:`read_grey`'s."""
    image = decode_file(path, cv2.IMREAD_COLOR)
    return image.astype(np.uint8, copy=False)


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


def decode_file(path: Path, flags: int) -> NDArray[np.generic]:
    """The image in the file as OpenCV decodes it; errors as :func:`read_grey`'s."""
    return decode(read_bytes(path), path, flags)


def decode(data: bytes, name: object, flags: int) -> NDArray[np.generic]:
    """Pixels of an image file's bytes, by OpenCV's ``flags``; ``name`` in messages. Errors as :func:`read_grey`'s."""
    if not data:
        raise FrontendError(f"{name}: the file is empty")
    complete = _is_complete(data)
    if not complete:
        raise FrontendError(f"{name}: the image is cut off after {len(data)} bytes")
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), flags)
    except cv2.error as error:
        raise FrontendError(f"{name}: cannot be decoded: {error.err}") from error
    if image is None or not image.size:
        raise FrontendError(
            f"{name}: not an image that can be decoded (damaged, or of another format than its name says)"
        )
    return image


def _is_complete(data: bytes) -> bool:
    """False for a PNG or JPEG that stops early: decoders pass those on with a grey or black rest and no error."""
    if data.startswith(_PNG_START):
        return _png_is_complete(data)
    if data.startswith(_JPEG_START):
        # The end marker must follow the last scan: in coded data FF is stuffed, and a thumbnail's end comes earlier.
        return data.rfind(b"\xff\xd9") > data.rfind(b"\xff\xda")
    return True


def _png_is_complete(data: bytes) -> bool:
    """Walk the chunks (length, name, data, checksum) to the end chunk."""
    position = len(_PNG_START)
    while position + 12 <= len(data):
        length = int.from_bytes(data[position : position + 4], "big")
        name = data[position + 4 : position + 8]
        position += 12 + length
        if name == b"IEND":
            return position <= len(data)
    return False
