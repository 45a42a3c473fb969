"""Tentative matches between two sets of binary descriptors or vocabulary words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

Distances = NDArray[np.int16]
# Farther than any two 256-bit descriptors.
FAR = np.int16(257)


def hamming_distances(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> Distances:
    """All distances ``(n, m)`` in bits between descriptors ``(n, w)`` and ``(m, w)``; ``w`` a multiple of 8 bytes."""
    # Writeable copies of what messages hold: one kind of array, so that the kernel is compiled once.
    words_a, words_b = (np.require(x, requirements=("C", "W")).view(np.uint64) for x in (a, b))
    return np.asarray(_hamming(words_a, words_b))


def mutual_matches(distances: Distances, at_most: int, ratio: float = 1.0) -> NDArray[np.intp]:
    """Pairs ``(k, 2)`` of row and column that are each other's nearest, at most ``at_most`` apart, sorted by row.

    ``ratio`` below 1: the distance must be less than ``ratio`` times the row's and the column's second smallest.
    """
    if not distances.size:
        return np.zeros((0, 2), dtype=np.intp)
    column, best, second, row, second_of_column = _nearest(distances)
    rows = np.arange(len(distances))
    good = (row[column] == rows) & (best <= at_most)
    if ratio < 1.0:
        good &= (best < ratio * second) & (best < ratio * second_of_column[column])
    return np.stack([rows[good], column[good]], axis=1)


@dataclass(frozen=True, eq=False)
class PointCandidates:
    """Entries of a matrix of distances that are small enough, in the order of rows: ``rows``, ``columns`` and
    ``distances`` ``(k,)``; ``shape`` of the matrix."""

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    distances: Distances
    shape: tuple[int, int]

    @classmethod
    def within(cls, distances: Distances, at_most: int) -> PointCandidates:
        """The entries of ``distances`` ``(n, m)`` up to ``at_most``."""
        rows, columns = _within(distances, at_most)
        return cls(rows, columns, distances[rows, columns], (distances.shape[0], distances.shape[1]))


def mutual_candidates(candidates: PointCandidates, allowed: NDArray[np.bool_]) -> NDArray[np.intp]:
    """:func:`mutual_matches` of the ``allowed`` ``(k,)`` entries alone."""
    c = candidates
    return np.asarray(_mutual(c.rows[allowed], c.columns[allowed], c.distances[allowed], *c.shape))


def unique_word_matches(words_a: NDArray[np.int32], words_b: NDArray[np.int32]) -> NDArray[np.intp]:
    """Pairs ``(k, 2)`` of rows whose word occurs exactly once on either side, sorted by the first."""
    lonely_a, lonely_b = _unique_rows(words_a), _unique_rows(words_b)
    _, in_a, in_b = np.intersect1d(words_a[lonely_a], words_b[lonely_b], assume_unique=True, return_indices=True)
    pairs = np.stack([lonely_a[in_a], lonely_b[in_b]], axis=1)
    return pairs[np.argsort(pairs[:, 0])]


def _unique_rows(words: NDArray[np.int32]) -> NDArray[np.intp]:
    _, first, count = np.unique(words, return_index=True, return_counts=True)
    return first[count == 1]


@kernel
def _hamming(a, b):  # type: ignore[no-untyped-def]
    # The sums of bits in pairs, nibbles, bytes; compilers know this as one instruction.
    m1, m2, m4 = np.uint64(0x5555555555555555), np.uint64(0x3333333333333333), np.uint64(0x0F0F0F0F0F0F0F0F)
    ones, one, two, four, last = np.uint64(0x0101010101010101), np.uint64(1), np.uint64(2), np.uint64(4), np.uint64(56)
    out = np.empty((len(a), len(b)), dtype=np.int16)
    for i in range(len(a)):
        for j in range(len(b)):
            total = np.uint64(0)
            for k in range(a.shape[1]):
                x = a[i, k] ^ b[j, k]
                x = x - ((x >> one) & m1)
                x = (x & m2) + ((x >> two) & m2)
                x = (x + (x >> four)) & m4
                total += (x * ones) >> last
            out[i, j] = np.int16(total)
    return out


@kernel
def _nearest(distances):  # type: ignore[no-untyped-def]
    """Of each row: its nearest column (the first of several), smallest and second smallest distance; of each column:
    its nearest row and second smallest distance. :data:`FAR` where there is no second."""
    n, m = distances.shape
    column, row = np.zeros(n, dtype=np.intp), np.zeros(m, dtype=np.intp)
    best, second = np.full(n, FAR), np.full(n, FAR)
    best_of_column, second_of_column = np.full(m, FAR), np.full(m, FAR)
    for i in range(n):
        for j in range(m):
            d = distances[i, j]
            if d < best[i]:
                second[i], best[i], column[i] = best[i], d, j
            elif d < second[i]:
                second[i] = d
            if d < best_of_column[j]:
                second_of_column[j], best_of_column[j], row[j] = best_of_column[j], d, i
            elif d < second_of_column[j]:
                second_of_column[j] = d
    return column, best, second, row, second_of_column


@kernel
def _within(distances, at_most):  # type: ignore[no-untyped-def]
    n, m = distances.shape
    count = 0
    for i in range(n):
        for j in range(m):
            count += distances[i, j] <= at_most
    rows, columns = np.empty(count, dtype=np.intp), np.empty(count, dtype=np.intp)
    k = 0
    for i in range(n):
        for j in range(m):
            if distances[i, j] <= at_most:
                rows[k], columns[k] = i, j
                k += 1
    return rows, columns


@kernel
def _mutual(rows, columns, distances, n, m):  # type: ignore[no-untyped-def]
    best, best_of_column = np.full(n, -1), np.full(m, -1)
    for k in range(len(rows)):
        i, j = rows[k], columns[k]
        if best[i] < 0 or distances[k] < distances[best[i]]:
            best[i] = k
        if best_of_column[j] < 0 or distances[k] < distances[best_of_column[j]]:
            best_of_column[j] = k
    out = np.empty((n, 2), dtype=np.intp)
    count = 0
    for i in range(n):
        if best[i] >= 0 and best_of_column[columns[best[i]]] == best[i]:
            out[count, 0], out[count, 1] = i, columns[best[i]]
            count += 1
    return out[:count]
