"""The schedule of graduated non-convexity with truncated least squares (Yang et al., RA-L 2020, section IV).

``mu`` begins near 0, where the problem is convex, and grows to infinity, where it is truncated least squares: residuals
up to the threshold cost their square, others a constant. Shared by the central and the distributed solver.
"""

from __future__ import annotations

import numpy as np

from backend.geometry import Array

# Growth of mu in each step, as published.
_GROWTH = 1.4


def initial_mu(max_squared_residual: float, threshold_squared: float) -> float:
    """The largest mu at which all residuals still are in the convex part; infinite where nothing is to be decided."""
    excess = 2.0 * max_squared_residual - threshold_squared
    return threshold_squared / excess if excess > 0.0 else float("inf")


def next_mu(mu: float) -> float:
    """One step less convex."""
    return _GROWTH * mu


def tls_weights(squared_residuals: Array, threshold_squared: float, mu: float) -> Array:
    """Weights in [0, 1] of the edges ``(m,)``: 1 well below the threshold, 0 well above, in between continuous."""
    squared = np.asarray(squared_residuals, dtype=np.float64)
    if np.isinf(mu):
        return (squared <= threshold_squared).astype(np.float64)
    ratio = threshold_squared / np.maximum(squared, 1e-300)
    return np.clip(np.sqrt(ratio * mu * (mu + 1.0)) - mu, 0.0, 1.0)
