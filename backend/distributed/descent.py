"""One robot's block of the non-linear problem: Riemannian block-coordinate descent (Tian et al., T-RO 2021).

A sweep solves for all own poses with the neighbours' separators held where last received: one exact
Gauss-Newton step on F, over-relaxed, shortened until the robot's own cost does not rise. What the neighbours receive
is a coarse step; the robot's own separators then stand exactly where the neighbours believe them to be.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..central.linear import BlockSystem, pose_blocks
from ..central.similarity_edges import SimilarityEdges, newton_step
from ..geometry import Array
from .local import LocalProblem
from .places import SCALED, Places, move, moved, places_of
from .placing import Pieces
from .solver_stage import as_sent

# Steps of one byte.
_LARGEST_STEP = 127
# Tried in this order after the over-relaxed step.
_SHORTER = (1.0, 0.5, 0.25, 0.125)
# What a rejected edge still weighs in the equations, so that no pose floats.
_FLOOR = 1e-6


class BlockDescent:
    """Works on ``problem.places`` in place. ``placed`` ``(n,)``: rows that have a place in the group's frame."""

    def __init__(self, problem: LocalProblem, warm: bool, trusted: NDArray[np.bool_], bound: float | None) -> None:
        """``trusted`` ``(m,)``: edges the local start may build on; ``bound``: see :meth:`Pieces.place`."""
        self.problem = problem
        n, own = len(problem), problem.own_count
        self.placed = np.ones(n, dtype=bool)
        self.edge_weights = np.ones(len(problem.edges.ends))
        self.shared = np.array(sorted({r for rows in problem.sent_rows.values() for r in rows}), dtype=np.intp)
        self._bound = bound
        self._pieces: Pieces | None = None
        if not warm:
            inner = (problem.edges.ends < own).all(axis=1) & trusted
            self._pieces = Pieces(problem.edges, inner, problem.fixed[:own])
            self._pieces.solve(problem.places)
            problem.places.poses[own:] = np.nan
            self.placed[:] = False
            if problem.given:
                self.placed[np.flatnonzero(self._pieces.label == self._pieces.label[0])] = True

    def metric(self) -> Array:
        """Square roots of the diagonal ``(own, width)`` of the Gauss-Newton matrix, roughly: what a move weighs."""
        problem = self.problem
        edges, diagonal = problem.edges, np.zeros((len(problem), 3))
        tau = edges.tau * np.exp(-2.0 * problem.places.log_units[edges.ends[:, 0]])
        for side in range(2):
            np.add.at(diagonal[:, 0], edges.ends[:, side], tau)
            np.add.at(diagonal[:, 1], edges.ends[:, side], 2.0 * edges.kappa)
            np.add.at(diagonal[:, 2], edges.ends[:, side], edges.precision)
        return np.sqrt(np.repeat(diagonal[: problem.own_count], (3, 3, 1), axis=1)[:, : problem.width])

    def weighted(self) -> SimilarityEdges:
        """The edges under their weights."""
        return self.problem.edges.weighted(np.maximum(self.edge_weights, _FLOOR))

    @property
    def pieces(self) -> NDArray[np.intp]:
        """Number of each own node's piece ``(own,)``."""
        return self._pieces.label if self._pieces is not None else np.zeros(self.problem.own_count, dtype=np.intp)

    def place(self) -> bool:
        """Place own pieces that have become tied; True if any was."""
        return self._pieces is not None and self._pieces.place(self.problem.places, self.placed, self._bound)

    def sweep(self, relaxation: float) -> float:
        """One block step; returns the root mean square change of an own pose (metres and radians)."""
        problem = self.problem
        free = np.flatnonzero(self.placed[: problem.own_count])
        free = np.setdiff1d(free, problem.given)
        is_free = np.zeros(len(problem), dtype=bool)
        is_free[free] = True
        ends = problem.edges.ends
        used = np.asarray(self.placed[ends].all(axis=1) & is_free[ends].any(axis=1))
        if not len(free) or not used.any():
            return 0.0
        free = np.intersect1d(free, ends[used])
        edges = self.weighted().only(used)
        step = self._newton_step(edges, free)
        start, before = problem.places.at(free), self._cost(edges)
        for share in (relaxation, *_SHORTER):
            problem.places.put(free, move(start, share * step))
            if self._cost(edges) <= before:
                return float(share * np.sqrt((step**2).sum(axis=1).mean()))
        problem.places.put(free, start)
        return 0.0

    def _newton_step(self, edges: SimilarityEdges, free: NDArray[np.intp]) -> Array:
        problem, places = self.problem, self.problem.places
        if problem.width == SCALED:
            return newton_step(edges, places.poses, places.log_units, free, problem.fixed)
        i, j = edges.ends.T
        R = places.poses[:, :3, :3]
        hessian, rhs = pose_blocks(R[i], R[j], edges.measured, edges.kappa, edges.tau)
        system = BlockSystem(edges.ends, hessian, rhs, free, np.ones(len(i), dtype=bool))
        values = np.zeros((len(problem), 6, 1))
        values[:, :3, 0] = places.poses[:, :3, 3]
        solved: Array = system.solve(values)[:, :, 0]
        solved[:, :3] -= places.poses[free, :3, 3]
        return solved

    def _cost(self, edges: SimilarityEdges) -> float:
        places = self.problem.places
        return float(edges.costs(places.poses, places.log_units).sum())

    def cost(self) -> float:
        """The robot's part of the weighted F, over edges whose ends both have a place."""
        counted = self.problem.counted & self.placed[self.problem.edges.ends].all(axis=1)
        return self._cost(self.weighted().only(counted))

    # -- what is sent ------------------------------------------------------------------------------------------------

    def round_to_steps(self, before: Places) -> tuple[tuple[float, ...], NDArray[np.int8]]:
        """Move the own separators to where whole steps from ``before`` lead; returns scales, steps ``(k, width)``."""
        width, places = self.problem.width, self.problem.places
        delta = np.nan_to_num(moved(before, places.at(self.shared), width))
        largest = [float(np.abs(part).max(initial=0.0)) / _LARGEST_STEP for part in np.split(delta, [3, 6], axis=1)]
        # Rounded up, so that no step is beyond the largest.
        up = [float(np.nextafter(np.float32(x), np.float32(np.inf))) if x > 0 else 0.0 for x in largest]
        scales = tuple(up[: width - 4])
        unit = _a_number([s if s > 0 else 1.0 for s in scales])
        steps = np.clip(np.rint(delta / unit), -_LARGEST_STEP, _LARGEST_STEP).astype(np.int8)
        places.put(self.shared, stepped(before, scales, steps))
        return scales, steps

    def round_to_numbers(self, kind: str) -> Array:
        """Round the own separators to what numbers of ``kind`` can represent; returns these numbers ``(k, width)``, NaN
        without a place.
        """
        places = self.problem.places
        values = places.at(self.shared).numbers(self.problem.width).astype(kind).astype(np.float64)
        keep = self.placed[self.shared]
        values[~keep] = np.nan
        places.put(self.shared[keep], places_of(values[keep]))
        return values


def _a_number(scales: Sequence[float]) -> Array:
    """``(6,)`` or ``(7,)``: a scale for each number of a move, from those of shift, turn and log unit."""
    return np.repeat(np.array(scales, dtype=np.float64), (3, 3, 1)[: len(scales)])


def stepped(before: Places, scales: Sequence[float], steps: NDArray[np.int8]) -> Places:
    """Places that ``steps`` ``(k, width)`` from ``before`` lead to: the same bits at both ends of an edge."""
    return move(before, steps.astype(np.float64) * _a_number(as_sent(scales)))
