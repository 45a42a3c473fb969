"""The root's answers to the members, and their bytes: what follows, and moves of knots as whole steps."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader, CompactWriter
from .codes import Steps, read_steps, write_steps

# Knots of which every pair is looked at: of fewer a tree costs more than it saves.
_BLOCK = 64


class Then(IntEnum):
    """What members do after the coarse level's answer: sweep; go half of the last move back; tell of their knots and
    springs again, as poses have moved; end where they are, or where the cost was least."""

    SWEEP = 0
    HALFWAY = 1
    AGAIN = 2
    END = 3
    END_AT_BEST = 4

    @property
    def ends(self) -> bool:
        """Whether no sweep follows any more."""
        return self in (Then.END, Then.END_AT_BEST)


@dataclass(frozen=True, eq=False)
class CoarseAnswer:
    """``then``; ``capped``: it ends because no more sweeps are allowed. With a sweep: ``grid``, the resolution in
    deviations, and the moves ``(k, w)`` of the knots that a robot asks for, as :func:`differences` has them."""

    then: Then
    capped: bool = False
    grid: float = 0.0
    sigmas: Array | None = None
    steps: Steps | None = None

    def encode(self) -> bytes:
        """Bytes."""
        out = CompactWriter()
        out.count(self.then + (8 if self.capped else 0) + (16 if self.sigmas is not None else 0))
        if self.then is not Then.SWEEP:
            return out.bytes()
        assert self.steps is not None
        out.rough(self.grid)
        if self.sigmas is not None:
            out.array(self.sigmas, "<f4")
        return out.bytes() + write_steps(self.steps, by_column=True)

    @classmethod
    def decode(cls, data: bytes, knots: int, width: int) -> CoarseAnswer:
        """Inverse of :meth:`encode`, for so many ``knots``."""
        source = CompactReader(data)
        head = source.count()
        if head & 7 > Then.END_AT_BEST or head >= 32:
            raise BackendError("an answer of the coarse level that is none")
        then, capped = Then(head & 7), bool(head & 8)
        if then is not Then.SWEEP:
            return cls(then, capped)
        grid = source.rough()
        if not (np.isfinite(grid) and grid > 0):
            raise BackendError("a resolution of the coarse level that is not positive")
        sigmas = source.array(3, "<f4") if head & 16 else None
        return cls(then, capped, grid, sigmas, read_steps(source.rest(), knots, width, by_column=True))


def differences(steps: Steps, centres: Array, lever: float) -> Steps:
    """Of knots' moves in whole steps ``(k, w)`` from what the nearest knot before would do to a body at their
    ``centres``: knots at one place move alike.

    ``lever``: steps of a shift that a step of a turn makes at arm's length 1. Sums run number by number, so that the
    same numbers come out everywhere.
    """
    out = steps.copy()
    near = nearest_before(centres)
    if len(steps) > 1:
        out[1:] -= _carried_on(steps[near], centres[1:] - centres[near], lever)
    return out


def summed(found: Steps, centres: Array, lever: float) -> Steps:
    """Inverse of :func:`differences`."""
    out = found.copy()
    for k, near in enumerate(nearest_before(centres).tolist(), start=1):
        out[k] += _carried_on(out[near : near + 1], (centres[k] - centres[near])[None], lever)[0]
    return out


def nearest_before(centres: Array) -> NDArray[np.intp]:
    """For each knot but the first the nearest one before it.

    Within blocks every pair is looked at; then the later half of 2, 4, ... blocks looks into a tree of the earlier
    half, so that each pair counts once and all takes about n log n.
    """
    n = len(centres)
    best, out = np.full(n, np.inf), np.zeros(n, dtype=np.intp)
    for start in range(0, n, _BLOCK):
        block = centres[start : start + _BLOCK]
        apart = ((block[:, None] - block[None]) ** 2).sum(axis=2)
        apart[np.triu_indices(len(block))] = np.inf
        rows = slice(start, start + len(block))
        out[rows], best[rows] = start + np.argmin(apart, axis=1), apart.min(axis=1)
    size = _BLOCK
    while size < n:
        for start in range(0, n - size, 2 * size):
            later = np.arange(start + size, min(start + 2 * size, n))
            _, found = cKDTree(centres[start : start + size]).query(centres[later])
            apart = ((centres[later] - centres[start + found]) ** 2).sum(axis=1)
            nearer = apart < best[later]
            out[later[nearer]], best[later[nearer]] = start + found[nearer], apart[nearer]
        size *= 2
    return out[1:]


def _carried_on(steps: Steps, arm: Array, lever: float) -> Steps:
    out = steps.copy()
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        out[:, a] += np.rint(lever * (steps[:, 3 + b] * arm[:, c] - steps[:, 3 + c] * arm[:, b])).astype(np.int64)
    return out


def sums_as_bytes(values: tuple[float, ...]) -> bytes:
    """Sums over edges, or the weights of a mix, in single precision."""
    out = CompactWriter()
    out.array(np.array(values), "<f4")
    return out.bytes()


def sums_from(body: bytes) -> tuple[float, ...]:
    """Inverse of :func:`sums_as_bytes`."""
    return tuple(CompactReader(body).array(len(body) // 4, "<f4").tolist())
