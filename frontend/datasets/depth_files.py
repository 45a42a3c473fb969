"""Depth images: whole steps of a unit in 16 bits, or metres as floating-point numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.text_tables import read_bytes
from .image_headers import MAX_PIXELS
from .images import IMAGE_SUFFIXES, files_of, in_order, read_numbers

FLOAT_SUFFIXES = frozenset({".pfm", ".exr", ".npy"})
UNKNOWN = 65535
"""Beside 0, of 16 bits."""
_NUMPY_START = b"\x93NUMPY"
_EXR_START = b"\x76\x2f\x31\x01"
_SKY_M = 1e5
"""Farther is the sky, as renderers write it: unknown."""


def list_depth(folder: Path, suffixes: frozenset[str] = IMAGE_SUFFIXES | FLOAT_SUFFIXES) -> list[Path]:
    """Depth files directly in ``folder``, in natural order: images, ``.pfm``, ``.exr`` and ``.npy``."""
    return in_order(folder, files_of(folder, suffixes))


def read_depth(path: Path, unit_m: float) -> NDArray[np.float32]:
    """``(H, W)`` float32 metres, 0 unknown, from numbers of ``unit_m`` metres. Of 16 bits 0 and 65535 are unknown, of
    floating-point numbers what is not finite, below 0 or farther than any surface.

    :class:`FrontendError` where the file is missing, cut off, or of another format: named with what was found.
    """
    raw = stored_depth(path)
    depth = raw.astype(np.float32) * np.float32(unit_m)
    if raw.dtype == np.uint16:
        depth[raw == np.uint16(UNKNOWN)] = 0.0
    else:
        depth[~((depth > 0) & (depth < _SKY_M))] = 0.0
    return depth


def stored_depth(path: Path) -> NDArray[Any]:
    """``(H, W)`` uint16 or floating-point numbers as stored."""
    raw = _numbers(path) if path.suffix.lower() == ".npy" else _image(path)
    if raw.ndim == 3 and raw.shape[2] == 1:
        raw = raw[:, :, 0]
    if raw.ndim == 2 and (raw.dtype == np.uint16 or raw.dtype.kind == "f"):
        return raw
    channels = 1 if raw.ndim == 2 else raw.shape[-1]
    raise FrontendError(
        f"{path}: a depth image has one channel of 16 bits, or of metres as floating-point numbers, "
        f"found {channels} of {raw.dtype.itemsize * 8} bits ({raw.dtype})"
    )


def _image(path: Path) -> NDArray[np.generic]:
    if path.suffix.lower() == ".exr" and read_bytes(path).startswith(_EXR_START) and not _reads_exr(path):
        raise FrontendError(f"{path}: this OpenCV reads no OpenEXR; save the depth as 16-bit PNG, TIFF, PFM or NPY")
    return read_numbers(path)


def _reads_exr(path: Path) -> bool:
    try:
        return bool(cv2.haveImageReader(str(path)))
    except cv2.error:
        return False


def _numbers(path: Path) -> NDArray[np.generic]:
    """An array as numpy saves it, never objects."""
    if not read_bytes(path).startswith(_NUMPY_START):
        raise FrontendError(f"{path}: not a NumPy file")
    try:
        array = np.load(path, allow_pickle=False, mmap_mode="r")
        if array.size > MAX_PIXELS:
            raise FrontendError(f"{path}: {array.size} numbers are no depth image")
        return np.array(array)
    except (ValueError, OSError, EOFError, SyntaxError, OverflowError, MemoryError) as error:
        why = error.strerror if isinstance(error, OSError) and error.strerror else "not a whole array of NumPy"
        raise FrontendError(f"{path}: cannot be read: {why}") from None
