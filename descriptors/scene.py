"""Correction of coded place vectors by a receiver's own images of the same surroundings.

A coarse code is made for every place in the world. One robot's places have much in common: their vectors lie close
about their mean and vary along few directions, and what a code loses there is alike for all of them. A receiver knows
its own vectors exactly, and by coding them itself it learns what the code does to them. So of a vector that it is sent
it keeps what varies here, takes off what the code adds to all, and puts the rest back to what is usual here: the
posterior mean of a Gaussian (the Wiener filter). Nothing of this travels, and the code stays what it was.

This is for *coded references*: which of many coded vectors is nearest to an exact one? Each has an error of its own,
and the filter takes most of it off. Where a coded vector is held against exact ones all share its one error, and
the plain distance is the best there is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .codes import Coder

Vectors = NDArray[np.float32]

_TRUST = 0.9
_HALF_TRUST = 32
"""Of ``n`` own vectors the covariance counts ``0.9 n / (n + 32)``, one that is the same in all directions the rest:
between .3 and .95 held-out worlds and drives show no difference larger than chance."""
_HALF_APPLIED = 8
"""With ``n`` own vectors ``n / (n + 8)`` of the correction is made: from two on it helps, on average."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A receiver's surroundings: ``mean`` ``(d,)`` of its own vectors, ``bias`` ``(d,)`` that the code adds to them,
    ``gain`` ``(d, d)`` for what deviates from both, ``applied``: share of the correction that is made."""

    mean: NDArray[np.float64]
    bias: NDArray[np.float64]
    gain: NDArray[np.float64]
    applied: float

    @classmethod
    def of(cls, coder: Coder, own: Vectors) -> Scene:
        """From the receiver's own exact vectors ``(N, dim)``; fewer than two tell nothing."""
        exact = coder.cut(own).astype(np.float64)
        count, dim = exact.shape
        if count < 2:
            return cls(np.zeros(dim), np.zeros(dim), np.eye(dim), 0.0)
        lost = coder.decode(coder.encode(own)) - exact
        mean, bias = exact.mean(axis=0), lost.mean(axis=0)
        scatter = float(((lost - bias) ** 2).sum()) / (count - 1)
        # The mean of few errors is long by chance (James and Stein, positive part).
        bias *= max(0.0, 1.0 - scatter / count / max(float(bias @ bias), 1e-12))
        varied = exact - mean
        trust = _TRUST * count / (count + _HALF_TRUST)
        usual = max(1.0 - float(mean @ mean), 1e-6) / dim  # of unit vectors about this mean
        covariance = trust * (varied.T @ varied) / count + (1.0 - trust) * usual * np.eye(dim)
        gain = np.linalg.solve(covariance + scatter / dim * np.eye(dim), covariance)
        return cls(mean, bias, gain, count / (count + _HALF_APPLIED))

    def sharpened(self, decoded: Vectors) -> Vectors:
        """Decoded vectors ``(N, d)`` as they probably were, ``(N, d)``; shorter than one where the code left doubt."""
        probable = self.mean + (decoded - self.bias - self.mean) @ self.gain
        return np.asarray(decoded + self.applied * (probable - decoded), dtype=np.float32)
