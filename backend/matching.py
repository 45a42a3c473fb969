"""Tentative matches between two sets of binary descriptors or vocabulary words."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Distances = NDArray[np.int16]
# Farther than any two 256-bit descriptors.
FAR = np.int16(257)


def hamming_distances(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> Distances:
    """All distances ``(n, m)`` in bits between descriptors ``(n, 32)`` and ``(m, 32)``.

    With bits as plus and minus one a distance is an inner product; float32 holds these small integers exactly.
    """
    signs_a = np.unpackbits(a, axis=1).astype(np.float32) * 2.0 - 1.0
    signs_b = np.unpackbits(b, axis=1).astype(np.float32) * 2.0 - 1.0
    return ((signs_a.shape[1] - signs_a @ signs_b.T) / 2.0).astype(np.int16)


def mutual_matches(distances: Distances, at_most: int, ratio: float = 1.0) -> NDArray[np.intp]:
    """Pairs ``(k, 2)`` of row and column that are each other's nearest, at most ``at_most`` apart, sorted by row.

    ``ratio`` below 1: the distance must be less than ``ratio`` times the row's and the column's second smallest.
    """
    n, m = distances.shape
    if not n or not m:
        return np.zeros((0, 2), dtype=np.intp)
    column = distances.argmin(axis=1)
    row = distances.argmin(axis=0)
    rows = np.arange(n)
    best = distances[rows, column]
    good = (row[column] == rows) & (best <= at_most)
    if ratio < 1.0:
        good &= (best < ratio * _second(distances)) & (best < ratio * _second(distances.T)[column])
    return np.stack([rows[good], column[good]], axis=1)


def _second(distances: Distances) -> Distances:
    """Second smallest of each row; :data:`FAR` where there is only one."""
    if distances.shape[1] < 2:
        return np.full(len(distances), FAR)
    return np.partition(distances, 1, axis=1)[:, 1]


def unique_word_matches(words_a: NDArray[np.int32], words_b: NDArray[np.int32]) -> NDArray[np.intp]:
    """Pairs ``(k, 2)`` of rows whose word occurs exactly once on either side, sorted by the first."""
    lonely_a, lonely_b = _unique_rows(words_a), _unique_rows(words_b)
    _, in_a, in_b = np.intersect1d(words_a[lonely_a], words_b[lonely_b], assume_unique=True, return_indices=True)
    pairs = np.stack([lonely_a[in_a], lonely_b[in_b]], axis=1)
    return pairs[np.argsort(pairs[:, 0])]


def _unique_rows(words: NDArray[np.int32]) -> NDArray[np.intp]:
    _, first, count = np.unique(words, return_index=True, return_counts=True)
    return first[count == 1]
