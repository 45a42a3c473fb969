"""Odometry's steps, and what may be wrong with all of a robot's by one share: their length, and how they turn.

The ends ``i`` and ``j`` of a step that is ``d`` metres long, with a factor ``l`` of its length and a rate ``w`` (rad/m,
in j's frame), measure ``t_ij l`` and ``R_ij exp([w d])``. F depends on ``l`` by the translations alone and on ``w`` by
the rotations alone: given the poses the best of each has a closed form, whatever the other is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array, product, so3_exp, so3_log
from .similarity_edges import SimilarityEdges


@dataclass(frozen=True, eq=False)
class OdometrySteps:
    """Which edges are odometry whose length has a factor: ``robot`` ``(m,)``, the number of the factor, -1 where there
    is none; ``count`` factors of deviation ``sigma`` each; ``turning``: deviation of the rates at which they turn too
    much, each of three axes, rad/m; 0: they do not."""

    robot: NDArray[np.intp]
    count: int
    sigma: float
    turning: float = 0.0

    def factors(self, edges: SimilarityEdges, poses: Array, log_units: Array) -> Array:
        """The best ``(count,)`` for these poses: F is quadratic in them. Poses that are not known are NaN."""
        used = (self.robot >= 0) & np.isfinite(poses[edges.ends]).all(axis=(1, 2, 3))
        e, prior = edges.only(used), self.sigma**-2.0
        turned, seen = measured_shifts(e, poses), seen_shifts(e, poses, log_units)
        known = self.sums(used, e.tau * (turned * seen).sum(axis=1))
        return np.asarray((known + prior) / (self.sums(used, e.tau * (turned**2).sum(axis=1)) + prior))

    def stretched(self, edges: SimilarityEdges, factors: Array) -> SimilarityEdges:
        """The edges with each step multiplied by its robot's factor."""
        measured = edges.measured.copy()
        used = self.robot >= 0
        measured[used, :3, 3] *= factors[self.robot[used]][:, None]
        return replace(edges, measured=measured)

    def rates(self, edges: SimilarityEdges, poses: Array) -> Array:
        """The best ``(count, 3)`` for these poses, rad/m: F of turns that small is quadratic in them. Poses that are
        not known are NaN."""
        if not self.turning:
            return np.zeros((self.count, 3))
        used = (self.robot >= 0) & np.isfinite(poses[edges.ends]).all(axis=(1, 2, 3))
        e = edges.only(used)
        R, way = poses[e.ends, :3, :3], _way(e)
        turn = so3_log(np.swapaxes(R[:, 0] @ e.measured[:, :3, :3], 1, 2) @ R[:, 1])
        # |R exp([a]) - R|^2 is 2 |a|^2.
        pull = 2.0 * e.kappa * way
        pulled = np.stack([self.sums(used, pull * turn[:, axis]) for axis in range(3)], axis=1)
        return np.asarray(pulled / (self.sums(used, pull * way) + self.turning**-2.0)[:, None])

    def turned(self, edges: SimilarityEdges, rates: Array) -> SimilarityEdges:
        """The edges with each step turned by its robot's rate ``(count, 3)`` over its length."""
        used = self.robot >= 0
        if not rates.any():
            return edges
        measured = edges.measured.copy()
        turn = rates[self.robot[used]] * _way(edges.only(used))[:, None]
        measured[used, :3, :3] = measured[used, :3, :3] @ so3_exp(turn)
        return replace(edges, measured=measured)

    def fitting(self, edges: SimilarityEdges, poses: Array, log_units: Array) -> SimilarityEdges:
        """The edges with the factors and rates that suit these poses best. Poses that are not known are NaN."""
        factors = self.factors(edges, poses, log_units)
        return self.stretched(self.turned(edges, self.rates(edges, poses)), factors)

    def cost(self, edges: SimilarityEdges, poses: Array, log_units: Array) -> float:
        """F with the best factors and rates for these poses, and what they cost themselves."""
        factors = self.factors(edges, poses, log_units)
        own = float((((factors - 1.0) / self.sigma) ** 2).sum())
        if self.turning:
            own += float(((self.rates(edges, poses) / self.turning) ** 2).sum())
        return float(self.fitting(edges, poses, log_units).costs(poses, log_units).sum()) + own

    def robot_of(self, edges: SimilarityEdges, nodes: int) -> NDArray[np.intp]:
        """The number of each node's factor ``(nodes,)`` by the steps that it has, -1 where it has none."""
        out = np.full(nodes, -1, dtype=np.intp)
        used = self.robot >= 0
        out[edges.ends[used]] = self.robot[used][:, None]
        return out

    def sums(self, used: NDArray[np.bool_], values: Array) -> Array:
        """Of ``values``, one for each edge ``used``, by robot ``(count,)``."""
        return np.bincount(self.robot[used], values, minlength=self.count).astype(np.float64)


def steps_of(
    ends: NDArray[np.intp], robot_of: NDArray[np.intp], count: int, sigma: float, turning: float = 0.0
) -> OdometrySteps:
    """Of nodes in order, those of one robot one after the other: an edge from a node to the one beside it is a step.
    ``robot_of`` ``(n,)``: the number of each node's factor, -1 where it has none (as robots with units of their own).
    """
    i, j = ends.T
    step = (np.abs(i - j) == 1) & (robot_of[i] == robot_of[j])
    if sigma <= 0:
        return OdometrySteps(np.where(step, robot_of[i], -1), 0, 1.0)
    return OdometrySteps(np.where(step, robot_of[i], -1), count, sigma, turning)


def measured_shifts(edges: SimilarityEdges, poses: Array) -> Array:
    """``R_i t_ij`` ``(m, 3)``."""
    return product(poses[edges.ends[:, 0], :3, :3], edges.measured[:, :3, 3, None])[..., 0]


def seen_shifts(edges: SimilarityEdges, poses: Array, log_units: Array) -> Array:
    """``(t_j - t_i) / u_i`` ``(m, 3)``."""
    i, j = edges.ends.T
    return np.asarray((poses[j, :3, 3] - poses[i, :3, 3]) * np.exp(-log_units[i])[:, None])


def _way(edges: SimilarityEdges) -> Array:
    """Lengths ``(m,)`` of what the edges measure, metres."""
    return np.asarray(np.linalg.norm(edges.measured[:, :3, 3], axis=1))
