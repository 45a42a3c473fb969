"""Messages between solver nodes: plain values with a sender and a receiver.

``payload_bytes`` is what the published tables count: the numbers of separator poses, 8 bytes each where they travel in
double precision, else what they take. The bytes sent are those of
:mod:`maslam.backend.distributed.message_bytes`.
"""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from ..errors import BackendError
from ..geometry import Array
from .solver_stage import Round, SolverStage, check_rows, check_sums, number_type


class _SolverMessage(ABC):
    """What every message can tell of itself."""

    round: Round

    @property
    @abstractmethod
    def payload_bytes(self) -> int:
        """Bytes of its numbers, as published tables count them."""

    @abstractmethod
    def check(self) -> None:
        """:class:`BackendError` where its numbers cannot be."""

    @property
    def name(self) -> str:
        """Its kind in a word."""
        return type(self).__name__

    @property
    def place(self) -> tuple[int, ...]:
        """Which of its sender's messages of this kind it is: equal for one that is sent again."""
        return int(self.round.stage), self.round.step, self.round.sweep

    @property
    def decides(self) -> bool:
        """Whether it ends something, so that whoever has it needs no answer."""
        return False

    @property
    def asks(self) -> bool:
        """Whether it only asks for what its sender waits for."""
        return False


@dataclass(frozen=True, eq=False)
class Values(_SolverMessage):
    """One robot's separator values after one sweep, for one neighbour.

    ``values`` ``(k, width)``: a row for each of the sender's nodes that share an edge with the receiver, sorted by
    index, which both sides know; rotations row by row (9), translation and turn (6, with the log unit 7), log unit (1).
    A row without an estimate yet is NaN, and ``k`` is 0 where no row has one.
    """

    sender: int
    receiver: int
    round: Round
    values: Array

    @property
    def payload_bytes(self) -> int:
        """8 bytes per number of a two-stage sweep, else the bytes transmitted."""
        return np.dtype(number_type(self.round.stage)).itemsize * int(self.values.size)

    def check(self) -> None:
        check_rows(self.values, self.round.stage)


@dataclass(frozen=True, eq=False)
class Deltas(_SolverMessage):
    """Moves of one robot's separators in a sweep, coarse: ``steps`` ``(k, 6)`` int8, translation then turn, or
    ``(k, 7)`` with the log unit.

    ``scales`` (float32 exactly): a step of translation in metres, of the turn ``R exp(delta)`` in radians, and of the
    log unit. Both sides go on from the pose that these steps lead to, so what rounding left out is in the next message.
    """

    sender: int
    receiver: int
    round: Round
    scales: tuple[float, ...]
    steps: NDArray[np.int8]

    @property
    def payload_bytes(self) -> int:
        return 4 * len(self.scales) + int(self.steps.size)

    def check(self) -> None:
        if self.round.stage is not SolverStage.DESCENT:
            raise BackendError("steps of a stage that has none")
        if not np.isfinite(self.scales).all():
            raise BackendError("a scale of steps is not finite")
        if len(self.scales) != self.steps.shape[1] - 4:
            raise BackendError(f"{len(self.scales)} scales of {self.steps.shape[1]} steps")


@dataclass(frozen=True)
class Coded(_SolverMessage):
    """Numbers of one round as its method codes them; the receiver knows how many there are, and checks that."""

    sender: int
    receiver: int
    round: Round
    body: bytes

    @property
    def payload_bytes(self) -> int:
        return len(self.body)

    def check(self) -> None:
        """Bodies are checked when they are read."""


@dataclass(frozen=True)
class Report(_SolverMessage):
    """Summary of a round from a robot and those below it in the tree of members, sent up the tree.

    ``change``: the largest change of any robot's values (infinite where one got its first estimate); ``cost``: sum over
    their edges; ``numbers``: further sums, 4 bytes each (of a vote: all that was said, one after the other).
    """

    sender: int
    receiver: int
    round: Round
    change: float
    cost: float
    numbers: tuple[float, ...] = ()

    @property
    def payload_bytes(self) -> int:
        return 16 + 4 * len(self.numbers)

    def check(self) -> None:
        if np.isnan(self.change) or not np.isfinite(self.cost) or self.cost < 0 or self.change < 0:
            raise BackendError("a report of NaN, or of a cost that is infinite or below 0")
        check_sums(self.numbers, self.round.stage)


@dataclass(frozen=True)
class Decision(_SolverMessage):
    """Decision of a round for all members, sent down the tree; the same at every member, so all end at the same sweep.

    ``go_on``: one more sweep of this stage, else the next stage; ``cost``: the group's sum; ``numbers``: the method's
    result from the further sums, 4 bytes each.
    """

    sender: int
    receiver: int
    round: Round
    go_on: bool
    cost: float
    numbers: tuple[float, ...] = ()

    @property
    def decides(self) -> bool:
        return True

    @property
    def payload_bytes(self) -> int:
        return 9 + 4 * len(self.numbers)

    def check(self) -> None:
        if np.isnan(self.cost) or (np.isinf(self.cost) and self.round.stage is not SolverStage.DESCENT):
            raise BackendError("a decision of an infinite cost or NaN")
        check_sums(self.numbers, self.round.stage)


@dataclass(frozen=True, eq=False)
class SeparatorState(_SolverMessage):
    """Without rounds: a robot's separators as of its ``version``, whole, so that a later one replaces a lost one.

    ``used``: the version of the receiver's that the sender works with, which tells the receiver what has arrived.
    ``values`` as in :class:`Values`, in single precision; no rows: nothing new, only ``used``.
    """

    sender: int
    receiver: int
    round: Round
    version: int
    used: int
    values: Array

    @property
    def payload_bytes(self) -> int:
        return 4 * int(self.values.size)

    @property
    def place(self) -> tuple[int, ...]:
        return self.version, self.used

    def check(self) -> None:
        if self.round != Round(SolverStage.FREE):
            raise BackendError("separators without rounds, of a round")
        check_rows(self.values, SolverStage.FREE)


STANDING = struct.Struct("<HHH?B")
"""Of a :class:`Standing`: robot, serial, version, quiet, number of states used; and each of these: robot, version."""
USED = struct.Struct("<HH")


@dataclass(frozen=True)
class Standing:
    """State of convergence that a robot reports: it has nothing to change (``quiet``) at its ``version`` given these of
    its neighbours' (number, version). ``serial`` counts its reports."""

    robot: int
    serial: int
    version: int
    quiet: bool
    used: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Status(_SolverMessage):
    """Method without rounds: the latest state of convergence of the sender and those below it, sent up the tree."""

    sender: int
    receiver: int
    round: Round
    standings: tuple[Standing, ...]

    @property
    def payload_bytes(self) -> int:
        return sum(STANDING.size + USED.size * len(s.used) for s in self.standings)

    @property
    def place(self) -> tuple[int, ...]:
        return tuple(n for s in self.standings for n in (s.robot, s.serial, s.version))

    def check(self) -> None:
        if self.round != Round(SolverStage.FREE):
            raise BackendError("standings without rounds, of a round")


class Wanted(IntFlag):
    """Messages of a round that a robot can lack: separators, a report from below, a decision from above."""

    SEPARATORS = 1
    REPORT = 2
    DECISION = 4


@dataclass(frozen=True)
class RoundWait(_SolverMessage):
    """Question for those messages of a round that have not come: a few bytes, sent again and again."""

    sender: int
    receiver: int
    round: Round
    wanted: Wanted

    @property
    def payload_bytes(self) -> int:
        return 1

    @property
    def place(self) -> tuple[int, ...]:
        return *super().place, int(self.wanted)

    @property
    def asks(self) -> bool:
        return True

    def check(self) -> None:
        if not 0 < self.wanted < 2 * Wanted.DECISION:
            raise BackendError("a question for messages of no kind")


NodeMessage = Values | Report | Decision | Deltas | SeparatorState | Status | Coded | RoundWait


def wanted_as(message: NodeMessage) -> Wanted:
    """What a robot asks for that lacks this message."""
    match message:
        case Report():
            return Wanted.REPORT
        case Decision():
            return Wanted.DECISION
    return Wanted.SEPARATORS
