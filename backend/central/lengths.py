"""Lengths of odometry: one factor a robot, by which all its steps are too long or too short (a wrong baseline).

Steps that are all wrong by one share do not average out, as errors that differ from step to step do. So each robot has
a factor ``l`` near 1, with a deviation ``sigma`` before anything is known, and F of its steps becomes::

    kappa |R_j - R_i R_ij|_F^2 + tau |(t_j - t_i) / u_i - l R_i t_ij|^2,   and (l - 1)^2 / sigma^2 once a robot

Given the poses the best factors have a closed form (``factors`` below). Given the factors the poses are those of
stretched measurements, which any solver finds. Newton's method on the factors alone joins the two: its gradient is that
of F at the solved poses, its matrix the Schur complement, a row and a column a robot.

Loops tell how the robots' lengths stand to each other. What is common to all only the matches' own lengths could tell:
of maps made with the same odometry, and of errors that neighbouring matches share. Found from them it is another one
with each match more, and so is the size of the map. So the factors' mean stays 1: they are ``1 + B z``, the columns of
``B`` adding up to nothing. The prior alone asks for the same. One robot alone has none.

Factors that nothing calls for do harm: those of exact odometries are found up to the noise of a few matches, and
stretch maps that were right. So they are used only where the evidence (the marginal likelihood of ``z`` over that of
none, Laplace's approximation) is clear, with the deviations of the steps as large as the residuals say that they are,
and loops and separators fit what they state themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from ..geometry import Array, product, skew
from .at_minimum import AtMinimum, log_odds, refined
from .odometry_steps import OdometrySteps, measured_shifts, seen_shifts
from .similarity_edges import Descended, SimilarityEdges, descend
from .trust_region import newton

CLEAR = 2.0
"""Logarithm of the odds for factors from which on they are used; 2: seven to one."""
# Errors of odometry over the ways between loops over those stated, at least: they are no steps that are wrong each by
# itself. A heading that drifts evenly bends tracks as wrong lengths do (2.0 over 50 steps where no length was wrong).
_WANDERING = 2.5
# Noise of loops and separators over what they state, beyond which they tell nothing of lengths.
FITTING = 1.3


@dataclass(frozen=True, eq=False)
class Lengths:
    """``factors`` ``(count,)``, all 1 where they are not ``used``; ``doubt`` ``(count,)``: their deviations, what is
    common to all included; ``evidence``: logarithm of the odds for them; ``noise``: the steps' deviations over the
    stated ones as the residuals tell them, NaN where too little does, from ``freedom`` degrees."""

    used: bool
    factors: Array
    doubt: Array
    evidence: float
    noise: float
    freedom: float


def with_lengths(
    edges: SimilarityEdges,
    found: Descended,
    held: Sequence[int],
    kept: NDArray[np.bool_],
    steps: OdometrySteps,
    freedom: int,
) -> tuple[Descended, Lengths]:
    """Poses with the lengths of odometry among the unknowns; ``found`` as it is where these are not called for.

    ``found``: the minimum of F with the nodes ``held`` and the units ``kept`` ``(n,)``; ``freedom``: its degrees.
    """
    factors = np.ones(steps.count)
    if steps.count == 0:  # every unit of length is a robot's own
        return found, Lengths(False, factors, factors, 0.0, float("nan"), 0.0)
    at = _Linear(edges, found, held, kept, steps, factors)
    if freedom <= 0 or at.evidence(1.0) <= CLEAR:
        return found, Lengths(False, factors, at.doubt(), at.evidence(1.0), float("nan"), 0.0)
    factors, now, at = refined(
        at,
        factors,
        found,
        lambda values, best: minimum_from(steps.stretched(edges, values), best, held, kept),
        lambda values, best: _Linear(edges, best, held, kept, steps, values),
        steps.sigma,
    )
    noise, steps_freedom, others = at.noise(freedom)
    evidence = at.evidence(max(_WANDERING, noise, others) ** 2)
    # Matches that do not fit each other, as a liar's, are no evidence of lengths.
    used = evidence > CLEAR and others <= FITTING
    doubt = at.doubt()
    if not used:
        return found, Lengths(False, np.ones(steps.count), doubt, evidence, noise, steps_freedom)
    return replace(now, steps=found.steps + now.steps), Lengths(True, factors, doubt, evidence, noise, steps_freedom)


def minimum_from(edges: SimilarityEdges, found: Descended, held: Sequence[int], kept: NDArray[np.bool_]) -> Descended:
    """The minimum that the present poses lead to."""
    if kept.all():
        refined = newton(edges.ends, edges.measured, (edges.kappa, edges.tau), found.poses, held)
        return Descended(refined.poses, found.log_units, refined.steps)
    return descend(edges, found.poses, found.log_units, held, kept)


class _Linear:
    """F's second-order model in the factors, at poses that are best for them."""

    def __init__(
        self,
        edges: SimilarityEdges,
        found: Descended,
        held: Sequence[int],
        kept: NDArray[np.bool_],
        steps: OdometrySteps,
        factors: Array,
    ) -> None:
        self._steps, self._factors = steps, factors
        self._at = AtMinimum(steps.stretched(edges, factors), found, held, kept)
        n = len(found.poses)
        used = steps.robot >= 0
        raw, own = edges.only(used), self._at.edges.only(used)
        i, j = raw.ends.T
        turned, seen = measured_shifts(raw, found.poses), seen_shifts(raw, found.poses, found.log_units)
        shrink = np.exp(-found.log_units[i])[:, None]
        residual = seen - measured_shifts(own, found.poses)
        pull = raw.tau[:, None] * turned
        self._gradient = (factors - 1.0) / steps.sigma**2 - steps.sums(used, (pull * residual).sum(axis=1))
        curvature = steps.sums(used, (pull * turned).sum(axis=1))
        cross = np.zeros((n, 7))
        np.add.at(cross[:, :3], i, pull * shrink)
        np.add.at(cross[:, :3], j, -pull * shrink)
        lever = product(found.poses[i, :3, :3], skew(own.measured[:, :3, 3]))
        np.add.at(cross[:, 3:6], i, -np.einsum("mab,ma->mb", lever, pull))
        np.add.at(cross[:, 6], i, np.where(kept[i], 0.0, (pull * seen).sum(axis=1)))
        # Orthonormal columns that add up to nothing: factors move along these alone.
        self._apart = null_space(np.ones((1, steps.count)))
        explained = self._at.explained(cross[:, :, None], steps.robot_of(edges, n), steps.count)
        self._data = self._between(np.diag(curvature) - explained)
        self._matrix = self._data + np.eye(steps.count - 1) / steps.sigma**2

    def _between(self, matrix: Array) -> Array:
        """A matrix of the factors, for how they differ."""
        return np.asarray(self._apart.T @ matrix @ self._apart)

    def change(self) -> Array:
        """Newton's step of the factors ``(count,)``; their mean stays."""
        step = np.linalg.solve(self._matrix, self._apart.T @ self._gradient)
        return np.asarray(-self._apart @ step, dtype=np.float64)

    def doubt(self) -> Array:
        """Deviations of the factors ``(count,)``, with that of what is common to all."""
        between = self._apart @ np.linalg.inv(self._matrix) @ self._apart.T
        variance: Array = np.maximum(np.diag(between), 0.0) + self._steps.sigma**2 / self._steps.count
        return np.asarray(variance**0.5, dtype=np.float64)

    def evidence(self, noise: float) -> float:
        """Logarithm of the odds for factors of the stated deviation against none, with residuals of variance
        ``noise``."""
        wanted = self._matrix @ (self._apart.T @ (self._factors - 1.0)) - self._apart.T @ self._gradient
        return log_odds(self._data, wanted, self._steps.sigma, noise)

    def noise(self, freedom: int) -> tuple[float, float, float]:
        """See :meth:`AtMinimum.noise`."""
        return self._at.noise(self._steps.robot >= 0, freedom)
