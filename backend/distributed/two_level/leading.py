"""The root's part: the coarse level's step, the mix of earlier moves, and when to end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader, CompactWriter
from ..places import SCALED
from .coarse_level import CoarseLevel
from .coded_places import by_number
from .codes import Steps, read_steps, write_steps
from .springs import Knots, Springs, needed, read_knots, read_springs

# Forces are whole steps of this share of a robot's largest at first; later by what is left to gain.
_FORCE_LEVELS = 2047
_WHOLE_ROBOT = 1.0 / 16.0
# Steps of the coarse level over the deviation of what is left to gain, a number of a shared pose.
_FINENESS = 0.25
_HALVINGS = 8
# A sweep of which the mix takes less than this: the coarse level is that of another place.
_USELESS = 0.3
# Turns beyond this, rad, are not small: the move is cut.
_MOST_TURN = 0.25
_LEFT = 4.0
_KEPT = 0.001
_NOTHING = 1e-9
_LEAST_RATIO, _MOST_RATIO = 0.5, 0.9


class Then(IntEnum):
    """What members do after the coarse level's answer: sweep; go half of the last move back; tell of their knots and
    springs again, as poses have moved; end where they are, or where the cost was least."""

    SWEEP = 0
    HALFWAY = 1
    AGAIN = 2
    END = 3
    END_AT_BEST = 4

    @property
    def ends(self) -> bool:
        """Whether no sweep follows any more."""
        return self in (Then.END, Then.END_AT_BEST)


@dataclass(frozen=True, eq=False)
class Answer:
    """``then``; ``capped``: it ends because no more sweeps are allowed. With a sweep: ``grid``, the resolution in
    deviations, and the moves ``(k, w)`` of the knots that a robot asks for, as :func:`differences` has them."""

    then: Then
    capped: bool = False
    grid: float = 0.0
    sigmas: Array | None = None
    steps: Steps | None = None

    def encode(self) -> bytes:
        """Bytes."""
        out = CompactWriter()
        out.count(self.then + (8 if self.capped else 0) + (16 if self.sigmas is not None else 0))
        if self.then is not Then.SWEEP:
            return out.bytes()
        assert self.steps is not None
        out.rough(self.grid)
        if self.sigmas is not None:
            out.array(self.sigmas, "<f4")
        return out.bytes() + write_steps(self.steps, by_column=True)

    @classmethod
    def decode(cls, data: bytes, knots: int, width: int) -> Answer:
        """Inverse of :meth:`encode`, for so many ``knots``."""
        source = CompactReader(data)
        head = source.count()
        if head & 7 > Then.END_AT_BEST or head >= 32:
            raise BackendError("an answer of the coarse level that is none")
        then, capped = Then(head & 7), bool(head & 8)
        if then is not Then.SWEEP:
            return cls(then, capped)
        grid = source.rough()
        if not (np.isfinite(grid) and grid > 0):
            raise BackendError("a resolution of the coarse level that is not positive")
        sigmas = source.array(3, "<f4") if head & 16 else None
        return cls(then, capped, grid, sigmas, read_steps(source.rest(), knots, width, by_column=True))


def write_forces(cost: float, forces: Array, centres: Array, sigmas: Array, resolution: float) -> bytes:
    """A robot's part of the cost, and the forces ``(k, w)`` on its knots at ``centres``, in whole steps.

    Each number is the force on all knots from one on, about that one's centre: what rounding adds is then a pull
    between two knots, not a push of the robot through the city, which little resists. ``resolution`` in the forces that
    move by a deviation; 0: a share of the largest.
    """
    unit = 1.0 / by_number(sigmas, forces.shape[1])
    whole = _summed_forces(forces, centres) / unit
    if resolution <= 0:
        resolution = float(np.abs(whole).max(initial=0.0)) / _FORCE_LEVELS
    out = CompactWriter()
    out.number(cost)
    scale = float(np.float32(resolution))
    out.rough(scale)
    steps = np.rint(whole / (scale * _finer(whole))) if scale > 0 else np.zeros(whole.shape)
    return out.bytes() + write_steps(steps.astype(np.int64), by_column=True)


def read_forces(data: bytes, centres: Array, sigmas: Array, width: int) -> tuple[float, Array]:
    """Inverse of :func:`write_forces`."""
    source = CompactReader(data)
    cost, scale = source.number(), source.rough()
    if not np.isfinite([cost, scale]).all() or scale < 0:
        raise BackendError("forces on knots, or their cost, that are not finite")
    steps = read_steps(source.rest(), len(centres), width, by_column=True)
    whole = scale * steps * _finer(steps) / by_number(sigmas, width)
    return cost, whole - _on_the_one_before(whole, centres)


def _finer(values: Array | Steps) -> Array:
    """``(k, 1)``: steps of the first knot, that is of the force on the whole robot, are finer."""
    out = np.ones((len(values), 1))
    out[:1] = _WHOLE_ROBOT
    return out


def _summed_forces(forces: Array, centres: Array) -> Array:
    out = forces.copy()
    for k in range(len(out) - 2, -1, -1):
        out[k] += _on_the_one_before(out[k : k + 2], centres[k : k + 2])[0]
    return out


def _on_the_one_before(forces: Array, centres: Array) -> Array:
    """Each knot's force about the centre of the one before; of the last knot there is none after it: 0."""
    out = np.zeros(forces.shape)
    arm = centres[1:] - centres[:-1]
    out[:-1] = forces[1:]
    out[:-1, 3:6] += np.cross(arm, forces[1:, :3])
    if forces.shape[1] == SCALED:
        out[:-1, 6] += (arm * forces[1:, :3]).sum(axis=1)
    return out


def differences(steps: Steps, centres: Array, lever: float) -> Steps:
    """Of knots' moves in whole steps ``(k, w)`` from what the nearest knot before would do to a body at their
    ``centres``: knots at one place move alike.

    ``lever``: steps of a shift that a step of a turn makes at arm's length 1. Sums run number by number, so that the
    same numbers come out everywhere.
    """
    out = steps.copy()
    near = _nearest_before(centres)
    if len(steps) > 1:
        out[1:] -= _carried_on(steps[near], centres[1:] - centres[near], lever)
    return out


def summed(found: Steps, centres: Array, lever: float) -> Steps:
    """Inverse of :func:`differences`."""
    out = found.copy()
    for k, near in enumerate(_nearest_before(centres).tolist(), start=1):
        out[k] += _carried_on(out[near : near + 1], (centres[k] - centres[near])[None], lever)[0]
    return out


def _nearest_before(centres: Array) -> NDArray[np.intp]:
    """For each knot but the first the nearest one before it."""
    if not len(centres):
        return np.zeros(0, dtype=np.intp)
    apart = ((centres[1:, None] - centres[None]) ** 2).sum(axis=2)
    later = np.arange(len(centres))[None] > np.arange(len(apart))[:, None]
    return np.asarray(np.argmin(np.where(later, np.inf, apart), axis=1), dtype=np.intp)


def _carried_on(steps: Steps, arm: Array, lever: float) -> Steps:
    out = steps.copy()
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        out[:, a] += np.rint(lever * (steps[:, 3 + b] * arm[:, c] - steps[:, 3 + c] * arm[:, b])).astype(np.int64)
    return out


class Leading:
    """What the root gathers and decides; ``width``: numbers of a move."""

    def __init__(self, members: Sequence[int], width: int, fixed: frozenset[int], tolerance: float, most: int) -> None:
        self._members, self._width, self._fixed = members, width, fixed
        self._tolerance, self._most = tolerance, most
        self._knots: dict[int, Knots] = {}
        self._springs: list[Springs] = []
        self._held: tuple[int, int] | None = None
        self._forces: dict[int, tuple[float, Array]] = {}
        self._sums: list[tuple[float, ...]] = []
        self._level: CoarseLevel | None = None
        self._asked: dict[int, list[tuple[int, int]]] = {}
        self._costs: list[float] = []
        self._gain = 0.0
        self._halvings = self._sweeps = 0
        self._stale = False
        self._turn = 0.0
        self._since = 0

    def take_part(self, robot: int, body: bytes) -> None:
        """A member's knots and springs."""
        source = CompactReader(body)
        held = source.count()
        self._knots[robot] = read_knots(source, self._width)
        self._springs.append(read_springs(source, robot, self._members))
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

    def answers(self) -> dict[int, Answer]:
        """For each member what it does next, from all costs and forces."""
        cost = sum(self._forces[r][0] for r in self._members)
        # Told again, the level is new and the cost is not.
        then, capped = (Then.SWEEP, False) if self._level is None and self._costs else self._next(cost)
        if then is not Then.SWEEP:
            self._forces.clear()
            return dict.fromkeys(self._members, Answer(then, capped))
        if self._stale:
            self._knots, self._springs, self._level, self._stale = {}, [], None, False
            self._forces.clear()
            return dict.fromkeys(self._members, Answer(Then.AGAIN))
        fresh = self._level is None
        if self._level is None:
            self._level = CoarseLevel(self._knots, self._springs, self._width, self._held, self._fixed)
            self._asked = needed(self._springs)
        level = self._level
        middle = np.median([self._knots[r].sigmas for r in self._members], axis=0)
        sigmas = np.asarray(middle.astype(np.float32), dtype=np.float64)
        unit = by_number(sigmas, self._width)
        order = sorted(self._members)
        forces = np.concatenate([self._forces[r][1] for r in order])
        moves = level.step(forces)
        left = float((forces * moves).sum())
        self._gain = left if fresh else min(self._gain, max(_LEFT * left, _KEPT * self._gain))
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
            out[r] = Answer(then, False, grid, first, coded)
        self._forces.clear()
        self._sweeps += 1
        self._since = 1 if fresh else self._since + 1
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
        self._stale = bool(found[0] < _USELESS)
        return tuple(float(np.float32(x)) for x in found)

    def _next(self, cost: float) -> tuple[Then, bool]:
        costs = self._costs
        if costs and cost > min(costs) + _NOTHING:
            self._halvings += 1
            self._stale = True
            return (Then.HALFWAY if self._halvings <= _HALVINGS else Then.END_AT_BEST), False
        self._halvings = 0
        costs.append(cost)
        # Of a sweep that the mix hardly takes, a small fall says nothing; but where the level is new, that is the end.
        if len(costs) > 2 and (not self._stale or self._since < 2):
            falls = -np.diff(costs[-4:])
            ratios = falls[1:] / np.maximum(falls[:-1], _NOTHING)
            ratio = float(np.clip(ratios.max(), _LEAST_RATIO, _MOST_RATIO))
            if falls[-1] * ratio / (1.0 - ratio) <= self._tolerance * cost + _NOTHING:
                return Then.END, False
        if self._sweeps >= self._most:
            return Then.END, True
        return Then.SWEEP, False
