"""Bringing a robot's own frame into the group's: no initial guess needed, one transform for each rigid piece.

A robot solves its own graph alone first; what hangs together there is a piece. A piece is placed by the edges that tie
it to poses that have a place already. This is flagged initialisation with six numbers per separator instead of nine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..central.chordal import two_stage_poses
from ..central.linear import edge_costs
from ..components import parts
from ..geometry import Array, project_to_so3, se3, se3_inverse

# Gauss-Newton steps of the local start.
_LOCAL_STEPS = 3


class Pieces:
    """Own nodes (the first ``own_count`` rows of ``poses``) in pieces, each solved by its ``inner`` edges alone."""

    def __init__(
        self,
        ends: NDArray[np.intp],
        measured: Array,
        weights: tuple[Array, Array],
        inner: NDArray[np.bool_],
        own_count: int,
    ) -> None:
        """``inner`` ``(m,)``: edges between own nodes that are trusted for the local start."""
        self._ends, self._measured, self._weights, self._inner = ends, measured, weights, inner
        self._own_count = own_count
        self.label = parts(ends[inner], own_count)

    def solve(self, poses: Array) -> None:
        """The local start: each piece's poses by its own edges, its first node where it is; in place."""
        kappa, tau = self._weights
        inner = self._inner
        own = poses[: self._own_count]
        own[:] = two_stage_poses(
            self._ends[inner], self._measured[inner], (kappa[inner], tau[inner]), own, _LOCAL_STEPS
        )

    def place(self, poses: Array, placed: NDArray[np.bool_], bound: float | None) -> bool:
        """Move pieces that edges tie to ``placed`` poses to where these edges put them, and mark them; True if any was.

        With a ``bound`` on an edge's cost the edges vote first, and only those that agree with the winner count.
        """
        found = False
        while True:
            own, T_given, T_own, k = self._ties(poses, placed)
            waiting = np.unique(self.label[own])
            if not len(waiting):
                return found
            # The piece with the most ties first: it may bring ties for the others.
            counts = [(self.label[own] == piece).sum() for piece in waiting]
            piece = waiting[int(np.argmax(counts))]
            use = self.label[own] == piece
            move = self._transform(T_given[use], T_own[use], k[use], bound)
            rows = np.flatnonzero(self.label == piece)
            poses[rows] = move @ poses[rows]
            placed[rows] = True
            found = True

    def _ties(self, poses: Array, placed: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Array, Array, NDArray[np.intp]]:
        """Edges from a piece without a place to a placed pose: rows, where the edge puts the own node, where it is."""
        rows, predicted, edges = [], [], []
        for side in range(2):
            mine, theirs = self._ends[:, side], self._ends[:, 1 - side]
            k = np.flatnonzero((mine < self._own_count) & ~placed[mine] & placed[theirs])
            step = self._measured[k] if side == 1 else se3_inverse(self._measured[k])
            rows.append(mine[k])
            predicted.append(poses[theirs[k]] @ step)
            edges.append(k)
        own = np.concatenate(rows)
        return own, np.concatenate(predicted), poses[own], np.concatenate(edges)

    def _transform(self, T_given: Array, T_own: Array, k: NDArray[np.intp], bound: float | None) -> Array:
        """The transform ``(4, 4)`` that brings ``T_own`` to ``T_given`` ``(n, 4, 4)`` best."""
        kappa, tau = np.maximum(self._weights[0][k], 1e-12), np.maximum(self._weights[1][k], 1e-12)
        if bound is not None and len(k) > 2:
            candidates = T_given @ se3_inverse(T_own)
            eye = np.broadcast_to(np.eye(4), T_own.shape)
            costs = np.array([edge_costs(T_given, c @ T_own, eye, kappa, tau) for c in candidates])
            # Own drift makes right edges disagree too: the bound widens until the winner has some company.
            company = max(3, -(-len(k) // 5))
            limit = max(bound, float(np.sort(costs, axis=1)[:, min(company, len(k)) - 1].min()))
            truncated = np.minimum(costs, limit).sum(axis=1)
            agree = costs[int(np.argmin(truncated))] <= limit
            T_given, T_own, kappa, tau = T_given[agree], T_own[agree], kappa[agree], tau[agree]
        turns = T_given[:, :3, :3] @ np.swapaxes(T_own[:, :3, :3], 1, 2)
        R = project_to_so3((kappa[:, None, None] * turns).sum(axis=0))
        shifts = T_given[:, :3, 3] - T_own[:, :3, 3] @ R.T
        return se3(R, (tau[:, None] * shifts).sum(axis=0) / tau.sum())
