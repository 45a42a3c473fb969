"""One robot's block of a quadratic problem, relaxed sweep by sweep: Gauss-Seidel, Jacobi and over-relaxed.

Two-stage distributed Gauss-Seidel (Choudhary et al., IJRR 2017; thesis section 3.6): every robot in turn solves for
its own nodes with its neighbours' separators held at the last values received. Flagged initialisation: edges to nodes
without an estimate are left out, and a robot with none but such edges waits.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..components import parts
from ..geometry import Array
from .linear import BlockSystem


class Relaxation:
    """Values ``(n, w, c)`` of a robot's own nodes (the first ``own_count``) and of its neighbours' separators; NaN:
    no estimate yet.
    """

    def __init__(
        self, ends: NDArray[np.intp], blocks: tuple[Array, Array], values: Array, own_count: int, given: list[int]
    ) -> None:
        """``ends`` ``(m, 2)`` rows into ``values``; ``blocks`` Hessians and right-hand sides; ``given``: own rows
        that stay as they are.
        """
        self.values = values
        self._ends, (self._hessian, self._rhs) = ends, blocks
        self._free = np.setdiff1d(np.arange(own_count), given)
        self._is_free = np.zeros(len(values), dtype=bool)
        self._is_free[self._free] = True
        self._island = self._islands()
        self._system: BlockSystem | None = None
        self._known: NDArray[np.bool_] | None = None

    def sweep(self, relaxation: float) -> float:
        """Solve for the own nodes; returns the 2-norm of their change, infinite if one got its first estimate."""
        system = self._current_system()
        rows = system.solved
        if not len(rows):
            return 0.0
        old, new = self.values[rows], system.solve(self.values)
        first = ~np.isfinite(old).all(axis=(1, 2))
        relaxed = np.where(first[:, None, None], new, old + relaxation * (new - old))
        self.values[rows] = relaxed
        return float("inf") if first.any() else float(np.linalg.norm(relaxed - old))

    def known(self) -> NDArray[np.bool_]:
        """Mask ``(n,)`` of the nodes with an estimate."""
        return np.asarray(np.isfinite(self.values).all(axis=(1, 2)))

    def _islands(self) -> NDArray[np.intp]:
        """Label ``(n,)`` of the connected set of free nodes that each free node belongs to; meaningless elsewhere."""
        return parts(self._ends[self._is_free[self._ends].all(axis=1)], len(self.values))

    def _current_system(self) -> BlockSystem:
        """The equations of all free nodes that edges tie to something known; rebuilt only when more becomes known."""
        known = self.known() & ~self._is_free
        if self._system is None or self._known is None or not np.array_equal(known, self._known):
            held = known[self._ends] & self._is_free[self._ends[:, ::-1]]
            tied = self._ends[:, ::-1][held]
            reached = np.isin(self._island, self._island[tied]) & self._is_free
            used = np.asarray((known | reached)[self._ends].all(axis=1) & reached[self._ends].any(axis=1))
            self._system = BlockSystem(self._ends, self._hessian, self._rhs, np.flatnonzero(reached), used)
            self._known = known
        return self._system
