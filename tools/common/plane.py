"""The plane of a top view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def plane_of(positions: Array) -> tuple[int, int]:
    """The two axes of a top view: the one along which ``positions`` ``(N, 3)`` spread least is looked along."""
    drop = int(np.argmin(np.ptp(positions, axis=0))) if len(positions) else 1
    return ((1, 2), (0, 2), (0, 1))[drop]
