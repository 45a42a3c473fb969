"""Headings of odometry: a rate a robot at which all its steps turn too much, in radians a metre about each axis.

A camera that is slightly off its calibration turns odometry's path evenly, which errors that differ from step to step
do not explain: they grow with the root of the way, this with the way. So F of a robot's steps becomes::

    kappa |R_j - R_i R_ij exp([w d_ij])|_F^2, and |w|^2 / turning^2 once a robot

with the length ``d_ij`` of a step. Loops tell what is common to all robots as well. As with lengths (``lengths.py``)
Newton's method on the rates alone joins them with the poses, and they are used only where the evidence is clear and
loops and separators fit what they state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array, product
from .at_minimum import AtMinimum, log_odds, refined
from .lengths import CLEAR, FITTING, Lengths, minimum_from, with_lengths
from .linear import turn_derivatives
from .odometry_steps import OdometrySteps
from .similarity_edges import Descended, SimilarityEdges


@dataclass(frozen=True, eq=False)
class Headings:
    """``rates`` ``(count, 3)``, rad/m in the frame of a step's end, all 0 where they are not ``used``; ``evidence``:
    logarithm of the odds for them."""

    used: bool
    rates: Array
    evidence: float


@dataclass(frozen=True, eq=False)
class CorrectedOdometry:
    """The minimum ``found``, the ``lengths`` and ``headings`` that it is of, and the ``edges`` corrected by them."""

    found: Descended
    edges: SimilarityEdges
    lengths: Lengths
    headings: Headings


def with_corrections(
    edges: SimilarityEdges,
    found: Descended,
    held: Sequence[int],
    kept: NDArray[np.bool_],
    steps: OdometrySteps,
    freedom: int,
) -> CorrectedOdometry:
    """Lengths, headings where ``steps`` have any, then lengths once more; ``found`` as it is where none is called for.

    ``found``: the minimum of F with the nodes ``held`` and the units ``kept`` ``(n,)``; ``freedom``: its degrees.
    """
    found, lengths = with_lengths(edges, found, held, kept, steps, freedom)
    stretched = steps.stretched(edges, lengths.factors)
    none = Headings(False, np.zeros((steps.count, 3)), 0.0)
    if steps.count == 0 or steps.turning <= 0 or freedom <= 0:
        return CorrectedOdometry(found, stretched, lengths, none)
    better, headings = _with_headings(stretched, found, held, kept, steps, freedom)
    if not headings.used:
        return CorrectedOdometry(found, stretched, lengths, headings)
    # Lengths were found on tracks that were bent.
    turned = steps.turned(edges, headings.rates)
    straight, again = with_lengths(turned, minimum_from(turned, better, held, kept), held, kept, steps, freedom)
    taken = replace(straight, steps=better.steps + straight.steps)
    return CorrectedOdometry(taken, steps.stretched(turned, again.factors), again, headings)


def _with_headings(
    edges: SimilarityEdges,
    found: Descended,
    held: Sequence[int],
    kept: NDArray[np.bool_],
    steps: OdometrySteps,
    freedom: int,
) -> tuple[Descended, Headings]:
    rates = np.zeros((steps.count, 3))
    at = _InRates(edges, found, held, kept, steps, rates)
    if at.evidence(1.0) <= CLEAR:
        return found, Headings(False, rates, at.evidence(1.0))
    rates, now, at = refined(
        at,
        rates,
        found,
        lambda values, best: minimum_from(steps.turned(edges, values), best, held, kept),
        lambda values, best: _InRates(edges, best, held, kept, steps, values),
        steps.turning,
    )
    noise, _, others = at.noise(freedom)
    evidence = at.evidence(float(np.nanmax([1.0, noise, others])) ** 2)
    if evidence <= CLEAR or others > FITTING:
        return found, Headings(False, np.zeros_like(rates), evidence)
    return replace(now, steps=found.steps + now.steps), Headings(True, rates, evidence)


class _InRates:
    """F's second-order model in the rates, at poses that are best for them."""

    def __init__(
        self,
        edges: SimilarityEdges,
        found: Descended,
        held: Sequence[int],
        kept: NDArray[np.bool_],
        steps: OdometrySteps,
        rates: Array,
    ) -> None:
        self._steps, self._rates = steps, rates.ravel()
        self._at = AtMinimum(steps.turned(edges, rates), found, held, kept)
        used = steps.robot >= 0
        own, n = self._at.edges.only(used), len(found.poses)
        i, j = own.ends.T
        R, way = found.poses[:, :3, :3], np.linalg.norm(own.measured[:, :3, 3], axis=1)
        R_ij = own.measured[:, :3, :3]
        by_i, by_j = turn_derivatives(R[i], R[j], R_ij)
        # A step that turns by more stands to its end as the end does where it turns the other way.
        by_rate = -way[:, None, None] * turn_derivatives(R[i], product(R[i], R_ij), R_ij)[1]
        residual = (R[j] - product(R[i], R_ij)).reshape(-1, 9, 1)
        pull = own.kappa[:, None, None] * by_rate
        pulled = (np.swapaxes(pull, 1, 2) @ residual)[:, :, 0]
        gradient = np.stack([steps.sums(used, pulled[:, axis]) for axis in range(3)], axis=1)
        self._gradient = (gradient + rates / steps.turning**2).ravel()
        curvature = np.repeat(steps.sums(used, 2.0 * own.kappa * way**2), 3)
        cross = np.zeros((n, 7, 3))
        np.add.at(cross[:, 3:6], i, np.swapaxes(by_i, 1, 2) @ pull)
        np.add.at(cross[:, 3:6], j, np.swapaxes(by_j, 1, 2) @ pull)
        self._data = np.diag(curvature) - self._at.explained(cross, steps.robot_of(edges, n), steps.count)
        self._matrix = self._data + np.eye(3 * steps.count) / steps.turning**2

    def change(self) -> Array:
        """Newton's step of the rates ``(count, 3)``."""
        step = np.linalg.solve(self._matrix, self._gradient)
        return np.asarray(-step.reshape(-1, 3), dtype=np.float64)

    def evidence(self, noise: float) -> float:
        """Logarithm of the odds for rates of the stated deviation against none, with residuals of variance
        ``noise``."""
        return log_odds(self._data, self._matrix @ self._rates - self._gradient, self._steps.turning, noise)

    def noise(self, freedom: int) -> tuple[float, float, float]:
        """See :meth:`AtMinimum.noise`."""
        return self._at.noise(self._steps.robot >= 0, freedom)
