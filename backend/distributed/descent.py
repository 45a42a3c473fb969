"""One robot's block of the non-linear problem: Riemannian block-coordinate descent (Tian et al., T-RO 2021).

A sweep solves for all own poses with the neighbours' separators held where last received: one exact
Gauss-Newton step on F, over-relaxed, shortened until the robot's own cost does not rise. What the neighbours receive
is a coarse step; the robot's own separators then stand exactly where the neighbours believe them to be.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..central.linear import BlockSystem, edge_costs, pose_blocks
from ..geometry import Array, se3, so3_exp, so3_log
from .local import LocalProblem
from .messages import as_sent
from .mixing import move, moved
from .placing import Pieces

# Steps of one byte.
_LARGEST_STEP = 127
# Tried in this order after the over-relaxed step.
_SHORTER = (1.0, 0.5, 0.25, 0.125)
# What a rejected edge still weighs in the equations, so that no pose floats.
_FLOOR = 1e-6


class BlockDescent:
    """Works on ``problem.poses`` in place. ``placed`` ``(n,)``: rows that have a place in the group's frame."""

    def __init__(self, problem: LocalProblem, warm: bool, trusted: NDArray[np.bool_], bound: float | None) -> None:
        """``trusted`` ``(m,)``: edges the local start may build on; ``bound``: see :meth:`Pieces.place`."""
        self.problem = problem
        n, own = len(problem.nodes), problem.own_count
        self.placed = np.ones(n, dtype=bool)
        self.edge_weights = np.ones(len(problem.ends))
        self.shared = np.array(sorted({r for rows in problem.sent_rows.values() for r in rows}), dtype=np.intp)
        self._bound = bound
        self._pieces: Pieces | None = None
        if not warm:
            inner = (problem.ends < own).all(axis=1) & trusted
            weights = (problem.kappa, problem.tau)
            self._pieces = Pieces(problem.ends, problem.measured, weights, inner, own)
            self._pieces.solve(problem.poses)
            problem.poses[own:] = np.nan
            self.placed[:] = False
            if problem.given:
                self.placed[np.flatnonzero(self._pieces.label == self._pieces.label[0])] = True

    def metric(self) -> Array:
        """Square roots of the diagonal ``(own, 6)`` of the Gauss-Newton matrix, roughly: what a move weighs."""
        diagonal = np.zeros((len(self.problem.nodes), 2))
        for side in range(2):
            np.add.at(diagonal[:, 0], self.problem.ends[:, side], self.problem.tau)
            np.add.at(diagonal[:, 1], self.problem.ends[:, side], 2.0 * self.problem.kappa)
        return np.sqrt(np.repeat(diagonal[: self.problem.own_count], 3, axis=1))

    def weights(self) -> tuple[Array, Array]:
        """kappa and tau ``(m,)`` under the edges' weights."""
        w = np.maximum(self.edge_weights, _FLOOR)
        return self.problem.kappa * w, self.problem.tau * w

    def place(self) -> bool:
        """Place own pieces that have become tied; True if any was."""
        return self._pieces is not None and self._pieces.place(self.problem.poses, self.placed, self._bound)

    def sweep(self, relaxation: float) -> float:
        """One block step; returns the root mean square change of an own pose (metres and radians)."""
        problem = self.problem
        free = np.flatnonzero(self.placed[: problem.own_count])
        free = np.setdiff1d(free, problem.given)
        is_free = np.zeros(len(problem.nodes), dtype=bool)
        is_free[free] = True
        used = np.asarray(self.placed[problem.ends].all(axis=1) & is_free[problem.ends].any(axis=1))
        if not len(free) or not used.any():
            return 0.0
        free = np.intersect1d(free, problem.ends[used])
        step = self._newton_step(free, used)
        start, before = problem.poses[free].copy(), self._local_cost(used)
        for share in (relaxation, *_SHORTER):
            problem.poses[free] = move(start, share * step)
            if self._local_cost(used) <= before:
                return float(share * np.sqrt((step**2).sum(axis=1).mean()))
        problem.poses[free] = start
        return 0.0

    def _newton_step(self, free: NDArray[np.intp], used: NDArray[np.bool_]) -> Array:
        problem = self.problem
        i, j = problem.ends[used].T
        R, (kappa, tau) = problem.poses[:, :3, :3], self.weights()
        hessian, rhs = pose_blocks(R[i], R[j], problem.measured[used], kappa[used], tau[used])
        system = BlockSystem(problem.ends[used], hessian, rhs, free, np.ones(len(i), dtype=bool))
        values = np.zeros((len(problem.nodes), 6, 1))
        values[:, :3, 0] = problem.poses[:, :3, 3]
        solved: Array = system.solve(values)[:, :, 0]
        solved[:, :3] -= problem.poses[free, :3, 3]
        return solved

    def _local_cost(self, used: NDArray[np.bool_]) -> float:
        problem = self.problem
        i, j = problem.ends[used].T
        kappa, tau = (w[used] for w in self.weights())
        return float(edge_costs(problem.poses[i], problem.poses[j], problem.measured[used], kappa, tau).sum())

    def cost(self) -> float:
        """The robot's part of the weighted F, over edges whose ends both have a place."""
        problem = self.problem
        counted = problem.counted & self.placed[problem.ends].all(axis=1)
        i, j = problem.ends[counted].T
        kappa, tau = (w[counted] for w in self.weights())
        return float(edge_costs(problem.poses[i], problem.poses[j], problem.measured[counted], kappa, tau).sum())

    # -- what is sent ------------------------------------------------------------------------------------------------

    def round_to_steps(self, before: Array) -> tuple[tuple[float, float], NDArray[np.int8]]:
        """Move the own separators to where whole steps from ``before`` ``(k, 4, 4)`` lead; returns scales and steps
        ``(k, 6)``.
        """
        delta = np.nan_to_num(moved(before, self.problem.poses[self.shared]))
        largest = [float(np.abs(delta[:, s : s + 3]).max(initial=0.0)) / _LARGEST_STEP for s in (0, 3)]
        # Rounded up, so that no step is beyond the largest.
        scales = tuple(float(np.nextafter(np.float32(x), np.float32(np.inf))) if x > 0 else 0.0 for x in largest)
        unit = np.repeat([s if s > 0 else 1.0 for s in scales], 3)
        steps = np.clip(np.rint(delta / unit), -_LARGEST_STEP, _LARGEST_STEP).astype(np.int8)
        self.problem.poses[self.shared] = stepped(before, (scales[0], scales[1]), steps)
        return (scales[0], scales[1]), steps

    def round_to_numbers(self, kind: str) -> Array:
        """Round the own separators to what numbers of ``kind`` can represent; returns translation and rotation vector
        ``(k, 6)``, NaN without a place.
        """
        T = self.problem.poses[self.shared]
        values = np.concatenate([T[:, :3, 3], so3_log(T[:, :3, :3])], axis=1).astype(kind).astype(np.float64)
        keep = self.placed[self.shared]
        values[~keep] = np.nan
        self.problem.poses[self.shared[keep]] = se3(so3_exp(values[keep, 3:]), values[keep, :3])
        return values


def stepped(before: Array, scales: tuple[float, float], steps: NDArray[np.int8]) -> Array:
    """Poses ``(k, 4, 4)`` that ``steps`` ``(k, 6)`` from ``before`` lead to: the same bits at both ends of an edge."""
    return move(before, steps.astype(np.float64) * np.repeat(as_sent(scales), 3))
