"""Depth as an array of numpy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from .image_headers import MAX_PIXELS

_MAX_DEPTH_M = 1e5
"""Farther is the sky, as renderers write it: unknown."""


def read_depth_array(path: Path) -> NDArray[np.float32]:
    """``(H, W)`` float32 metres of an ``.npy`` file; what is not finite, not above 0 or farther than any surface is
    unknown and becomes 0. :class:`FrontendError` where it is no such array; nothing in it is executed."""
    try:
        stored = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError, OverflowError, MemoryError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else "not a whole array of numpy"
        raise FrontendError(f"{path}: cannot be read: {reason}") from None
    if not isinstance(stored, np.ndarray) or stored.ndim != 2 or stored.dtype.kind != "f" or stored.size > MAX_PIXELS:
        found = f"{stored.shape} of {stored.dtype}" if isinstance(stored, np.ndarray) else "an archive"
        raise FrontendError(f"{path}: depth is an array (H, W) of real numbers, found {found}")
    depth = np.array(stored, dtype=np.float32)
    depth[~((depth > 0) & (depth < _MAX_DEPTH_M))] = 0.0
    return depth
