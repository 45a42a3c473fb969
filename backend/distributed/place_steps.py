"""Places of nodes as whole steps from what is predicted, each step a share of the deviation of the edges around.

Six numbers a pose, and one more where the unit of length is a variable.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..geometry import Array
from .compact import from_steps, step_sizes, to_steps

# Weights of a good measurement: 2.5 thousandths of a radian, half a centimetre, half a percent of unit.
_GOOD = np.array([0.5 * 0.0025**-2.0, 0.005**-2.0, 0.005**-2.0])

Place = tuple[Array, Any]
"""Pose ``(4, 4)`` and logarithm of the unit of a node, or arrays of both."""


def sizes_of(weights: ArrayLike, fineness: float) -> Array:
    """Steps ``(n, 7)`` of edges with these weights ``(n, 3)``."""
    kappa, tau, precision = np.asarray(weights, dtype=np.float64).reshape(-1, 3).T
    return np.concatenate([step_sizes(kappa, tau, fineness), _unit_steps(precision, fineness)], axis=1)


def measured_sizes(weights: ArrayLike, fineness: float) -> Array:
    """Steps ``(n, 7)`` of measurements with these weights ``(n, 3)``: never coarser than of good ones. What is stated
    may be no knowledge of the noise (the identity), and who closes no loop cannot know better.
    """
    return sizes_of(np.maximum(np.asarray(weights, dtype=np.float64).reshape(-1, 3), _GOOD), fineness)


def _unit_steps(precision: Array, fineness: float) -> Array:
    """Steps ``(n, 1)`` of log units."""
    return np.asarray(1.0 / (np.sqrt(precision) * fineness))[:, None]


def place_to_steps(T: Array, log_unit: ArrayLike, predicted: Place, sizes: Array) -> Array:
    """Whole steps ``(..., 7)`` from what is predicted."""
    unit = np.rint((np.asarray(log_unit, dtype=np.float64) - predicted[1]) / sizes[..., 6])
    return np.concatenate([to_steps(T, predicted[0], sizes[..., :6]), unit[..., None]], axis=-1)


def place_from_steps(steps: Array, predicted: Place, sizes: Array) -> tuple[Array, Any]:
    """Inverse of :func:`place_to_steps`, up to half a step; of six numbers the unit is the predicted one."""
    T = from_steps(steps[..., :6], predicted[0], sizes[..., :6])
    moved = steps[..., 6] * sizes[..., 6] if steps.shape[-1] > 6 else np.zeros(steps.shape[:-1])
    return T, predicted[1] + moved
