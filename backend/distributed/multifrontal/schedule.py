"""What the anchor decides after each pass: which problem is next, and when it is enough."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...config import SolverConfig
from .equations import Matrices, StepFrom, Unknowns
from .memory import best_weights
from .reports import Sums

# Passes over which poses move, at most; halvings of one step; returns to the best.
_MOST_PASSES, _MOST_HALVINGS, _MOST_RETURNS = 60, 6, 4
# Passes that a new matrix takes to the end; a fall of the cost that makes a matrix of the same kind another one.
_WITH_A_MATRIX, _MOVED = 3.0, 0.01
# With more than this share of the cost to gain the exact second derivative leads astray; with more than that, any old
# matrix.
_FAR, _VERY_FAR = 0.01, 1.0
# Rate at which old matrices are thought to come closer at least: the logarithm of what is left to gain, a pass.
_SLOWEST = 0.15
# F counts squared standard deviations: a smaller fall matters to nobody.
_NOTHING = 1e-9
# A rise of the cost by less than this share is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True)
class Decided:
    """See :class:`~maslam.backend.distributed.multifrontal.reports.Step`; ``problem`` None: the end."""

    problem: Unknowns | None
    matrices: Matrices = Matrices.GAUSS_NEWTON
    place: StepFrom = StepFrom.FURTHER
    weights: tuple[float, ...] = ()
    capped: bool = False


class Schedule:
    """Linear problems, then steps until the next would lower the cost by less than ``cost_tolerance`` of it.

    A matrix is used again as long as what it saves to make a new one is more than the passes that a new one would save.
    Steps that raise the cost twice in a row are taken back.
    """

    def __init__(self, config: SolverConfig, scaled: bool, warm: bool) -> None:
        self._tolerance = config.cost_tolerance
        self.first = Unknowns.KNOWN if warm else Unknowns.ROTATION
        self._scaled = scaled
        self.start = self.best = np.inf
        """The cost before the first step, and the lowest so far."""
        self._gains: list[float] = []
        self._made, self._kind = np.inf, Matrices.GAUSS_NEWTON
        self._raised = self._halvings = self._returns = self._passes = 0

    def after(self, problem: Unknowns, sums: Sums) -> Decided:
        """The decision; ``sums`` over all robots."""
        match problem:
            case Unknowns.ROTATION:
                return Decided(Unknowns.UNIT if self._scaled else Unknowns.POSITION)
            case Unknowns.UNIT:
                return Decided(Unknowns.POSITION)
            case Unknowns.KNOWN | Unknowns.POSITION:
                return Decided(Unknowns.POSE)
        self._passes += 1
        if self._passes == 1:
            self.start = sums.cost
        weights, gained = best_weights(sums.products)
        if sums.cost > self.best * (1.0 + _ROUNDING):
            return self._raised_to(sums, weights, sums.cost - gained)
        self.best = sums.cost
        self._raised = self._halvings = 0
        near = sums.gain <= self._tolerance * sums.cost + _NOTHING
        if near or self._passes >= _MOST_PASSES:
            return Decided(None, place=StepFrom.BEST_AND_FURTHER, capped=not near)
        self._gains.append(sums.gain)
        if sums.gain > _VERY_FAR * sums.cost or self._worth_a_matrix(sums):
            return Decided(Unknowns.POSE, self._anew(sums), StepFrom.BEST_AND_FURTHER, weights)
        return Decided(Unknowns.POSE, Matrices.OLD, StepFrom.BEST_AND_FURTHER, weights)

    def _raised_to(self, sums: Sums, weights: tuple[float, ...], mixed: float) -> Decided:
        """The last step led uphill."""
        self._raised += 1
        near = sums.gain <= self._tolerance * sums.cost and sums.cost <= self.best * (1.0 + self._tolerance)
        if near or self._passes >= _MOST_PASSES or self._returns >= _MOST_RETURNS:
            return Decided(None, place=StepFrom.BEST, capped=not near)
        # The same matrices where it was best lead to the same step: after a return it is too long.
        if weights and self._raised == 1 and mixed < self.best and not self._returns:
            return Decided(Unknowns.POSE, Matrices.OLD, StepFrom.FURTHER, weights)
        if (self._returns or not sums.products) and self._halvings < _MOST_HALVINGS:
            self._halvings += 1
            return Decided(Unknowns.POSE, Matrices.OLD, StepFrom.HALFWAY)
        self._returns += 1
        return Decided(Unknowns.POSE, self._anew(sums), StepFrom.BEST)

    def _anew(self, sums: Sums) -> Matrices:
        """Which matrices to make."""
        self._made, self._kind = self.best, self._next_kind(sums)
        self._gains.clear()
        return self._kind

    def _next_kind(self, sums: Sums) -> Matrices:
        return Matrices.GAUSS_NEWTON if sums.gain > _FAR * sums.cost else Matrices.EXACT

    def _worth_a_matrix(self, sums: Sums) -> bool:
        """Whether the passes that it would save are more bytes than new matrices."""
        kind = self._next_kind(sums)
        same = self._kind is kind or (self._scaled and kind is Matrices.EXACT)
        if len(self._gains) < 2 or (same and self._made - sums.cost < _MOVED * sums.cost):
            return False
        enough = self._tolerance * sums.cost + _NOTHING
        rate = max(np.log(self._gains[0] / self._gains[-1]) / (len(self._gains) - 1), _SLOWEST)
        to_come = np.log(sums.gain / enough) / rate
        return bool((to_come - _WITH_A_MATRIX) * sums.others > sums.matrices)

    def grid(self, sums: Sums, width: int, fineness: float) -> tuple[float, float]:
        """Sizes of whole steps, metres and radians, of which ``fineness`` are a standard deviation of the residuals."""
        freedom = width * (sums.freedom + 1)
        noise = float(np.clip(np.sqrt(sums.cost / freedom), 1e-4, 1.0)) if freedom > 0 else 1.0
        sizes = noise / fineness / np.sqrt([max(sums.tau, 1e-12), max(2.0 * sums.kappa, 1e-12)])
        return float(np.float32(sizes[0])), float(np.float32(sizes[1]))
