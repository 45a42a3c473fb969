"""Equations of a Gauss-Newton step of F, of any size: those of large graphs never have all their blocks in memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import BackendError
from ..geometry import Array
from .linear import LARGE, BlockSystem, pose_blocks

# Edges whose blocks are in memory at a time.
_EDGES = 1024


def pose_system(
    ends: NDArray[np.intp], R: Array, measured: Array, weights: tuple[Array, Array], solved: NDArray[np.intp]
) -> BlockSystem:
    """The system of :func:`pose_blocks` around rotations ``(n, 3, 3)`` for the nodes ``solved``, the others given."""
    if 6 * len(solved) > LARGE:
        try:
            return _LargeSystem(ends, R, measured, weights, solved)
        except BackendError:
            pass  # all blocks at once then, as of a small one
    i, j = ends.T
    return BlockSystem(ends, *pose_blocks(R[i], R[j], measured, *weights), solved, np.ones(len(i), dtype=bool))


class _LargeSystem(BlockSystem):
    """The same by a Cholesky factor in blocks, which hold a third of an LU factor's memory; edge by edge."""

    def __init__(
        self, ends: NDArray[np.intp], R: Array, measured: Array, weights: tuple[Array, Array], solved: NDArray[np.intp]
    ) -> None:
        from .block_cholesky import BlockMatrix  # compiles

        self.solved, self.width = solved, 6
        position = np.full(len(R), -1)
        position[solved] = np.arange(len(solved))
        own = position[ends]
        matrix = BlockMatrix(own, len(solved), self.width)
        self._constant = np.zeros((len(solved), self.width, 1))
        couplings = []
        for at in range(0, len(ends), _EDGES):
            part = slice(at, at + _EDGES)
            i, j = ends[part].T
            hessian, rhs = pose_blocks(R[i], R[j], measured[part], weights[0][part], weights[1][part])
            matrix.add(at, hessian)
            self._add_constant(own[part], rhs)
            couplings.append(self._collect_couplings(ends[part], own[part], hessian))
        ours, theirs, blocks = (np.concatenate(c) for c in zip(*couplings, strict=True))
        self._couplings = (ours, theirs, blocks)
        self._factor = matrix.factor()
