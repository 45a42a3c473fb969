"""Priors at places that stay: what a robot's equations have of them once their frame has a place among the poses.

Each prior is an edge between its node and a row of its own that never moves, so any method solves with it as with an
edge to a neighbour that stands still. Where every robot has its priors so, they hold the group, and no node is given.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..central.origin import OriginPriors
from ..central.similarity_edges import SimilarityEdges
from ..geometry import Sim3, se3
from .places import Places

NO_SCALE = 1e-12
"""Precision of a prior's log scale: it measures none."""


@dataclass(frozen=True, eq=False)
class HeldPriors:
    """``priors`` of own nodes, weights of their kernels multiplied in; ``origin``: the place of their frame among the
    group's poses, its scale the size of their unit of length there."""

    priors: OriginPriors
    origin: Sim3

    def __len__(self) -> int:
        return len(self.priors)

    @property
    def places(self) -> Places:
        """Where nodes would stand that agree with their priors ``(m,)``, a lever aside."""
        poses = self.origin.transform_poses(self.priors.measured)
        return Places(poses, np.full(len(self), np.log(self.origin.scale)))

    def edges(self, rows: NDArray[np.intp], first: int, own: Places, scaled: bool) -> SimilarityEdges:
        """Edges between own ``rows`` ``(m,)`` and the rows from ``first`` on, which stay at :attr:`places`.

        The lever turns with its node where units are none; else (``scaled``) it is turned as ``own`` ``(m,)`` nodes
        stand now.
        """
        p, m = self.priors, len(self)
        there = np.arange(first, first + m, dtype=np.intp)
        nothing, turn = np.zeros(m), np.tile(np.eye(3), (m, 1, 1))
        if not scaled:
            ends = np.column_stack([rows, there])
            return SimilarityEdges(ends, se3(turn, p.lever), nothing, p.kappa, p.tau, np.full(m, NO_SCALE))
        places = self.places
        arm = np.einsum("mij,mj->mi", own.poses[:, :3, :3], p.lever) * np.exp(own.log_units - places.log_units)[:, None]
        back = -np.einsum("mji,mj->mi", places.poses[:, :3, :3], arm)
        ends = np.column_stack([there, rows])
        return SimilarityEdges(ends, se3(turn, back), nothing, p.kappa, p.tau, np.full(m, NO_SCALE))
