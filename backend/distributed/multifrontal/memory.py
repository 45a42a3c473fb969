"""Where the last passes led, at one robot and at the anchor: steps with one and the same matrix, made conjugate.

F is nearly quadratic between the last places. What it says about mixes of them takes a few inner products of moves and
gradients, which come up with the cost; the weights of the best mix come down with the step, and everybody's right-hand
sides are mixed alike, as they depend linearly on places. So old matrices go a long way (Anderson acceleration, in F's
own metric).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import Array
from ..places import Places, moved
from ..solver_stage import as_sent

# What sums cannot tell apart is not to be mixed.
_REGULARISATION = 1e-4


@dataclass(frozen=True, eq=False)
class _Noted:
    places: Places
    own: Array
    b: Array


class Memory:
    """One robot's part: places, the right-hand sides ``(n, w)`` of its own edges, and those ``(n, w)`` that it solves
    for, of passes with one matrix."""

    def __init__(self, depth: int) -> None:
        self._depth = depth
        self._noted: list[_Noted] = []

    def restart(self) -> None:
        """Forget all."""
        self._noted.clear()

    def note(self, places: Places, own: Array, b: Array) -> tuple[float, ...]:
        """Add the present pass; returns this robot's part of the sums: moves to the earlier ones times the present
        right-hand side, then times the changes of it."""
        self._noted.append(_Noted(places.copy(), own, b))
        del self._noted[: -self._depth - 1]
        if len(self._noted) < 2:
            return ()
        moves = np.array([m.ravel() for m in self._moves(own.shape[1])])
        changes = np.array([(n.own - own).ravel() for n in self._noted[:-1]])
        return (*(moves @ own.ravel()).tolist(), *(moves @ changes.T).ravel().tolist())

    def mixed(self, weights: tuple[float, ...]) -> tuple[Array, Array]:
        """The move ``(n, w)`` from the present places to the mix, and the right-hand sides there."""
        last = self._noted[-1]
        move, b = np.zeros_like(last.own), last.b.copy()
        chosen = self._noted[-1 - len(weights) : -1]
        moves = self._moves(last.own.shape[1])[len(self._noted) - 1 - len(weights) :]
        for weight, noted, there in zip(weights, chosen, moves, strict=True):
            move += weight * there
            b += weight * (noted.b - last.b)
        return move, b

    def _moves(self, width: int) -> list[Array]:
        last = self._noted[-1].places
        return [np.nan_to_num(moved(last, n.places, width)) for n in self._noted[:-1]]


def best_weights(sums: tuple[float, ...]) -> tuple[tuple[float, ...], float]:
    """The weights of earlier passes in the best mix, and by how much it lowers the cost."""
    n = round((np.sqrt(1.0 + 4.0 * len(sums)) - 1.0) / 2.0)
    if not n:
        return (), 0.0
    slope, curvature = np.array(sums[:n]), -np.array(sums[n:]).reshape(n, n)
    curvature = 0.5 * (curvature + curvature.T)
    size = np.sqrt(np.maximum(np.diag(curvature), np.finfo(np.float32).tiny))
    scaled = curvature / np.outer(size, size)
    values, vectors = np.linalg.eigh(scaled)
    kept = values > _REGULARISATION * max(values[-1], 0.0)
    right = vectors.T @ (slope / size)
    weights = as_sent((vectors[:, kept] @ (right[kept] / values[kept]) / size).tolist())
    found = np.array(weights)
    gain = float(2.0 * slope @ found - found @ curvature @ found)
    return (weights, gain) if np.isfinite(found).all() and gain > 0.0 else ((), 0.0)
