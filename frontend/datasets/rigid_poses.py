"""Poses as data sets write them, checked to be rigid transforms."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import project_to_so3, se3

from ..errors import FrontendError
from ..files import text_tables

_TOLERANCE = 0.05  # of the determinant: rounded digits are fine, columns mixed up are not


def poses_of_rows(path: Path, rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """``(N, 4, 4)`` of rows of 16 or 12 numbers, row-major, of the file ``path``; rotations become exact.
    :class:`FrontendError` with the line for a row that is no rigid transform."""
    matrices = rows[:, :12].reshape(-1, 3, 4)
    for row in np.flatnonzero(np.abs(np.linalg.det(matrices[:, :, :3]) - 1.0) > _TOLERANCE)[:1]:
        raise FrontendError(f"{path}:{text_tables.row_line(path, int(row))}: not a rigid transform")
    return np.asarray(se3(project_to_so3(matrices[:, :, :3]), matrices[:, :, 3])).reshape(-1, 4, 4)
