"""Where the priors' frame lies among the poses of a group, from sums that all members add up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...central.origin import OriginPriors, kernel
from ...geometry import Array, Sim3, project_to_so3
from ..places import Places

# Turns and units of length are found in turns.
_TURNS = 5
COUNT = 31
"""Numbers of :class:`AlignmentSums`."""


@dataclass(frozen=True, eq=False)
class AlignmentSums:
    """Sums over priors, weighted: ``numbers`` ``(31,)``. ``cost``: their share of F where their frame is thought to
    be; ``priors``: how many there are, ``turning`` of which tell a rotation."""

    numbers: Array

    @property
    def cost(self) -> float:
        """See the class."""
        return float(self.numbers[28])

    @property
    def turning(self) -> int:
        """See the class."""
        return int(self.numbers[29])

    @property
    def priors(self) -> int:
        """See the class."""
        return int(self.numbers[30])


def sums_of(priors: OriginPriors, places: Places, origin: Sim3 | None, widen: float) -> AlignmentSums:
    """Of one robot's priors with their nodes at ``places`` ``(m,)``; kernels count from the ``origin``'s place, and are
    ``widen`` times as wide as stated."""
    points, wanted = priors.points(places.poses, places.log_units), priors.measured[:, :3, 3]
    weight, cost = np.ones(len(priors)), 0.0
    if origin is not None:
        residual = priors.residuals(places.poses, places.log_units, origin)
        weight, cost = kernel(residual, priors.bound * widen), priors.cost(residual)
    tau, kappa = priors.tau * weight, priors.kappa * weight
    turns = np.einsum("m,mij,mkj->ik", kappa, places.poses[:, :3, :3], priors.measured[:, :3, :3])
    numbers = [
        [tau.sum()],
        tau @ points,
        tau @ wanted,
        np.einsum("m,mi,mj->ij", tau, points, wanted).ravel(),
        turns.ravel(),
        [tau @ (points**2).sum(axis=1), tau @ (wanted**2).sum(axis=1), kappa.sum()],
        [cost, priors.turning.sum(), len(priors)],
    ]
    return AlignmentSums(np.concatenate([np.asarray(n, dtype=np.float64) for n in numbers]))


def origin_from(sums: AlignmentSums, free_unit: bool, dimension: int) -> Sim3:
    """The place of their frame for which the weighted squares are least; ``free_unit``: with its unit of length."""
    n = sums.numbers
    total = max(float(n[0]), np.finfo(np.float64).tiny)
    mean_p, mean_q = n[1:4] / total, n[4:7] / total
    cross = n[7:16].reshape(3, 3) - total * np.outer(mean_p, mean_q)
    spread_p, spread_q = n[25] - total * mean_p @ mean_p, n[26] - total * mean_q @ mean_q
    shrink = float(np.sqrt(spread_q / spread_p)) if free_unit and spread_p > 0 and spread_q > 0 else 1.0
    rotation = np.eye(3)
    for _ in range(_TURNS if free_unit else 1):
        rotation = _nearest_rotation(n[16:25].reshape(3, 3) + shrink * cross, dimension)
        if free_unit and spread_p > 0:
            shrink = max(float((rotation * cross).sum()) / spread_p, 1e-3 * shrink)
    return Sim3(rotation, mean_p - rotation @ mean_q / shrink, 1.0 / shrink)


def _nearest_rotation(matrix: Array, dimension: int) -> Array:
    """In the plane about its normal only: points on a line tell nothing of the other axes."""
    if dimension == 3:
        return np.asarray(project_to_so3(matrix[None])[0])
    angle = np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
