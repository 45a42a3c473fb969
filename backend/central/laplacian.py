"""F as one quadratic form of all poses, ``F = tr(X M X^T)``: its matrix, gradient, and Lagrange multipliers.

``X`` ``(d, n (d + 1))`` has node i's ``[t_i R_i]`` in columns ``i (d + 1)`` on; ``M`` is the sparse connection
Laplacian (Rosen et al., IJRR 2019, with the translations kept, not eliminated). At a stationary point the rows of X
lie in the kernel of ``S = M - blockdiag(0, Lambda_i)``; where S is positive semidefinite the point is the global
optimum.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import bsr_array, coo_array, csr_array
from scipy.sparse.linalg import splu

from ..geometry import Array


def connection_laplacian(ends: NDArray[np.intp], T_ij: Array, kappa: Array, tau: Array, n: int, d: int) -> bsr_array:
    """``M`` ``(n (d + 1), n (d + 1))`` of edges ``ends`` ``(m, 2)``, measured ``(m, 4, 4)``, weights ``(m,)``."""
    m, w = len(ends), d + 1
    # The translation residual is X times this vector over the columns of i and then of j.
    v = np.zeros((m, 2 * w))
    v[:, 0], v[:, 1:w], v[:, w] = -1.0, -T_ij[:, :d, 3], 1.0
    blocks = tau[:, None, None] * v[:, :, None] * v[:, None, :]
    R = kappa[:, None, None] * T_ij[:, :d, :d]
    blocks[:, 1:w, 1:w] += kappa[:, None, None] * np.eye(d)
    blocks[:, w + 1 :, w + 1 :] += kappa[:, None, None] * np.eye(d)
    blocks[:, 1:w, w + 1 :] -= R
    blocks[:, w + 1 :, 1:w] -= np.swapaxes(R, 1, 2)
    # Pairs of nodes, not of numbers, are indexed: of large graphs the indices were most of the memory.
    pairs, slot = np.unique(ends[:, :, None].astype(np.int64) * n + ends[:, None, :], return_inverse=True)
    data, slot, by_pair = np.empty((len(pairs), w, w)), slot.ravel(), blocks.reshape(m, 2, w, 2, w)
    for r in range(w):
        for c in range(w):
            data[:, r, c] = np.bincount(slot, by_pair[:, :, r, :, c].ravel(), len(pairs))
    rows, columns = np.divmod(pairs, n)
    starts = np.searchsorted(rows, np.arange(n + 1))
    indices = (columns.astype(np.int32), starts.astype(np.int32))
    return bsr_array((data, *indices), shape=(n * w, n * w))


def stacked(poses: Array, d: int) -> Array:
    """``X`` ``(d, n (d + 1))`` of poses ``(n, 4, 4)``."""
    columns = np.concatenate([poses[:, :d, 3:], poses[:, :d, :d]], axis=2)
    return np.ascontiguousarray(columns.transpose(1, 0, 2).reshape(d, -1))


def by_node(X: Array, d: int) -> Array:
    """``(n, d, d + 1)``: the blocks of an array laid out as ``X``."""
    return X.reshape(d, -1, d + 1).transpose(1, 0, 2)


def multipliers(poses: Array, XM: Array, d: int) -> Array:
    """``Lambda_i`` ``(n, d, d)``: the symmetric part of ``R_i^T (X M)_i``."""
    product = np.swapaxes(poses[:, :d, :d], 1, 2) @ by_node(XM, d)[:, :, 1:]
    return 0.5 * (product + np.swapaxes(product, 1, 2))


def rotation_diagonal(blocks: Array) -> csr_array:
    """``blockdiag(0, blocks_i)`` over the layout of ``M``, from ``(n, d, d)``."""
    n, d = blocks.shape[:2]
    at = np.arange(n)[:, None] * (d + 1) + 1 + np.arange(d)
    rows, columns = np.broadcast_to(at[:, :, None], blocks.shape), np.broadcast_to(at[:, None, :], blocks.shape)
    size = n * (d + 1)
    return coo_array((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(size, size)).tocsr()


def best_translations(poses: Array, M: csr_array, held: list[int], d: int) -> Array:
    """``poses`` ``(n, 4, 4)`` with the translations that cost least under their rotations; ``held``: one node of each
    connected part, which stays.
    """
    n, w = len(poses), d + 1
    free = np.setdiff1d(np.arange(n), held)
    out = poses.copy()
    if not len(free):
        return out
    factor = splu(M[free * w][:, free * w].tocsc(), permc_spec="MMD_AT_PLUS_A")
    gradient = by_node((M @ stacked(poses, d).T).T, d)[free, :, 0]
    out[free, :d, 3] -= factor.solve(np.ascontiguousarray(gradient))
    return out
