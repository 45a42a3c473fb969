"""Elimination of a robot's poses from a quadratic problem: what it says about the poses that stay, and the way back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from ...errors import BackendError
from ...geometry import Array

# Columns of the boundary that are eliminated at a time: bounds the memory.
_COLUMNS = 240
# Dense matrices of at most this size are factorised where that is less work; what an operation on a sparse factor
# costs, in operations on dense ones.
_DENSE, _SPARSE = 4000, 10.0


class Elimination:
    """Minimum over the ``eliminated`` rows of ``x^T H x - 2 b^T x`` as a function of those of the ``boundary``.

    ``blocks``: pairs of rows ``(m, k)`` of nodes and matrices ``(m, k w, k w)`` on these, which add up to H. Rows are
    nodes of ``width`` unknowns; those in neither set are left out, their unknowns 0.
    """

    def __init__(
        self,
        blocks: Sequence[tuple[NDArray[np.intp], Array]],
        eliminated: NDArray[np.intp],
        boundary: NDArray[np.intp],
        count: int,
        width: int,
    ) -> None:
        self.rows, self._boundary, self._width = eliminated, boundary, width
        position = np.full(count, -1)
        position[eliminated] = np.arange(len(eliminated))
        position[boundary] = len(eliminated) + np.arange(len(boundary))
        size = (len(eliminated) + len(boundary)) * width
        rows, columns, entries = [], [], []
        for nodes, matrices in blocks:
            at = position[nodes][:, :, None] * width + np.arange(width)
            used = np.repeat(position[nodes] >= 0, width, axis=1)
            at = at.reshape(used.shape)
            both = used[:, :, None] & used[:, None, :]
            rows.append(np.broadcast_to(at[:, :, None], both.shape)[both])
            columns.append(np.broadcast_to(at[:, None, :], both.shape)[both])
            entries.append(matrices[both])
        where = (_joined(rows, np.intp), _joined(columns, np.intp))
        matrix = coo_array((_joined(entries, np.float64), where), shape=(size, size)).tocsc()
        _finite(matrix.data)
        inner = len(eliminated) * width
        self._coupling = csc_array(matrix[:inner, inner:])
        try:
            self._factor = (
                splu(
                    csc_array(matrix[:inner, :inner]),
                    permc_spec="MMD_AT_PLUS_A",
                    diag_pivot_thresh=0.0,
                    options={"SymmetricMode": True},
                )
                if inner
                else None
            )
        except RuntimeError as error:
            raise BackendError(
                f"the {inner} equations of this graph are singular: a pose has no weight to hold it"
            ) from error
        # Zero pivots would have been an error.
        self.convex = self._factor is None or bool((self._factor.U.diagonal() > 0).all())
        """Whether the eliminated rows have a minimum."""
        self.left = self._left(matrix[inner:, inner:].toarray(), csc_array(matrix[:inner, :inner]))

    def _left(self, outer: Array, inner: csc_array) -> Array:
        if self._factor is None:
            return outer
        n, columns = inner.shape[0], outer.shape[1]
        sparse, dense = _SPARSE * 2.0 * self._factor.nnz * columns, n**3 / 3.0 + float(n) ** 2 * columns
        left = outer.copy()
        if dense < sparse and n <= _DENSE and self.convex:
            half = solve_triangular(cholesky(inner.toarray(), lower=True), self._coupling.toarray(), lower=True)
            left -= half.T @ half
        else:
            for at in range(0, columns, _COLUMNS):
                part = self._coupling[:, at : at + _COLUMNS].toarray()
                left[:, at : at + _COLUMNS] -= self._coupling.T @ self._factor.solve(part)
        return 0.5 * (left + left.T)

    def pushed(self, b: Array) -> tuple[Array, float]:
        """For right-hand sides ``(n, w, c)`` of all rows: those ``(k, w, c)`` that the boundary is left with, and by
        how much the eliminated rows alone lower the problem's value."""
        outer: Array = b[self._boundary].copy()
        if self._factor is None:
            return outer, 0.0
        inner = self._flat(b[self.rows])
        solved = _finite(self._factor.solve(inner))
        outer -= (self._coupling.T @ solved).reshape(outer.shape)
        return outer, float((inner * solved).sum())

    def solved(self, b: Array, boundary: Array) -> Array:
        """The eliminated rows' values ``(e, w, c)``, given those of the ``boundary`` ``(k, w, c)``."""
        inner: Array = b[self.rows]
        if self._factor is None:
            return inner.copy()
        rest = self._flat(inner) - self._coupling @ self._flat(boundary)
        return _finite(self._factor.solve(rest)).reshape(inner.shape)

    def _flat(self, values: Array) -> Array:
        return values.reshape(len(values) * self._width, values.shape[2])


def _finite(numbers: Array) -> Array:
    """Those numbers; :class:`BackendError` where what was sent has made one of them infinite or NaN."""
    if not np.isfinite(numbers).all():
        raise BackendError("the equations of this graph, or what was sent of them, have no finite solution")
    return np.asarray(numbers)


def _joined(parts: Sequence[NDArray[np.generic]], kind: type) -> NDArray[np.generic]:
    return np.concatenate(parts) if parts else np.zeros(0, dtype=kind)
