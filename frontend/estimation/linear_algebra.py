"""Small dense systems, solved in one order of operations on every processor: compiled.

LAPACK and BLAS round differently on other kinds of processors and with other numbers of threads, and odometry feeds
its rounding errors back (see :func:`maslam.backend.geometry.product`).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

Array = NDArray[np.float64]
_SMALLEST_PIVOT = 1e-14
"""Share of its diagonal element below which a pivot counts as rounding error: the unknown then hardly moves."""


@kernel
def solve_symmetric(A: Array, B: Array) -> Array:
    """``X (n, m)`` with ``A @ X = B`` for a symmetric positive definite ``A (n, n)`` and ``B (n, m)``.

    ``A = U^T D U`` without pivoting. Only the upper triangle is read. A pivot lost to rounding is replaced by a share
    of its diagonal element, so that a singular system gives a finite answer.
    """
    n, m = B.shape
    R, X = A.copy(), B.copy()
    for k in range(n):
        R[k, k] = max(R[k, k], _SMALLEST_PIVOT * A[k, k], 1e-300)
        for i in range(k + 1, n):
            f = R[k, i] / R[k, k]
            for j in range(i, n):
                R[i, j] -= f * R[k, j]
            for c in range(m):
                X[i, c] -= f * X[k, c]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            for c in range(m):
                X[k, c] -= R[k, j] * X[j, c]
        for c in range(m):
            X[k, c] /= R[k, k]
    return X


@kernel
def times3(A: Array, B: Array) -> Array:
    """``A @ B`` of the upper left ``(3, 3)`` blocks."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]
    return out


@kernel
def times3_transposed(A: Array, B: Array) -> Array:
    """``A @ B.T`` of the upper left ``(3, 3)`` blocks."""
    out = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[j, 0] + A[i, 1] * B[j, 1] + A[i, 2] * B[j, 2]
    return out


@kernel
def weighted_gram(rows: Array, weight: Array, columns: Array) -> Array:
    """``rows.T @ diag(weight) @ columns`` ``(a, b)`` of ``(n, a)``, ``(n,)`` and ``(n, b)``."""
    out = np.zeros((rows.shape[1], columns.shape[1]))
    for i in range(len(rows)):
        for a in range(rows.shape[1]):
            f = weight[i] * rows[i, a]
            for b in range(columns.shape[1]):
                out[a, b] += f * columns[i, b]
    return out
