"""Depth images: whole steps of a unit in 16 bits, or metres as floating-point numbers."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.text_tables import read_bytes
from .images import IMAGE_SUFFIXES, decode_file, natural_key

if TYPE_CHECKING:
    from .base import Problems

FLOAT_SUFFIXES = frozenset({".pfm", ".exr", ".npy"})
_UNKNOWN = 65535
_NUMPY_START = b"\x93NUMPY"
_EXR_START = b"\x76\x2f\x31\x01"
_MAX_PIXELS = 2**28
_TRIED = 5  # files of which one must be whole to tell their format
_MILLIMETRE = 0.001
_NEAREST_M, _FARTHEST_M = 0.05, 200.0  # between which half of the depths of a scene lie


def list_depth(folder: Path, suffixes: frozenset[str] = IMAGE_SUFFIXES | FLOAT_SUFFIXES) -> list[Path]:
    """Depth files directly in ``folder``, in natural order: images, ``.pfm``, ``.exr`` and ``.npy``."""
    if not folder.is_dir():
        return []
    found = [p for p in folder.iterdir() if p.suffix.lower() in suffixes and not p.name.startswith(".") and p.is_file()]
    return sorted(found, key=lambda p: natural_key(p.name))


def read_depth(path: Path, unit_m: float) -> NDArray[np.float32]:
    """``(H, W)`` float32 metres, 0 unknown, from numbers of ``unit_m`` metres. Of 16 bits 0 and 65535 are unknown, of
    floating-point numbers what is not finite or below 0.

    :class:`FrontendError` where the file is missing, cut off, or of another format: named with what was found.
    """
    raw = _stored(path)
    depth = raw.astype(np.float32) * np.float32(unit_m)
    if raw.dtype == np.uint16:
        depth[raw == np.uint16(_UNKNOWN)] = 0.0
    else:
        depth[~np.isfinite(depth) | (depth < 0)] = 0.0
    return depth


def unit_of_depth(
    files: Sequence[Path], stated_m: float | None, usual_m: float | None, source: Path, problems: Problems
) -> float:
    """Metres of a step of the depth ``files``: ``stated_m`` by the calibration ``source``; else metres themselves where
    they are floating-point numbers, and ``usual_m`` of the kind of data set, or millimetres with a warning, of 16 bits.

    A stated unit that is one of 16 bits is not that of metres beside it: the depths tell, and that is said.
    """
    stored = _first_stored(files)
    if stored is None:
        return stated_m or usual_m or _MILLIMETRE
    known = stored[np.isfinite(stored) & (stored > 0) & (stored != (_UNKNOWN if stored.dtype == np.uint16 else 0))]
    median = float(np.median(known)) if known.size else 0.0
    if stored.dtype != np.uint16:
        if stated_m is None or stated_m == 1.0:
            return 1.0
        if median * stated_m < _NEAREST_M <= median <= _FARTHEST_M:
            problems.warning(
                f"{source}: depth in steps of {stated_m:.4g} m, but {files[0].name} holds floating-point numbers, "
                f"half of them below {median:.3g}: metres taken"
            )
            return 1.0
        return stated_m
    if stated_m is None and usual_m is None:
        problems.warning(
            f"{source}: no depth unit (depth_unit_m, DepthMapFactor): millimetres taken; half of the depths are then "
            f"below {median * _MILLIMETRE:.3g} m, and below {median / 5000:.3g} m in TUM's 1/5000 m"
        )
    return stated_m or usual_m or _MILLIMETRE


def _first_stored(files: Sequence[Path]) -> NDArray[Any] | None:
    """The first file that can be read."""
    for path in files[:_TRIED]:
        try:
            return _stored(path)
        except FrontendError:
            continue
    return None


def _stored(path: Path) -> NDArray[Any]:
    """``(H, W)`` uint16 or floating-point numbers as stored."""
    raw = _numbers(path) if path.suffix.lower() == ".npy" else _image(path)
    if raw.ndim == 3 and raw.shape[2] == 1:
        raw = raw[:, :, 0]
    if raw.ndim == 2 and (raw.dtype == np.uint16 or raw.dtype.kind == "f"):
        return raw
    channels = 1 if raw.ndim == 2 else raw.shape[-1]
    raise FrontendError(
        f"{path}: a depth image has one channel of 16 bits, or of metres as floating-point numbers, "
        f"found {channels} of {raw.dtype.itemsize * 8}"
    )


def _image(path: Path) -> NDArray[np.generic]:
    if path.suffix.lower() == ".exr" and read_bytes(path).startswith(_EXR_START) and not _reads_exr(path):
        raise FrontendError(f"{path}: this OpenCV reads no OpenEXR; save the depth as 16-bit PNG, TIFF, PFM or NPY")
    return decode_file(path, cv2.IMREAD_UNCHANGED)


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
        if array.size > _MAX_PIXELS:
            raise FrontendError(f"{path}: {array.size} numbers are no depth image")
        return np.array(array)
    except (ValueError, OSError, EOFError, SyntaxError) as error:
        why = str(error).partition("\n")[0][:80] or "cut off"
        raise FrontendError(f"{path}: damaged: {why}") from None
