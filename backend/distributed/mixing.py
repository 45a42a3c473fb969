"""Anderson acceleration of block descent: the next point is a mix of the last sweeps' results (Walker & Ni, 2011).

A sweep over all robots is a fixed-point map x -> g(x). The mix that would have made the last residuals g(x) - x
smallest is found from a few inner products, which go up the tree of members with the cost; the few weights come down
with the decision. Every robot mixes its own poses and, from the values received, its neighbours' separators: nothing
more is sent.
"""

from __future__ import annotations

import itertools

import numpy as np

from ..geometry import Array
from .places import Places, move, moved
from .solver_stage import as_sent

# Inner products travel in single precision: what they cannot tell apart is not to be mixed.
_REGULARISATION = 1e-6


class Mixer:
    """One robot's part: the last sweeps' starts and results ``(n, width)`` as moves from a common base."""

    def __init__(self, depth: int, metric: Array) -> None:
        """``depth``: sweeps mixed, besides the last; ``metric`` ``(own, width)``: roots of weights of own rows."""
        self._depth, self._metric = depth, metric
        self._base: Places | None = None
        self._started: list[Array] = []
        self._ended: list[Array] = []

    def begin(self, places: Places) -> None:
        """Note where a sweep starts."""
        if self._base is None:
            self._base = places.copy()
        self._started.append(moved(self._base, places, self._metric.shape[1]))

    def end(self, places: Places) -> tuple[float, ...]:
        """Note where it ended; returns this robot's part of the sums that the group needs."""
        assert self._base is not None
        self._ended.append(moved(self._base, places, self._metric.shape[1]))
        del self._started[: -self._depth - 1], self._ended[: -self._depth - 1]
        residuals = [self._residual(k) for k in range(len(self._ended))]
        steps = [b - a for a, b in itertools.pairwise(residuals)]
        if not steps:
            return ()
        return as_sent([float(steps[-1] @ s) for s in steps] + [float(s @ residuals[-1]) for s in steps])

    def restart(self) -> None:
        """Forget all sweeps."""
        self._base = None
        self._started.clear()
        self._ended.clear()

    def mix(self, weights: tuple[float, ...]) -> Places:
        """The mixed places; sums run in one order, so both owners of a separator get the same bits."""
        assert self._base is not None
        result = self._ended[-1].copy()
        first = len(self._ended) - 1 - len(weights)
        for k, weight in enumerate(weights, start=first):
            result -= weight * (self._ended[k + 1] - self._ended[k])
        return move(self._base, result)

    def _residual(self, k: int) -> Array:
        n = len(self._metric)
        residual = (self._ended[k][:n] - self._started[k][:n]) * self._metric
        return np.nan_to_num(residual.ravel())


class MixingRule:
    """The root's part: weights from the group's sums."""

    def __init__(self) -> None:
        self._products = np.zeros((0, 0))

    def weights(self, sums: tuple[float, ...]) -> tuple[float, ...]:
        """One weight for each step between sweeps, oldest first."""
        n = len(sums) // 2
        if not n:
            self._products = np.zeros((0, 0))
            return ()
        kept = self._products[-(n - 1) :, -(n - 1) :] if n > 1 else np.zeros((0, 0))
        matrix = np.zeros((n, n))
        matrix[: n - 1, : n - 1] = kept
        matrix[n - 1, :] = matrix[:, n - 1] = sums[:n]
        self._products = matrix
        # A step whose square vanished in single precision is rounding: its product with a residual may still be there.
        tells = np.diag(matrix) > np.finfo(np.float32).tiny
        size = np.sqrt(np.where(tells, np.diag(matrix), 1.0))
        scaled = np.where(np.outer(tells, tells), matrix, 0.0) / np.outer(size, size) + _REGULARISATION * np.eye(n)
        right = np.where(tells, sums[n:], 0.0) / size
        return as_sent(np.linalg.lstsq(scaled, right, rcond=None)[0] / size)
