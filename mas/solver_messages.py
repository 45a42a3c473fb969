"""What the distributed solver's nodes say to each other, as it travels between agents (:mod:`backend.distributed`)."""

from __future__ import annotations

from typing import Annotated

import msgspec
import numpy as np

from backend.distributed import messages as backend_messages
from backend.distributed.messages import WIDTH, Decision, Report, Round, Stage, Values
from mas.tensors import Tensor, check

Count = Annotated[int, msgspec.Meta(ge=0, le=2**31)]


class SolverValues(msgspec.Struct, frozen=True, array_like=True, tag=20):
    """Separator values of one sweep: ``(k, width)`` float64; a row without an estimate yet is NaN."""

    stage: Count
    step: Count
    sweep: Count
    values: Tensor

    def __post_init__(self) -> None:
        width = WIDTH[Stage(self.stage)]
        check("values", self.values, "<f8", (None, width if self.values.shape[:1] != (0,) else None), finite=False)
        if np.isinf(self.values.array()).any():
            raise ValueError("values: infinity")


class SolverReport(msgspec.Struct, frozen=True, array_like=True, tag=21):
    """A round's summary, up the tree of members; ``change`` is infinite where a robot got its first estimate."""

    stage: Count
    step: Count
    sweep: Count
    change: float
    cost: float

    def __post_init__(self) -> None:
        Stage(self.stage)
        if np.isnan(self.change) or not np.isfinite(self.cost):
            raise ValueError("report: NaN, or an infinite cost")


class SolverDecision(msgspec.Struct, frozen=True, array_like=True, tag=22):
    """What follows, down the tree of members."""

    stage: Count
    step: Count
    sweep: Count
    go_on: bool
    cost: float

    def __post_init__(self) -> None:
        Stage(self.stage)
        if not np.isfinite(self.cost):
            raise ValueError("decision: an infinite cost or NaN")


SolverBody = SolverValues | SolverReport | SolverDecision


def to_wire(m: backend_messages.Message) -> SolverBody:
    """A node's message without sender and receiver: those stand in the header."""
    r = (int(m.round.stage), m.round.step, m.round.sweep)
    if isinstance(m, Values):
        return SolverValues(*r, Tensor.of(m.values, "<f8"))
    if isinstance(m, Report):
        return SolverReport(*r, m.change, m.cost)
    return SolverDecision(*r, m.go_on, m.cost)


def from_wire(sender: int, receiver: int, b: SolverBody) -> backend_messages.Message:
    """Inverse of :func:`to_wire`."""
    at = Round(Stage(b.stage), b.step, b.sweep)
    if isinstance(b, SolverValues):
        return Values(sender, receiver, at, b.values.array())
    if isinstance(b, SolverReport):
        return Report(sender, receiver, at, b.change, b.cost)
    return Decision(sender, receiver, at, b.go_on, b.cost)


def payload_bytes(body: SolverBody) -> int:
    """What the published tables count: 8 bytes a number of a separator pose; the rest as the back end states."""
    if isinstance(body, SolverValues):
        return body.values.nbytes
    return from_wire(0, 0, body).payload_bytes
