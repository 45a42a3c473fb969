"""Where nodes are: their poses and, where units of length are variables, their units; and moves from one to another."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry import Array, se3, so3_exp, so3_log
from .compact import numbers_of, poses_of

RIGID, SCALED = 6, 7
"""Numbers of a place: position, rotation vector; and the logarithm of the unit."""


@dataclass(frozen=True, eq=False)
class Places:
    """``poses`` ``T_O_i`` ``(n, 4, 4)``, NaN where unknown; ``log_units`` ``(n,)``, 0 for metric robots."""

    poses: Array
    log_units: Array

    def copy(self) -> Places:
        """The same, in memory of its own."""
        return Places(self.poses.copy(), self.log_units.copy())

    def at(self, rows: Any) -> Places:
        """A copy of some ``rows``."""
        return Places(self.poses[rows].copy(), self.log_units[rows].copy())

    def put(self, rows: Any, places: Places) -> None:
        """Set some ``rows``."""
        self.poses[rows] = places.poses
        self.log_units[rows] = places.log_units

    def and_also(self, other: Places) -> Places:
        """These, then the other's."""
        poses = np.concatenate([self.poses, other.poses])
        return Places(poses, np.append(self.log_units, other.log_units))

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask ``(n,)`` of those that have a pose."""
        return np.asarray(np.isfinite(self.poses).all(axis=(1, 2)))

    def numbers(self, width: int) -> Array:
        """Position, rotation vector and, with a ``width`` of 7, log unit: ``(n, width)``."""
        return np.concatenate([numbers_of(self.poses), self.log_units[:, None]], axis=1)[:, :width]


def places_of(numbers: ArrayLike) -> Places:
    """Inverse of :meth:`Places.numbers`."""
    v = np.asarray(numbers, dtype=np.float64)
    return Places(poses_of(v[:, :RIGID]), v[:, 6].copy() if v.shape[1] == SCALED else np.zeros(len(v)))


def moved(start: Places, end: Places, width: int) -> Array:
    """Shift, turn (from the right) and change of the log unit ``(n, width)`` from one to the other."""
    turn = so3_log(np.swapaxes(start.poses[:, :3, :3], 1, 2) @ end.poses[:, :3, :3])
    parts = [end.poses[:, :3, 3] - start.poses[:, :3, 3], turn, (end.log_units - start.log_units)[:, None]]
    return np.concatenate(parts[: width - 4], axis=1)


def move(start: Places, delta: Array) -> Places:
    """Inverse of :func:`moved`; of six numbers the units stay."""
    R, t = start.poses[:, :3, :3], start.poses[:, :3, 3]
    log_units = start.log_units + delta[:, 6] if delta.shape[1] == SCALED else start.log_units.copy()
    return Places(se3(R @ so3_exp(delta[:, 3:6]), t + delta[:, :3]), log_units)
