"""Cholesky factor of a large sparse matrix in square blocks, one a pair of nodes: for graphs whose memory counts.

Half of what an LU factor holds, and no index for each number. Row by row as in CSparse (Davis, 2006, section 4.8), but
of blocks; the elimination order is SuperLU's minimum degree on the graph of the nodes.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import splu

from maslam._kernels import kernel

from ..errors import BackendError
from ..geometry import Array

Rows = NDArray[np.int64]


class BlockMatrix:
    """A symmetric positive definite matrix ``(n w, n w)`` that blocks are added to, and then its factor.

    ``ends`` ``(m, 2)``: rows of blocks that each edge joins, -1 for one that is no unknown.
    """

    def __init__(self, ends: NDArray[np.intp], nodes: int, width: int) -> None:
        self._ends, self._nodes, self._width = ends.astype(np.int64), nodes, width
        joined = self._ends[(self._ends >= 0).all(axis=1)]
        self._position = _order(joined, nodes)
        at = np.sort(self._position[joined], axis=1)
        diagonal = np.arange(nodes, dtype=np.int64)
        # By column, rows ascending: the diagonal's block is the last of its column.
        keys = np.unique(np.concatenate([at[:, 1] * nodes + at[:, 0], diagonal * nodes + diagonal]))
        self._keys = keys
        columns, self._rows = np.divmod(keys, nodes)
        self._starts = np.searchsorted(columns, np.arange(nodes + 1)).astype(np.int64)
        self._blocks = np.zeros((len(keys), width, width))

    def add(self, first: int, hessian: Array) -> None:
        """Add blocks ``(k, 2 w, 2 w)`` of the edges from the ``first`` on."""
        own = self._ends[first : first + len(hessian)]
        known = own >= 0
        at = np.where(known, self._position[own], -1)
        low, high = at.min(axis=1), at.max(axis=1)
        slots = np.full((len(own), 3), -1, dtype=np.int64)
        for side in range(2):
            slots[:, side] = np.where(known[:, side], self._slot(at[:, side], at[:, side]), -1)
        slots[:, 2] = np.where(known.all(axis=1), self._slot(low, high), -1)
        _add(self._blocks, slots, at[:, 0] <= at[:, 1], np.ascontiguousarray(hessian), self._width)

    def factor(self) -> BlockFactor:
        """:class:`BackendError` where the matrix is not positive definite. The blocks are used up."""
        parent, counts = _tree(self._starts, self._rows)
        starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        rows, below = np.empty(starts[-1], dtype=np.int64), np.empty((starts[-1], self._width, self._width))
        diagonal = np.empty((self._nodes, self._width, self._width))
        failed = _factor(self._starts, self._rows, self._blocks, parent, starts, rows, below, diagonal)
        if failed >= 0:
            raise BackendError(f"a matrix of {self._nodes * self._width} equations is not positive definite")
        return BlockFactor(self._position, starts, rows, below, diagonal)

    def _slot(self, low: Rows, high: Rows) -> Rows:
        return np.minimum(np.searchsorted(self._keys, high * self._nodes + low), len(self._keys) - 1)


class BlockFactor:
    """``A = L L^T`` in blocks, rows in the order of ``position`` ``(n,)``; solves with it."""

    def __init__(self, position: Rows, starts: Rows, rows: Rows, below: Array, diagonal: Array) -> None:
        self._position, self._starts, self._rows, self._below, self._diagonal = position, starts, rows, below, diagonal

    @property
    def nbytes(self) -> int:
        """Memory of its numbers."""
        return self._below.nbytes + self._diagonal.nbytes + self._rows.nbytes

    def solve(self, rhs: Array) -> Array:
        """The matrix's inverse times ``rhs`` ``(n w, c)``."""
        nodes, width = self._diagonal.shape[:2]
        x = np.empty((nodes, width, rhs.shape[1]))
        x[self._position] = rhs.reshape(nodes, width, -1)
        _solve(self._starts, self._rows, self._below, self._diagonal, x)
        return np.asarray(x[self._position].reshape(rhs.shape))


def _order(joined: Rows, nodes: int) -> Rows:
    """Place ``(n,)`` of each node in the order of elimination."""
    ones = np.ones(len(joined))
    graph = coo_array((ones, (joined[:, 0], joined[:, 1])), shape=(nodes, nodes))
    graph = (graph + graph.T).tocsr()
    matrix = (diags_array(np.asarray(graph.sum(axis=1)).ravel() + 1.0) - graph).tocsc()
    options = {"SymmetricMode": True}
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    return np.asarray(factor.perm_c, dtype=np.int64)


@kernel
def _add(blocks, slots, straight, hessian, w):  # type: ignore[no-untyped-def]
    """Add the blocks ``(k, 2 w, 2 w)`` of edges to those of both ends and, above the diagonal, of the pair."""
    for e in range(len(slots)):
        for side in range(2):
            s = slots[e, side]
            if s >= 0:
                for r in range(w):
                    for c in range(w):
                        blocks[s, r, c] += hessian[e, side * w + r, side * w + c]
        s = slots[e, 2]
        if s >= 0:
            for r in range(w):
                for c in range(w):
                    blocks[s, r, c] += hessian[e, r, w + c] if straight[e] else hessian[e, w + r, c]


@kernel
def _tree(starts, rows):  # type: ignore[no-untyped-def]
    """Parent of each column in the elimination tree, -1 for a root; blocks below the diagonal of each column of L."""
    n = len(starts) - 1
    parent, mark = np.full(n, -1), np.full(n, -1)
    counts = np.zeros(n, dtype=np.int64)
    for k in range(n):
        mark[k] = k
        for p in range(starts[k], starts[k + 1] - 1):
            i = rows[p]
            while mark[i] != k:
                if parent[i] < 0:
                    parent[i] = k
                counts[i] += 1
                mark[i] = k
                i = parent[i]
    return parent, counts


@kernel
def _factor(a_starts, a_rows, a, parent, starts, rows, below, diagonal):  # type: ignore[no-untyped-def]
    """L's blocks: ``diagonal`` lower triangles, ``below`` by column, transposed. Returns -1, or the row that failed."""
    n, w = len(diagonal), diagonal.shape[1]
    free, mark, stack = starts[:-1].copy(), np.full(n, -1), np.empty(n, dtype=np.int64)
    path = np.empty(n, dtype=np.int64)
    x, last = np.zeros((n, w, w)), np.empty((w, w))
    for k in range(n):
        top = n
        mark[k] = k
        last[:] = a[a_starts[k + 1] - 1]
        for p in range(a_starts[k], a_starts[k + 1] - 1):
            i = a_rows[p]
            x[i] = a[p]
            length = 0
            while mark[i] != k:
                path[length] = i
                length += 1
                mark[i] = k
                i = parent[i]
            while length > 0:
                top -= 1
                length -= 1
                stack[top] = path[length]
        for t in range(top, n):
            i = stack[t]
            y, d = x[i], diagonal[i]
            for r in range(w):
                for s in range(r):
                    for c in range(w):
                        y[r, c] -= d[r, s] * y[s, c]
                for c in range(w):
                    y[r, c] /= d[r, r]
            for p in range(starts[i], free[i]):
                z, b = x[rows[p]], below[p]
                for r in range(w):
                    for s in range(w):
                        for c in range(w):
                            z[r, c] -= b[s, r] * y[s, c]
            for r in range(w):
                for s in range(w):
                    for c in range(r + 1):
                        last[r, c] -= y[s, r] * y[s, c]
            below[free[i]] = y
            rows[free[i]] = k
            free[i] += 1
            y[:] = 0.0
        for r in range(w):
            for c in range(r + 1):
                value = last[r, c]
                for s in range(c):
                    value -= diagonal[k, r, s] * diagonal[k, c, s]
                if r > c:
                    diagonal[k, r, c] = value / diagonal[k, c, c]
                elif value > 0.0:
                    diagonal[k, r, r] = np.sqrt(value)
                else:
                    return k
    return -1


@kernel
def _solve(starts, rows, below, diagonal, x):  # type: ignore[no-untyped-def]
    """``x`` ``(n, w, c)`` becomes the matrix's inverse times it."""
    n, w, columns = x.shape
    for i in range(n):
        for r in range(w):
            for c in range(columns):
                for s in range(r):
                    x[i, r, c] -= diagonal[i, r, s] * x[i, s, c]
                x[i, r, c] /= diagonal[i, r, r]
        for p in range(starts[i], starts[i + 1]):
            j = rows[p]
            for r in range(w):
                for s in range(w):
                    for c in range(columns):
                        x[j, r, c] -= below[p, s, r] * x[i, s, c]
    for i in range(n - 1, -1, -1):
        for p in range(starts[i], starts[i + 1]):
            j = rows[p]
            for r in range(w):
                for s in range(w):
                    for c in range(columns):
                        x[i, r, c] -= below[p, r, s] * x[j, s, c]
        for r in range(w - 1, -1, -1):
            for c in range(columns):
                for s in range(r + 1, w):
                    x[i, r, c] -= diagonal[i, s, r] * x[i, s, c]
                x[i, r, c] /= diagonal[i, r, r]
