"""The masks of a sequence, read with its images."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..cameras.rectification import Rectifier
from ..errors import FrontendError
from .images import header_of, read_grey, read_numbers

_BRIGHT = 128
"""From here on a JPEG's pixel is white: black is a little off after compression."""


@dataclass(frozen=True, eq=False)
class FrameMasks:
    """``left``, ``right``: a file for each frame, None where the image has none; ``right`` empty where no right image
    has one. ``size`` ``(width, height)`` of the images, pixels; ``rectifier``: the images'."""

    left: tuple[Path | None, ...]
    right: tuple[Path | None, ...]
    size: tuple[int, int]
    rectifier: Rectifier | None

    def of_left(self, i: int) -> NDArray[np.bool_] | None:
        """Which pixels ``(H, W)`` of the rectified image of frame ``i`` are used; None: all.

        :class:`FrontendError` for a mask that cannot be read or has another size.
        """
        path = self.left[i]
        if path is None:
            return None
        used = self.stored(path)
        return used if self.rectifier is None else self.rectifier.rectify_left(_white(used)) == 255

    def of_right(self, i: int) -> NDArray[np.bool_] | None:
        """As :meth:`of_left`, of the right image."""
        path = self.right[i] if self.right else None
        if path is None:
            return None
        used = self.stored(path)
        return used if self.rectifier is None else self.rectifier.rectify_right(_white(used)) == 255

    def stored(self, path: Path) -> NDArray[np.bool_]:
        """Which pixels ``(H, W)`` of the stored image the mask leaves: all that are not black; of a lossy JPEG those of
        the brighter half, of a mask that is transparent somewhere those that are not transparent."""
        stored = _read(path, path.stat().st_mtime_ns if path.is_file() else 0)
        if stored.shape != self.size[::-1]:
            found = f"{stored.shape[1]}x{stored.shape[0]}"
            raise FrontendError(f"{path}: a mask of {found} pixels for images of {self.size[0]}x{self.size[1]}")
        return stored > 0


@lru_cache(maxsize=4)
def _read(path: Path, changed_ns: int) -> NDArray[Any]:
    """The mask, 0 where nothing is used; one for all images is decoded once, unless it ``changed_ns``."""
    grey = read_grey(path)
    header = header_of(path)
    if header.format == "JPEG" and grey.max(initial=0) >= _BRIGHT:
        return np.where(grey >= _BRIGHT, grey, 0)
    if header.format == "PNG" and header.channels in (2, 4):
        alpha = read_numbers(path)[..., -1]
        return alpha if (alpha == 0).any() else grey
    return grey


def _white(used: NDArray[np.bool_]) -> NDArray[np.uint8]:
    return used.astype(np.uint8) * np.uint8(255)
