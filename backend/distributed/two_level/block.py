"""One robot's equations around where poses are: its own block, and sums over edges that the group needs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from ...geometry import Array
from ..local import LocalProblem
from ..multifrontal.equations import Equations, Unknowns
from ..places import SCALED


class Block:
    """Linearised at ``problem.places``; ``placed`` ``(n,)``: nodes that have a place; ``shared``: own rows that
    neighbours know."""

    def __init__(self, problem: LocalProblem, placed: NDArray[np.bool_], shared: NDArray[np.intp]) -> None:
        self._width, self._own, self._shared = problem.width, problem.own_count, shared
        n, w = len(problem), problem.width
        used = np.asarray(placed[problem.edges.ends].all(axis=1))
        edges = problem.edges.only(used)
        self._ends, self._counted = edges.ends, problem.counted[used]
        hessian, rhs = Equations(edges, problem.fixed, problem.share.scaled).blocks(Unknowns.POSE, problem.places)
        self._hessian, self._rhs = hessian, rhs[:, :, 0]
        index = (self._ends[:, :, None] * w + np.arange(w)).reshape(len(self._ends), 2 * w)
        rows = np.repeat(index[:, :, None], 2 * w, axis=2).ravel()
        columns = np.repeat(index[:, None, :], 2 * w, axis=1).ravel()
        self._matrix = coo_array((hessian.ravel(), (rows, columns)), shape=(n * w, n * w)).tocsr()
        force = np.zeros(n * w)
        np.add.at(force, index.ravel(), self._rhs.ravel())
        free = np.zeros((n, w), dtype=bool)
        free[np.unique(self._ends)] = True
        free[self._own :] = False
        free[problem.given] = False
        if w == SCALED:
            free[problem.fixed, 6] = False
        self.free = np.flatnonzero(free.ravel())
        self._force = np.where(free.ravel(), force, 0.0)
        held = np.zeros((n, w), dtype=bool)
        held[shared] = True
        self._inner = np.flatnonzero((free & ~held).ravel())
        self._factor = _factor(self._matrix, self.free)
        self._inner_factor = _factor(self._matrix, self._inner)

    def forces_on_shared(self) -> Array:
        """On own poses that neighbours know ``(k, w)``: the negative gradient of F, halved, where all other own poses
        follow."""
        force = self._force.copy()
        if self._inner_factor is not None:
            settled = np.zeros(len(force))
            settled[self._inner] = self._inner_factor.solve(force[self._inner])
            force -= self._matrix @ settled
        force[np.setdiff1d(np.arange(len(force)), self.free)] = 0.0
        return force.reshape(-1, self._width)[self._shared]

    def correction(self, moves: Array) -> Array:
        """Further moves ``(own, w)`` of own poses that end in equilibrium, all nodes moved by ``moves`` ``(n, w)``."""
        left = (self._force - self._matrix @ moves.ravel())[self.free]
        out = np.zeros(self._force.shape)
        if self._factor is not None:
            out[self.free] = self._factor.solve(left)
        return out.reshape(-1, self._width)[: self._own]

    def follow(self, change: Array) -> Array:
        """Moves ``(own, w)`` of own poses that nobody shares: they follow a ``change`` ``(own, w)`` of shared ones."""
        whole = np.zeros(self._force.shape)
        whole[: change.size] = change.ravel()
        out = np.zeros(self._force.shape)
        if self._inner_factor is not None:
            out[self._inner] = self._inner_factor.solve(-(self._matrix @ whole)[self._inner])
        return out.reshape(-1, self._width)[: self._own]

    def sums(self, moves: Sequence[Array]) -> tuple[float, ...]:
        """Over the edges this robot counts: products of ``moves`` ``(n, w)`` in the matrix, upper triangle row by row,
        then with the forces."""
        by_edge = [m[self._ends].reshape(len(self._ends), 2 * self._width)[self._counted] for m in moves]
        hessian, rhs = self._hessian[self._counted], self._rhs[self._counted]
        out = []
        for k, a in enumerate(by_edge):
            pulled = np.einsum("mij,mj->mi", hessian, a)
            out += [float((pulled * b).sum()) for b in by_edge[k:]]
        return (*out, *(float((rhs * a).sum()) for a in by_edge))


def _factor(matrix: csc_array, rows: NDArray[np.intp]) -> splu | None:
    if not len(rows):
        return None
    inner = csc_array(matrix[rows][:, rows])
    return splu(inner, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
