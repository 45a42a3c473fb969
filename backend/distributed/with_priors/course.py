"""What the root of the members decides between runs: where the priors' frame lies, how wide kernels are, the end."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from ...central.origin import places_a_part
from ...errors import BackendError
from ...geometry import Array, Sim3
from ..compact import numbers_of, poses_of
from ..share import Share, SolverOutcome
from .alignment import COUNT, AlignmentSums, origin_from

# Each time kernels get narrower, down to as wide as stated; rounds of the frame alone, and runs, at most; at first
# kernels count all alike.
_NARROWER, _MOST_ROUNDS, _MOST_RUNS = 2.0, 30, 14
_WIDEST = 1e9
# A smaller fall of the cost, as a share of it, ends the rounds of the frame alone, and the runs.
_ROUGHLY, _ENOUGH = 1e-3, 1e-5


class WhatNext(IntEnum):
    """What members do next: tell their sums with the priors' frame at another place; solve without priors, roughly or
    to the end; solve with them held; end with what was found without; end."""

    ALIGN = 0
    ROUGHLY = 1
    ALONE = 2
    RUN = 3
    END_WITHOUT = 4
    END = 5

    @property
    def without(self) -> bool:
        """Whether a run without priors follows."""
        return self in (WhatNext.ROUGHLY, WhatNext.ALONE)


@dataclass(frozen=True, eq=False)
class PriorSums:
    """What goes up the tree: the robot's own part, or the sum over it and those below it.

    ``sums`` of the alignment; ``before`` and ``after``: what priors held cost in the method's eyes before the last run
    and after it; ``first``, ``now`` ``(7,)``: the anchor's first node at the start and now, of all others 0.
    ``largest``: residual over its kernel's bound, the largest of all.
    """

    sums: AlignmentSums
    before: float
    after: float
    first: Array
    now: Array
    largest: float

    def numbers(self) -> Array:
        """All of them in a row."""
        return np.concatenate([self.sums.numbers, [self.before, self.after], self.first, self.now, [self.largest]])

    @classmethod
    def of(cls, numbers: Array) -> PriorSums:
        """Inverse of :meth:`numbers`."""
        if len(numbers) != COUNT + 17:
            raise BackendError(f"{len(numbers)} sums of priors, not {COUNT + 17}")
        n = numbers[COUNT:]
        return cls(AlignmentSums(numbers[:COUNT]), float(n[0]), float(n[1]), n[2:9], n[9:16], float(n[16]))

    def also(self, other: PriorSums) -> PriorSums:
        """These and another robot's."""
        numbers = self.numbers() + other.numbers()
        numbers[-1] = max(self.largest, other.largest)
        return PriorSums.of(numbers)


@dataclass(frozen=True, eq=False)
class Next:
    """``origin``: where the priors' frame lies, with ``END`` how all poses are to move, so that the anchor's first node
    is where it was; ``widen``: kernels over the stated bounds; costs: of the end."""

    then: WhatNext
    origin: Sim3 = field(default_factory=Sim3.identity)
    widen: float = 1.0
    cost_before: float = 0.0
    cost_after: float = 0.0

    def numbers(self) -> Array:
        """All of it in a row."""
        place = [*numbers_of(self.origin.se3()), np.log(self.origin.scale)]
        return np.array([float(self.then), *place, self.widen, self.cost_before, self.cost_after])

    @classmethod
    def of(cls, numbers: Array) -> Next:
        """Inverse of :meth:`numbers`."""
        if len(numbers) != 11 or numbers[0] not in tuple(WhatNext) or abs(numbers[7]) > 50.0 or numbers[8] < 1.0:
            raise BackendError("a robot that solves with priors was sent no decision")
        return cls(WhatNext(int(numbers[0])), _place(numbers[1:8]), *numbers[8:].tolist())


class Course:
    """Without an estimate in one frame: solve without priors, lay the result on them, solve with them. Else the
    solution begins with them. Kernels begin as wide as residuals are, and get narrower from run to run."""

    def __init__(self, share: Share, warm: bool, selects: bool) -> None:
        """``selects``: runs judge edges, for which rough ones are too rough."""
        self._warm, self._dimension = warm, share.dimension
        self._first = WhatNext.ALONE if selects else WhatNext.ROUGHLY
        self._free_unit = set(share.members) <= share.arbitrary_scale
        self._relinearised = share.scaled
        self._stage = WhatNext.ALIGN
        self._before: float | None = None
        self._plain: SolverOutcome | None = None
        self._origin: Sim3 | None = None
        self._widen, self._rounds, self._runs = _WIDEST, 0, 0
        self._cost, self._aside = np.inf, 0.0

    def after(self, tally: PriorSums, outcome: SolverOutcome | None) -> Next:
        """The decision; ``tally`` by all; ``outcome`` of the last run, if there was one."""
        if outcome is not None and not np.isfinite([outcome.cost_before, outcome.cost_after]).all():
            return Next(WhatNext.END_WITHOUT)
        if self._stage is WhatNext.RUN:
            assert outcome is not None
            return self._after_run(tally, outcome)
        self._plain = outcome
        placed = places_a_part(tally.sums.turning, tally.sums.priors)
        if placed and not self._aligned(tally):
            assert self._origin is not None
            return Next(WhatNext.ALIGN, self._origin, self._widen)
        if self._stage is WhatNext.ALIGN:
            self._before = tally.sums.cost if placed else 0.0
            if self._warm and placed:
                return self._run(tally.largest)
            return self._without(self._first if placed else WhatNext.ALONE)
        if placed:
            return self._run(tally.largest)
        # What is tied to the anchor has too few priors after all.
        return self._without(WhatNext.ALONE) if self._stage is WhatNext.ROUGHLY else Next(WhatNext.END_WITHOUT)

    def _without(self, then: WhatNext) -> Next:
        self._stage, self._origin, self._widen, self._rounds = then, None, _WIDEST, 0
        return Next(then)

    def _aligned(self, tally: PriorSums) -> bool:
        """Whether the frame's place is good enough to begin; else it is where the sums say."""
        self._rounds += 1
        first, cost = self._origin is None, tally.sums.cost
        if not first:
            far = self._stage is WhatNext.ALIGN and not self._warm
            settled = self._widen == 1.0 and cost > (1.0 - _ROUGHLY) * self._cost
            if tally.largest == 0.0 or far or settled or self._rounds > _MOST_ROUNDS:
                self._cost = np.inf
                return True
            self._cost = cost if self._widen == 1.0 else np.inf
            wide = tally.largest if self._widen == _WIDEST else self._widen / _NARROWER
            self._widen = max(1.0, wide)
        self._origin = origin_from(tally.sums, self._free_unit, self._dimension)
        return False

    def _run(self, largest: float) -> Next:
        self._stage, self._widen, self._cost = WhatNext.RUN, max(1.0, largest), np.inf
        assert self._origin is not None
        return Next(WhatNext.RUN, self._origin, self._widen)

    def _after_run(self, tally: PriorSums, outcome: SolverOutcome) -> Next:
        assert self._origin is not None and self._before is not None
        self._runs += 1
        if self._runs == 1:
            edges = outcome.cost_before - tally.before
            if self._plain is None:
                self._before += edges
            else:
                # Edges of what is tied to nothing count, too, as they stand.
                self._before += self._plain.cost_before
                self._aside = self._plain.cost_after - edges
        cost = outcome.cost_after - tally.after + tally.sums.cost + self._aside
        last, fell = self._widen == 1.0, self._cost - cost
        self._cost = cost
        again = tally.largest > 0.0 or self._relinearised
        if not again or (last and fell <= _ENOUGH * cost) or self._runs >= _MOST_RUNS:
            first, now = _place(tally.first), _place(tally.now)
            return Next(WhatNext.END, first @ now.inverse(), 1.0, self._before, cost)
        self._widen = 1.0 if self._runs >= _MOST_RUNS - 3 else max(1.0, self._widen / _NARROWER)
        return Next(WhatNext.RUN, self._origin, self._widen)


def _place(numbers: Array) -> Sim3:
    pose = poses_of(numbers[None, :6])[0]
    return Sim3(pose[:3, :3], pose[:3, 3], float(np.exp(numbers[6])))
