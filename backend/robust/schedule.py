"""The schedule of graduated non-convexity with truncated least squares (Yang et al., RA-L 2020), for every solver.

The truncated cost ``min(r^2, bound)`` of an edge is approached through surrogates: ``mu`` near 0 is convex, growing
``mu`` is ever closer to the truncation. Between solves each edge gets the weight that its residual deserves.
Residuals ``squared`` are Mahalanobis distances, in standard deviations squared, as ``bound`` is.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ..geometry import Array
from . import chi_square

# How fast the surrogate sharpens, as published.
GROWTH = 1.4


def truncation(confidence: float, degrees_of_freedom: int = 6) -> float:
    """``bound``: the squared residual that a right edge stays below with probability ``confidence``."""
    return chi_square.below(confidence, degrees_of_freedom)


def first_mu(largest_squared: float, bound: float) -> float | None:
    """The first ``mu``, given the largest squared residual; None: all are so small that no edge can be rejected."""
    excess = 2.0 * largest_squared - bound
    return None if excess <= 0.0 else bound / excess


def next_mu(mu: float) -> float:
    """The ``mu`` of the next, sharper surrogate."""
    return GROWTH * mu


def tls_weight(squared: ArrayLike, bound: float, mu: float) -> Array:
    """Weights in [0, 1], of the shape of ``squared``: 1 well inside the bound, 0 well outside, falling between."""
    r = np.sqrt(np.asarray(squared, dtype=np.float64))
    between = np.sqrt(bound * mu * (mu + 1.0)) / np.maximum(r, 1e-300) - mu
    return np.asarray(np.clip(between, 0.0, 1.0))


def settled(weights: ArrayLike, tolerance: float = 1e-3) -> bool:
    """Whether every edge has been decided: its weight is 0 or 1."""
    w = np.asarray(weights, dtype=np.float64)
    return bool((np.minimum(w, 1.0 - w) <= tolerance).all())
