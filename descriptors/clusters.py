"""Fits to vectors without labels: centres, principal axes. numpy and scipy only: used with and without torch."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Vectors = NDArray[np.float32]


def k_means(rows: Vectors, count: int, iterations: int, rng: np.random.Generator) -> Vectors:
    """``count`` centres ``(count, d)`` of ``(n, d)`` by Lloyd's iterations; a centre that loses all its rows starts
    anew at a random one."""
    centres = rows[rng.choice(len(rows), count, replace=False)]
    for _ in range(iterations):
        nearest = (0.5 * (centres**2).sum(axis=1) - rows @ centres.T).argmin(axis=1)
        members = np.bincount(nearest, minlength=count)
        sums = np.stack([np.bincount(nearest, weights=column, minlength=count) for column in rows.T], axis=1)
        centres = (sums / np.maximum(members, 1)[:, None]).astype(np.float32)
        lost = members == 0
        centres[lost] = rows[rng.choice(len(rows), int(lost.sum()), replace=False)]
    return centres


def whitening(
    vectors: Vectors, dim: int, power: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Mean ``(D,)``, ``dim`` principal axes ``(dim, D)`` and their shares of the variance ``(dim,)`` of ``(n, D)``
    vectors, strongest first; each axis over its variance to the ``power``: 0 is plain PCA, 0.5 whitens. D at least, n
    more than ``dim``."""
    from scipy.linalg import eigh

    mean = vectors.mean(axis=0, dtype=np.float64)
    centred = vectors - mean.astype(np.float32)
    n, width = centred.shape
    # The smaller of the two Gram matrices has the same axes, seen from the other side.
    gram = (centred @ centred.T if n < width else centred.T @ centred).astype(np.float64) / n
    total, last = float(np.trace(gram)), len(gram) - 1
    variances, found = eigh(gram, subset_by_index=[last + 1 - dim, last], overwrite_a=True)
    variances, found = np.maximum(variances[::-1], 0.0), found[:, ::-1]
    axes = centred.T @ found if n < width else found
    axes = fix_signs((axes / np.maximum(np.linalg.norm(axes, axis=0), 1e-12)).T)
    scale = np.maximum(variances / variances[0], 1e-6) ** -power
    return mean, axes * scale[:, None], variances / total


def fix_signs(axes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows with their largest entry positive: an axis' sign is free, and the same data must give the same file."""
    largest = np.take_along_axis(axes, np.abs(axes).argmax(axis=1)[:, None], axis=1)
    return np.asarray(axes * np.sign(largest))
