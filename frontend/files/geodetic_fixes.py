"""Positions of a satellite receiver, as logs of every form hold them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

UP = 2.0
"""Noise of an altitude over that of each horizontal axis, where only that is known."""


@dataclass(frozen=True)
class GeodeticFixes:
    """``stamps_ns`` ``(N,)`` since 1970, UTC; ``geodetic`` ``(N, 3)`` degrees and metres above the ellipsoid; ``sigma``
    ``(N, 3)`` metres east, north, up; ``lines`` ``(N,)`` of the file, or numbers of messages; ``notes``: what was left
    out or taken for granted."""

    stamps_ns: NDArray[np.int64]
    geodetic: NDArray[np.float64]
    sigma: NDArray[np.float64]
    lines: list[int]
    notes: tuple[str, ...]
