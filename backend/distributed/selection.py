"""Graduated non-convexity at one robot: weights of its loops and separators, in step with the whole group.

Both owners of a separator edge know both its poses from what was exchanged, bit for bit, so both find the same weight
and none needs to be sent. The schedule of ``mu`` starts from the group's largest residual, which comes down the tree.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array
from ..pose_graph.graph import EdgeKind
from ..robust import chi_square
from ..robust.schedule import first_mu, next_mu, tls_weight, truncation
from .local import LocalProblem
from .share import JudgedEdge

# The worst of so many right edges must not go.
_MANY = 1000


class Selection:
    """``weights`` ``(m,)`` of the robot's edges; of odometry and held priors always 1."""

    def __init__(self, problem: LocalProblem, confidence: float, noise: float) -> None:
        """``noise``: how many of the stated standard deviations one true one is."""
        self._problem = problem
        freedom = problem.width if problem.share.dimension == 3 else problem.width - 3
        self.bound = noise**2 * truncation(confidence, freedom)
        self._worst = noise**2 * chi_square.exceeded((1.0 - confidence) / _MANY, freedom)
        odometry = np.array([e.kind is EdgeKind.ODOMETRY for e in problem.share.edges], dtype=bool)
        self.odometry = np.append(odometry, problem.outside[len(odometry) :])
        self.weights = np.ones(len(self.odometry))
        self._open = ~self.odometry
        self._mu: float | None = None

    def squared(self) -> Array:
        """Squared residuals ``(m,)`` in standard deviations; NaN where an end has no pose yet."""
        places = self._problem.places
        return self._problem.edges.costs(places.poses, places.log_units)

    def begin_with(self, candidates: NDArray[np.bool_]) -> None:
        """Judge only ``candidates`` ``(m,)`` at first; what else is judged weighs nothing until :meth:`look_again`."""
        candidates = np.append(candidates, np.ones(len(self.odometry) - len(candidates), dtype=bool))
        self._open = candidates & ~self.odometry
        self.weights = np.where(candidates | self.odometry, 1.0, 0.0)

    def largest(self) -> float:
        """The largest squared residual of an edge that takes part."""
        return float(np.nan_to_num(self.squared()[self._open]).max(initial=0.0))

    def begin(self, largest: float) -> None:
        """Start the schedule from the group's ``largest`` squared residual."""
        self._mu = first_mu(largest, self.bound)
        self._weigh()

    def sharpen(self) -> float:
        """The schedule's next step; returns how undecided the least decided edge is (0 to 1/2)."""
        if self._mu is None:
            return 0.0
        self._mu = next_mu(self._mu)
        self._weigh()
        judged = self.weights[~self.odometry]
        return float(np.minimum(judged, 1.0 - judged).max(initial=0.0))

    def decide(self) -> None:
        """End the schedule: every edge is in or out."""
        self.weights = np.where(self.weights < 0.5, 0.0, 1.0)

    def look_again(self) -> float:
        """Test all judged edges in the residuals of the solution, as central selection does: those within the bound
        come back, those go that are too far even for the worst of many right ones. Returns how many changed.
        """
        squared, before = np.nan_to_num(self.squared(), nan=np.inf), self.weights
        back = (before < 0.5) & (squared <= self.bound)
        away = (before > 0.5) & (squared > self._worst)
        self.weights = np.where(self.odometry, 1.0, np.where(back, 1.0, np.where(away, 0.0, before)))
        return float((self.weights != before).sum())

    def cost(self) -> float:
        """The truncated cost of the edges this robot counts; what cannot be computed is left out."""
        squared = self.squared()
        squared = np.where(self.odometry, squared, np.minimum(squared, self.bound))[self._problem.counted]
        return float(squared[np.isfinite(squared)].sum())

    def judged(self) -> tuple[JudgedEdge, ...]:
        """The verdicts, in the order of the share's edges."""
        squared, edges = self.squared(), self._problem.share.edges
        return tuple(
            JudgedEdge(edges[k].i, edges[k].j, float(self.weights[k]), float(np.sqrt(squared[k])))
            for k in np.flatnonzero(~self.odometry)
        )

    def _weigh(self) -> None:
        if self._mu is None:
            return
        squared = np.nan_to_num(self.squared())
        self.weights = np.where(self._open, tls_weight(squared, self.bound, self._mu), self.weights)
