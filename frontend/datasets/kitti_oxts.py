"""Poses of KITTI's GPS and IMU (OxTS): latitude, longitude and height on a local Mercator plane."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3, so3_exp

from ..files import text_tables

_EARTH_M = 6_378_137.0
_COLUMNS = 30
_LAT, _LON, _ALT, _ROLL, _PITCH, _YAW = range(6)


def poses_of_imu(files: Sequence[Path]) -> NDArray[np.float64]:
    """``T_W_imu`` ``(N, 4, 4)`` of one file a frame; x of the world east, y north, z up, scaled for the first file's
    latitude. :class:`~maslam.frontend.errors.FrontendError` where a file is missing or broken."""
    rows = np.array([text_tables.read_table(path, _COLUMNS, "a line of OxTS")[0] for path in files])
    scale = np.cos(np.radians(rows[0, _LAT]))
    east = scale * _EARTH_M * np.radians(rows[:, _LON])
    north = scale * _EARTH_M * np.log(np.tan(np.radians(90.0 + rows[:, _LAT]) / 2.0))
    position = np.stack([east, north, rows[:, _ALT]], axis=1)
    turns = [product(product(_turn(2, row[_YAW]), _turn(1, row[_PITCH])), _turn(0, row[_ROLL])) for row in rows]
    return np.asarray(se3(np.stack(turns), position - position[0]))


def _turn(axis: int, angle: float) -> NDArray[np.float64]:
    """Rotation ``(3, 3)`` by ``angle`` radians about a coordinate axis."""
    return np.asarray(so3_exp(np.eye(3)[axis] * angle))
