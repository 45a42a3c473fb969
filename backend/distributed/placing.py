"""Bringing a robot's own frame into the group's: no initial guess needed, one transform for each piece.

A robot solves its own graph alone first; what hangs together there is a piece. A piece is placed by the edges that tie
it to poses that have a place already, as a whole: rigidly, or, where its unit of length is its own, by a similarity.
This is flagged initialisation with six or seven numbers per separator instead of nine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..central.minimum import near_minimum
from ..central.similarity_edges import SimilarityEdges
from ..components import first_of_parts, parts
from ..geometry import Array, project_to_so3, se3, se3_inverse
from .places import Places

# Gauss-Newton steps of the local start.
_LOCAL_STEPS = 3


class Pieces:
    """Own nodes (the first rows) in pieces, each solved by its ``inner`` edges alone."""

    def __init__(self, edges: SimilarityEdges, inner: NDArray[np.bool_], fixed: NDArray[np.bool_]) -> None:
        """``inner`` ``(m,)``: edges between own nodes that are trusted for the local start; ``fixed`` ``(own,)``: own
        nodes whose unit is no variable.
        """
        self._edges, self._inner, self._fixed = edges, inner, fixed
        self._own_count = len(fixed)
        self.label = parts(edges.ends[inner], self._own_count)

    def solve(self, places: Places) -> None:
        """The local start: each piece's poses by its own edges, its first node where it is; in place."""
        own, edges = places.at(slice(self._own_count)), self._edges.only(self._inner)
        held = first_of_parts(edges.ends, self._own_count)
        fixed = self._fixed.copy()
        fixed[held] = True
        found = near_minimum(edges, own.poses, own.log_units, held, fixed, _LOCAL_STEPS)
        places.put(slice(self._own_count), Places(found.poses, found.log_units))

    def place(self, places: Places, placed: NDArray[np.bool_], bound: float | None) -> bool:
        """Move pieces that edges tie to ``placed`` poses to where these edges put them, and mark them; True if any was.

        With a ``bound`` on an edge's cost the edges vote first, and only those that agree with the winner count.
        """
        found = False
        while True:
            own, given, k = self._ties(places, placed)
            waiting = np.unique(self.label[own])
            if not len(waiting):
                return found
            # The piece with the most ties first: it may bring ties for the others.
            counts = [(self.label[own] == piece).sum() for piece in waiting]
            piece = waiting[int(np.argmax(counts))]
            use = self.label[own] == piece
            move, grown = self._transform(given.at(use), places.at(own[use]), k[use], bound)
            rows = np.flatnonzero(self.label == piece)
            places.put(rows, _carried(places.at(rows), move, grown))
            placed[rows] = True
            found = True

    def _ties(self, places: Places, placed: NDArray[np.bool_]) -> tuple[NDArray[np.intp], Places, NDArray[np.intp]]:
        """Edges from a piece without a place to a placed pose: rows of the own nodes, where the edge puts them, and the
        edges.
        """
        rows, poses, units, edges = [], [], [], []
        for side in range(2):
            mine, theirs = self._edges.ends[:, side], self._edges.ends[:, 1 - side]
            k = np.flatnonzero((mine < self._own_count) & ~placed[mine] & placed[theirs])
            step = self._edges.measured[k].copy() if side == 1 else se3_inverse(self._edges.measured[k])
            there = places.log_units[theirs[k]]
            here = there + self._edges.log_scale[k] * (1.0 if side == 1 else -1.0)
            # A translation is in the unit of the edge's first node.
            step[:, :3, 3] *= np.exp(there if side == 1 else here)[:, None]
            rows.append(mine[k])
            poses.append(places.poses[theirs[k]] @ step)
            units.append(here)
            edges.append(k)
        return np.concatenate(rows), Places(np.concatenate(poses), np.concatenate(units)), np.concatenate(edges)

    def _transform(self, given: Places, own: Places, k: NDArray[np.intp], bound: float | None) -> tuple[Array, float]:
        """The transform ``(4, 4)``, and logarithm of the scale, that bring ``own`` to ``given`` places best."""
        edges = self._edges
        kappa, tau = np.maximum(edges.kappa[k], 1e-12), np.maximum(edges.tau[k], 1e-12)
        tau = tau * np.exp(-2.0 * given.log_units)
        precision = np.where(self._fixed[: len(self.label)].all(), 0.0, np.maximum(edges.precision[k], 1e-12))
        if bound is not None and len(k) > 2:
            costs = _disagreement(given, own, kappa, tau, precision)
            # Own drift makes right edges disagree too: the bound widens until the winner has some company.
            company = max(3, -(-len(k) // 5))
            limit = max(bound, float(np.sort(costs, axis=1)[:, min(company, len(k)) - 1].min()))
            truncated = np.minimum(costs, limit).sum(axis=1)
            agree = costs[int(np.argmin(truncated))] <= limit
            given, own = given.at(agree), own.at(agree)
            kappa, tau, precision = kappa[agree], tau[agree], precision[agree]
        grown = 0.0
        if precision.any():
            grown = float((precision * (given.log_units - own.log_units)).sum() / precision.sum())
        turns = given.poses[:, :3, :3] @ np.swapaxes(own.poses[:, :3, :3], 1, 2)
        R = project_to_so3((kappa[:, None, None] * turns).sum(axis=0))
        shifts = given.poses[:, :3, 3] - np.exp(grown) * (own.poses[:, :3, 3] @ R.T)
        return se3(R, (tau[:, None] * shifts).sum(axis=0) / tau.sum()), grown


def _carried(places: Places, move: Array, grown: float) -> Places:
    """Places under the similarity of ``move`` ``(4, 4)`` and the scale whose logarithm is ``grown``."""
    poses = places.poses.copy()
    poses[:, :3, 3] *= np.exp(grown)
    return Places(move @ poses, places.log_units + grown)


def _disagreement(given: Places, own: Places, kappa: Array, tau: Array, precision: Array) -> Array:
    """``(n, n)``: cost of each edge (column) where the piece stands as one edge (row) alone puts it."""
    out = np.empty((len(kappa), len(kappa)))
    for row in range(len(kappa)):
        grown = float(given.log_units[row] - own.log_units[row]) if precision.any() else 0.0
        alone = _carried(own.at([row]), np.eye(4), grown)
        carried = _carried(own, given.poses[row] @ se3_inverse(alone.poses[0]), grown)
        turn = ((carried.poses - given.poses)[:, :3, :3] ** 2).sum(axis=(1, 2))
        shift = ((carried.poses - given.poses)[:, :3, 3] ** 2).sum(axis=1)
        out[row] = kappa * turn + tau * shift + precision * (carried.log_units - given.log_units) ** 2
    return out
