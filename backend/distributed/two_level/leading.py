"""The root's part: the coarse level's step, the mix of earlier moves, and when to end."""

from __future__ import annotations

import numpy as np

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader
from ..share import Share
from .answers import CoarseAnswer, Then, differences
from .coarse_level import CoarseLevel
from .coded_places import by_number
from .forces import read_forces
from .grounds import read_grounds
from .springs import Knots, Springs, needed, read_knots, read_springs

# Steps of the coarse level over the deviation of what is left to gain, a number of a shared pose.
_FINENESS = 0.25
# Times that a move is halved after which F is higher.
_HALVINGS = 8
# A sweep of which the mix takes less than this: the coarse level is that of another place.
_USELESS = 0.3
# Turns beyond this, rad, are not small: the move is cut.
_MOST_TURN = 0.25
# What is left to gain over what the coarse level alone would; and the least share of it that a sweep leaves.
_LEFT, _KEPT = 4.0, 0.001
# F counts squared standard deviations: a smaller fall matters to nobody.
_NOTHING = 1e-9
# Sweeps in a row that are of no use and lower the cost by less than this share: it leads nowhere.
_HARDLY, _PATIENCE = 0.03, 8
# Of one sweep's fall of F to the one's before, in judging what is left: it may get slower yet.
_LEAST_RATIO, _MOST_RATIO = 0.6, 0.9


class Leading:
    """What the root, whose ``share`` it is, gathers and decides; ``width``: numbers of a move."""

    def __init__(self, share: Share, width: int, tolerance: float, most: int) -> None:
        self._members, self._width = share.members, width
        self._fixed, self._grounded = frozenset(share.members) - share.arbitrary_scale, share.held is not None
        self._tolerance, self._most = tolerance, most
        self._knots: dict[int, Knots] = {}
        self._springs: list[Springs] = []
        self._grounds: dict[int, Array] = {}
        self._held: tuple[int, int] | None = None
        self._forces: dict[int, tuple[float, Array]] = {}
        self._sums: list[tuple[float, ...]] = []
        self._level: CoarseLevel | None = None
        self._asked: dict[int, list[tuple[int, int]]] = {}
        self._costs: list[float] = []
        self._gain = 0.0
        self._halvings = self._sweeps = 0
        self._stale = self._alone = False
        self._turn = 0.0
        self._left, self._stuck = 0.0, 0

    def take_part(self, robot: int, body: bytes) -> None:
        """A member's knots and springs."""
        source = CompactReader(body)
        held = source.count()
        self._knots[robot] = read_knots(source, self._width)
        self._springs.append(read_springs(source, robot, self._members))
        if self._grounded:
            knots = self._knots[robot]
            self._grounds[robot] = read_grounds(source, len(knots.centres), knots.sigmas, self._width)
        if not source.empty:
            raise BackendError(f"robot {robot} sent more than its part of the coarse level")
        if held:
            self._held = (robot, held - 1)

    def take_forces(self, robot: int, body: bytes) -> None:
        """A member's cost and forces."""
        self._forces[robot] = read_forces(body, self._knots[robot].centres, self._knots[robot].sigmas, self._width)

    def take_sums(self, sums: tuple[float, ...]) -> None:
        """A member's part of the sums over edges."""
        if not sums or (self._sums and len(self._sums[0]) != len(sums) - 1):
            raise BackendError("members sent sums of different lengths")
        self._sums.append(sums[:-1])
        self._turn = max(self._turn, sums[-1])

    def answers(self) -> dict[int, CoarseAnswer]:
        """For each member what it does next, from all costs and forces."""
        cost = sum(self._forces[r][0] for r in self._members)
        # The level is new, and the cost is not.
        then, capped = (Then.SWEEP, False) if self._level is None and self._costs else self._next(cost)
        if then is not Then.SWEEP:
            self._forces.clear()
            return dict.fromkeys(self._members, CoarseAnswer(then, capped))
        # First a sweep alone takes away what no common move can; then the level begins anew.
        alone = self._stale and not self._alone
        if self._stale and self._alone:
            self._alone = False
            self._knots, self._springs, self._level, self._stale = {}, [], None, False
            self._forces.clear()
            return dict.fromkeys(self._members, CoarseAnswer(Then.AGAIN))
        fresh = self._level is None
        if self._level is None:
            self._level = CoarseLevel(self._knots, self._springs, self._grounds, self._width, self._held, self._fixed)
            self._asked = needed(self._springs)
        level = self._level
        middle = np.median([self._knots[r].sigmas for r in self._members], axis=0)
        sigmas = np.asarray(middle.astype(np.float32), dtype=np.float64)
        unit = by_number(sigmas, self._width)
        order = sorted(self._members)
        forces = np.concatenate([self._forces[r][1] for r in order])
        moves = level.step(forces)
        self._left = float((forces * moves).sum())
        self._alone = alone
        if alone:
            moves = np.zeros(moves.shape)
        self._gain = self._left if fresh else min(self._gain, max(_LEFT * self._left, _KEPT * self._gain))
        shared = max(1, sum(k.shared for k in self._knots.values()))
        grid = float(np.float32(_FINENESS * np.sqrt(max(self._gain, _NOTHING) / (6 * shared))))
        steps = np.rint(moves / (grid * unit)).astype(np.int64)
        lever = float(unit[3] / unit[0])
        first = None if self._sweeps else sigmas
        out = {}
        for r in self._members:
            rows = [level.start[r] + k for k in range(level.count[r])]
            rows += [level.start[other] + k for other, k in self._asked.get(r, [])]
            coded = differences(steps[rows], level.centres[rows], lever)
            out[r] = CoarseAnswer(then, False, grid, first, coded)
        self._forces.clear()
        self._sweeps += 1
        return out

    def weights(self) -> tuple[float, ...]:
        """Of the new move and the last ones, such that the model of F falls most."""
        total = np.array(self._sums).sum(axis=0)
        self._sums.clear()
        k = int((np.sqrt(9 + 8 * len(total)) - 3) / 2)
        if k * (k + 1) // 2 + k != len(total) or k < 1:
            raise BackendError(f"{len(total)} sums fit no number of moves")
        matrix = np.zeros((k, k))
        matrix[np.triu_indices(k)] = total[:-k]
        matrix = np.triu(matrix) + np.triu(matrix, 1).T
        size = np.sqrt(np.maximum(np.diagonal(matrix), np.finfo(np.float64).tiny))
        found = np.linalg.lstsq(matrix / np.outer(size, size), total[-k:] / size, rcond=1e-9)[0] / size
        self._gain = max(float(found @ total[-k:]), 0.0)
        turn, self._turn = abs(found[0]) * self._turn, 0.0
        found *= min(1.0, _MOST_TURN / max(turn, _NOTHING))
        self._stale = self._alone or bool(found[0] < _USELESS)
        return tuple(float(np.float32(x)) for x in found)

    def _next(self, cost: float) -> tuple[Then, bool]:
        costs = self._costs
        if costs and cost > min(costs) + _NOTHING:
            self._halvings += 1
            self._stale = True
            if self._halvings <= _HALVINGS:
                return Then.HALFWAY, False
            return Then.END_AT_BEST, self._left > self._tolerance * min(costs) + _NOTHING
        self._halvings = 0
        costs.append(cost)
        falls = -np.diff(costs[-4:])
        if self._stale and len(falls) and falls[-1] < _HARDLY * cost:
            self._stuck += 1
        elif len(falls):
            self._stuck = 0
        near = self._tolerance * cost + _NOTHING
        # Of a sweep that the mix hardly takes a small fall says nothing, unless the level sees nothing to gain either.
        if len(costs) > 2 and (not self._stale or self._left <= near):
            ratios = falls[1:] / np.maximum(falls[:-1], _NOTHING)
            ratio = float(np.clip(ratios.max(), _LEAST_RATIO, _MOST_RATIO))
            if falls[-1] * ratio / (1.0 - ratio) <= near:
                return Then.END, False
        if self._sweeps >= self._most or self._stuck > _PATIENCE:
            return Then.END, True
        return Then.SWEEP, False
