"""Exact nearest neighbours among place vectors that keep coming, one at a time."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .errors import DescriptorError

Vectors = NDArray[np.float32]

_BLOCK = 4096
_SLACK = 1e-5
"""Above what float32 sums of unit vectors can be off by."""


@dataclass(eq=False)
class _Block:
    """Room for some thousand vectors: exact, and as int8 with what rounding may have changed.

    A vector ``x`` is ``scale * rounded`` up to ``error`` (a length); ``length`` and ``square`` are its own.
    """

    exact: Vectors
    rounded: NDArray[np.int8]
    scale: NDArray[np.float64]
    error: NDArray[np.float64]
    length: NDArray[np.float64]
    square: NDArray[np.float64]
    count: int = 0

    @classmethod
    def empty(cls, dim: int) -> _Block:
        # Pages of memory that nothing has been written to cost nothing yet.
        figures = np.empty((4, _BLOCK))
        return cls(np.empty((_BLOCK, dim), dtype=np.float32), np.empty((_BLOCK, dim), dtype=np.int8), *figures)

    def append(self, vector: Vectors) -> None:
        row, self.count = self.count, self.count + 1
        self.exact[row] = vector
        self.rounded[row], self.scale[row], self.error[row], self.length[row] = _rounded(vector)
        self.square[row] = self.length[row] ** 2


@dataclass(eq=False)
class NearestIndex:
    """Vectors under ascending keys. :meth:`nearest` gives what comparing with each vector would give, to the bit, and
    looks at few of them closely.

    Every vector is also held as int8, a quarter of the memory to go through. Integer products bound each distance from
    both sides (Cauchy-Schwarz on what rounding lost); only vectors whose lower bound is not above the least upper
    bound are compared exactly.
    """

    keys: list[int] = field(default_factory=list)
    _blocks: list[_Block] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.keys)

    def add(self, key: int, vector: Vectors) -> None:
        """Append a vector ``(d,)`` float32 of about unit length; ``key`` larger than all before."""
        row = np.asarray(vector, dtype=np.float32)
        if row.ndim != 1 or not row.size or (self._blocks and len(row) != self._blocks[0].exact.shape[1]):
            raise DescriptorError(f"a vector of shape {row.shape} does not belong into this index")
        if not np.isfinite(row).all() or (self.keys and key <= self.keys[-1]):
            raise DescriptorError(f"vector {key} is not finite, or comes after {self.keys[-1] if self.keys else '-'}")
        if not self._blocks or self._blocks[-1].count == _BLOCK:
            self._blocks.append(_Block.empty(len(row)))
        self._blocks[-1].append(row)
        self.keys.append(key)

    def nearest(self, vector: Vectors, below: int | None = None) -> tuple[int, float] | None:
        """Key and Euclidean distance of the nearest vector (among those with a key under ``below``); the older one of
        equals; None where there is none."""
        count = len(self.keys) if below is None else int(np.searchsorted(self.keys, below))
        if not count:
            return None
        query = np.asarray(vector, dtype=np.float32)
        if query.shape != self._blocks[0].exact.shape[1:]:
            raise DescriptorError(f"a query of shape {query.shape} for vectors {self._blocks[0].exact.shape[1:]}")
        best, least = -1, np.inf
        for block, rows in self._within_reach(query, count):
            apart = np.linalg.norm(self._blocks[block].exact[rows] - query, axis=1)
            at = int(np.argmin(apart))
            if float(apart[at]) < least:
                best, least = block * _BLOCK + int(rows[at]), float(apart[at])
        return self.keys[best], least

    def _within_reach(self, query: Vectors, count: int) -> list[tuple[int, NDArray[np.int64]]]:
        """Rows of each block that may hold the nearest of the first ``count`` vectors."""
        rounded, scale, error, length = _rounded(query)
        lowest = np.empty(count)
        least = np.inf
        used = -(-count // _BLOCK)
        for number, block in enumerate(self._blocks[:used]):
            out = lowest[number * _BLOCK : (number + 1) * _BLOCK]
            least = _bounds(
                block.rounded,
                block.scale,
                block.error,
                block.length,
                block.square,
                rounded,
                scale,
                error,
                length,
                least,
                out,
            )
        found = np.flatnonzero(lowest <= least + _SLACK)
        edges = np.searchsorted(found, np.arange(used + 1) * _BLOCK)
        parts = [(b, found[edges[b] : edges[b + 1]] - b * _BLOCK) for b in range(used)]
        return [(block, rows) for block, rows in parts if len(rows)]


def _rounded(vector: Vectors) -> tuple[NDArray[np.int8], float, float, float]:
    """A vector as int8 times a scale, the length of what that leaves out, and the vector's own."""
    wide = vector.astype(np.float64)
    scale = max(float(np.abs(wide).max()) / 127.0, 1e-30)
    rounded = np.rint(wide / scale)
    return rounded.astype(np.int8), scale, float(np.linalg.norm(wide - scale * rounded)), float(np.linalg.norm(wide))


@kernel
def _bounds(rounded, scale, error, length, square, query, q_scale, q_error, q_length, least, out):  # type: ignore[no-untyped-def]
    """Lower bounds of squared distances, less the query's own squared length; returns the least upper bound so far.

    ``q.x = (s q' + f).(t x' + e)`` is the integer product give or take ``|f| (|x| + |e|) + |q| |e|``.
    """
    # Products go through an array of int32: only then are they added up 16 at a time.
    products = np.empty(len(out), dtype=np.int32)
    for row in range(len(out)):
        total = np.int32(0)
        for k in range(rounded.shape[1]):
            total += np.int32(rounded[row, k]) * np.int32(query[k])
        products[row] = total
    for row in range(len(out)):
        unsure = q_error * (length[row] + error[row]) + q_length * error[row]
        likely = q_scale * scale[row] * products[row]
        out[row] = square[row] - 2.0 * (likely + unsure)
        least = min(least, square[row] - 2.0 * (likely - unsure))
    return least
