"""Image files: found in natural order, looked at before they are decoded, decoded once."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
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
_DIGITS = re.compile(r"(\d+)")
MASK_FILES = ("mask.png", "camera_mask.png")
"""Masks of all images, that may lie among them."""


def natural_key(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key by which ``frame2`` comes before ``frame10``."""
    return tuple((0, int(part), part) if part.isdigit() else (1, 0, part) for part in _DIGITS.split(name) if part)


def list_images(folder: Path) -> list[Path]:
    """Image files directly in ``folder``, in natural order; hidden files and masks of all images are left out."""
    return in_order(folder, _names(folder))


def holds_images(folder: Path) -> bool:
    """Whether :func:`list_images` finds any; looks at no more names than it takes."""
    return next(_names(folder), None) is not None


def files_of(folder: Path, suffixes: frozenset[str]) -> Iterator[str]:
    """Names of the files in ``folder`` with one of ``suffixes``, in the disk's order; hidden ones are left out. None
    where it is no folder. The disk is asked for the list, not for each file."""
    if not folder.is_dir():
        return
    with os.scandir(folder) as entries:
        for entry in entries:
            name = entry.name
            if os.path.splitext(name)[1].lower() in suffixes and not name.startswith(".") and entry.is_file():
                yield name


def in_order(folder: Path, names: Iterable[str]) -> list[Path]:
    """The files called ``names`` in ``folder``, in natural order."""
    chosen = set(names)
    # Joining a folder and a name anew takes longer than all else that is done with a file here.
    found = [path for path in folder.iterdir() if path.name in chosen] if chosen else []
    return sorted(found, key=lambda path: natural_key(path.name))


def not_there(paths: Sequence[Path]) -> list[Path]:
    """Those that are no files. Of a folder with many of them the disk is asked for the list, not for each file."""
    inside: defaultdict[Path, list[Path]] = defaultdict(list)
    for path in paths:
        inside[path.parent].append(path)
    missing: set[Path] = set()
    for folder, wanted in inside.items():
        listed = set(files_of(folder, frozenset(path.suffix.lower() for path in wanted)) if len(wanted) > 1 else ())
        missing.update(path for path in wanted if path.name not in listed and not path.is_file())
    return [path for path in paths if path in missing] if missing else []


def _names(folder: Path) -> Iterator[str]:
    return (name for name in files_of(folder, IMAGE_SUFFIXES) if name not in MASK_FILES)


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
