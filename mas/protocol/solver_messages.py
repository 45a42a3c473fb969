"""What the distributed solver's nodes say to each other, as it travels between agents
(:mod:`maslam.backend.distributed`)."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np

from maslam.backend.distributed import messages as backend_messages
from maslam.backend.distributed.elected_messages import ElectedMessage, Kind
from maslam.backend.distributed.messages import (
    WIDTH,
    Decision,
    Deltas,
    Report,
    Round,
    SeparatorState,
    SolverStage,
    Standing,
    Status,
    Values,
    number_type,
)

from .tensors import Tensor, check

RoundNumber = Annotated[int, msgspec.Meta(ge=0, le=2**31)]
Short = Annotated[int, msgspec.Meta(ge=0, lt=2**16)]
# More sums than any method needs are a mistake.
_MOST_NUMBERS = 64
_NO_NUMBERS = Tensor("<f4", (0,), b"")


def _check_numbers(numbers: Tensor) -> None:
    if len(check("numbers", numbers, "<f4", (None,))) > _MOST_NUMBERS:
        raise ValueError(f"numbers: more than {_MOST_NUMBERS}")


class SolverValues(msgspec.Struct, frozen=True, array_like=True, tag=20):
    """Separator values of one sweep: ``(k, width)`` in the stage's precision; a row without an estimate yet is NaN."""

    stage: RoundNumber
    step: RoundNumber
    sweep: RoundNumber
    values: Tensor

    def __post_init__(self) -> None:
        width, kind = WIDTH[SolverStage(self.stage)], number_type(SolverStage(self.stage))
        check("values", self.values, kind, (None, width if self.values.shape[:1] != (0,) else None), finite=False)
        if np.isinf(self.values.array()).any():
            raise ValueError("values: infinity")


class SolverReport(msgspec.Struct, frozen=True, array_like=True, tag=21):
    """A round's summary, up the tree of members; ``change`` is infinite where a robot got its first estimate."""

    stage: RoundNumber
    step: RoundNumber
    sweep: RoundNumber
    change: float
    cost: float
    numbers: Tensor = _NO_NUMBERS

    def __post_init__(self) -> None:
        SolverStage(self.stage)
        _check_numbers(self.numbers)
        if np.isnan(self.change) or not np.isfinite(self.cost):
            raise ValueError("report: NaN, or an infinite cost")


class SolverDecision(msgspec.Struct, frozen=True, array_like=True, tag=22):
    """What follows, down the tree of members; an infinite ``cost``: some robots have no place yet."""

    stage: RoundNumber
    step: RoundNumber
    sweep: RoundNumber
    go_on: bool
    cost: float
    numbers: Tensor = _NO_NUMBERS

    def __post_init__(self) -> None:
        _check_numbers(self.numbers)
        if np.isnan(self.cost) or (np.isinf(self.cost) and SolverStage(self.stage) is not SolverStage.DESCENT):
            raise ValueError("decision: an infinite cost or NaN")


class SolverSteps(msgspec.Struct, frozen=True, array_like=True, tag=23):
    """How separators moved: ``steps`` ``(k, 6)`` signed bytes (as they stand in memory), of these two scales."""

    stage: RoundNumber
    step: RoundNumber
    sweep: RoundNumber
    scale_m: float
    scale_rad: float
    steps: Tensor

    def __post_init__(self) -> None:
        if SolverStage(self.stage) is not SolverStage.DESCENT:
            raise ValueError("steps: of a stage that has none")
        check("steps", self.steps, "|u1", (None, 6))
        if not (np.isfinite(self.scale_m) and np.isfinite(self.scale_rad)):
            raise ValueError("steps: a scale is not finite")


class SolverState(msgspec.Struct, frozen=True, array_like=True, tag=24):
    """Separators without rounds: ``(k, 6)`` float32 as of ``version``; ``used``: the receiver's version in use."""

    version: Short
    used: Short
    values: Tensor

    def __post_init__(self) -> None:
        check("values", self.values, "<f4", (None, 6), finite=False)
        if np.isinf(self.values.array()).any():
            raise ValueError("values: infinity")


class SolverStanding(msgspec.Struct, frozen=True, array_like=True):
    """See :class:`maslam.backend.distributed.messages.Standing`."""

    robot: Short
    serial: Short
    version: Short
    quiet: bool
    used: Annotated[tuple[tuple[Short, Short], ...], msgspec.Meta(max_length=4096)]


class SolverStatus(msgspec.Struct, frozen=True, array_like=True, tag=25):
    """Standings without rounds, up the tree of members."""

    standings: Annotated[tuple[SolverStanding, ...], msgspec.Meta(max_length=4096)]


class SolverParcel(msgspec.Struct, frozen=True, array_like=True, tag=26):
    """What an elected group says (:mod:`maslam.backend.distributed.elected_messages`): ``body`` as its ``kind`` lays it
    out."""

    kind: Annotated[int, msgspec.Meta(ge=0, lt=len(Kind))]
    term: Annotated[int, msgspec.Meta(ge=0, lt=256)]
    body: Annotated[bytes, msgspec.Meta(max_length=2**26)]


SolverBody = SolverValues | SolverReport | SolverDecision | SolverSteps | SolverState | SolverStatus | SolverParcel
SolverMessage = backend_messages.NodeMessage | ElectedMessage
"""What nodes say, whatever their method."""


def to_wire(m: SolverMessage) -> SolverBody:
    """A node's message without sender and receiver: those stand in the header."""
    if isinstance(m, ElectedMessage):
        return SolverParcel(int(m.kind), m.term, m.body)
    r = (int(m.round.stage), m.round.step, m.round.sweep)
    match m:
        case Values():
            return SolverValues(*r, Tensor.of(m.values, number_type(m.round.stage)))
        case Report():
            return SolverReport(*r, m.change, m.cost, Tensor.of(m.numbers, "<f4"))
        case Decision():
            return SolverDecision(*r, m.go_on, m.cost, Tensor.of(m.numbers, "<f4"))
        case Deltas():
            return SolverSteps(*r, *m.scales, Tensor.of(np.ascontiguousarray(m.steps).view(np.uint8), "|u1"))
        case SeparatorState():
            return SolverState(m.version, m.used, Tensor.of(m.values, "<f4"))
        case Status():
            return SolverStatus(
                tuple(SolverStanding(s.robot, s.serial, s.version, s.quiet, s.used) for s in m.standings)
            )


def from_wire(sender: int, receiver: int, b: SolverBody) -> SolverMessage:
    """Inverse of :func:`to_wire`."""
    ends = (sender, receiver)
    match b:
        case SolverParcel():
            return ElectedMessage(Kind(b.kind), b.term, sender, receiver, b.body)
        case SolverState():
            return SeparatorState(
                *ends, Round(SolverStage.FREE), b.version, b.used, b.values.array().astype(np.float64)
            )
        case SolverStatus():
            standings = tuple(Standing(s.robot, s.serial, s.version, s.quiet, s.used) for s in b.standings)
            return Status(*ends, Round(SolverStage.FREE), standings)
    at = Round(SolverStage(b.stage), b.step, b.sweep)
    match b:
        case SolverValues():
            return Values(*ends, at, b.values.array().astype(np.float64))
        case SolverReport():
            return Report(*ends, at, b.change, b.cost, _numbers(b.numbers))
        case SolverDecision():
            return Decision(*ends, at, b.go_on, b.cost, _numbers(b.numbers))
        case SolverSteps():
            return Deltas(*ends, at, (b.scale_m, b.scale_rad), b.steps.array().view(np.int8))


def place_of(b: SolverBody) -> tuple[int, ...]:
    """Which of its sender's messages of this kind it is: equal for one that is said again."""
    match b:
        case SolverParcel():
            return b.kind, b.term
        case SolverState():
            return b.version, b.used
        case SolverStatus():
            return tuple(n for s in b.standings for n in (s.robot, s.serial, s.version))
    return b.stage, b.step, b.sweep


def round_of(b: SolverBody) -> Round | None:
    """The round it belongs to; None for what is said without rounds."""
    if isinstance(b, SolverParcel | SolverState | SolverStatus):
        return None
    return Round(SolverStage(b.stage), b.step, b.sweep)


def decides(message: SolverMessage | SolverBody) -> bool:
    """Whether it ends something, so that whoever has heard it needs no answer."""
    match message:
        case ElectedMessage():
            return message.kind is Kind.DECISION
        case SolverParcel():
            return message.kind == Kind.DECISION
    return isinstance(message, Decision | SolverDecision)


def payload_bytes(body: SolverBody) -> int:
    """What the published tables count: the numbers of separator poses as they travel; the rest as the back end
    states.
    """
    return from_wire(0, 0, body).payload_bytes


def _numbers(tensor: Tensor) -> tuple[float, ...]:
    return tuple(tensor.array().astype(np.float64).tolist())
