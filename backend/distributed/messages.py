"""Everything that solver nodes say to each other: plain values with a sender and a receiver, and their encoding.

``payload_bytes`` is what the published tables count: 8 bytes a number of a separator pose. The true length on the
wire is that of :func:`encode`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from backend.errors import BackendError
from backend.geometry import Array


class Stage(IntEnum):
    """What a sweep works on, in this order."""

    SCALE = 0
    START = 1
    ROTATION = 2
    POSE = 3
    COST = 4


# Numbers that one separator pose (one robot, for SCALE) costs each sweep.
WIDTH = {Stage.SCALE: 1, Stage.START: 6, Stage.ROTATION: 9, Stage.POSE: 6, Stage.COST: 0}


@dataclass(frozen=True, order=True)
class Round:
    """One synchronous round: a sweep of a stage; ``step`` counts Gauss-Newton steps."""

    stage: Stage
    step: int = 0
    sweep: int = 0


@dataclass(frozen=True, eq=False)
class Values:
    """One robot's separator values after one sweep, for one neighbour.

    ``values`` ``(k, width)``: a row for each of the sender's nodes that share an edge with the receiver, sorted by
    index, which both sides know; rotations row by row (9), translation and turn (6), log scale (1). A row without an
    estimate yet is NaN, and ``k`` is 0 where no row has one.
    """

    sender: int
    receiver: int
    round: Round
    values: Array

    @property
    def payload_bytes(self) -> int:
        return 8 * int(self.values.size)


@dataclass(frozen=True)
class Report:
    """What a robot and those below it in the tree of members found in a round: up the tree.

    ``change``: the largest change of any robot's values (infinite where one got its first estimate); ``cost``: sum
    over their edges.
    """

    sender: int
    receiver: int
    round: Round
    change: float
    cost: float

    @property
    def payload_bytes(self) -> int:
        return 16


@dataclass(frozen=True)
class Decision:
    """What follows for everyone: down the tree. The same at every member, so all end at the same sweep.

    ``go_on``: one more sweep of this stage, else the next stage; ``cost``: the group's sum.
    """

    sender: int
    receiver: int
    round: Round
    go_on: bool
    cost: float

    @property
    def payload_bytes(self) -> int:
        return 9


Message = Values | Report | Decision

# kind, stage, step, sweep, sender, receiver
_HEADER = struct.Struct("<BBHHHH")
_REPORT = struct.Struct("<dd")
_DECISION = struct.Struct("<?d")


def encode(message: Message) -> bytes:
    """The message as bytes: a header of 10, then 8 for each number, little endian."""
    r = message.round
    kind = (Values, Report, Decision).index(type(message))
    head = _HEADER.pack(kind, r.stage, r.step, r.sweep, message.sender, message.receiver)
    match message:
        case Values():
            return head + np.ascontiguousarray(message.values, dtype="<f8").tobytes()
        case Report():
            return head + _REPORT.pack(message.change, message.cost)
        case Decision():
            return head + _DECISION.pack(message.go_on, message.cost)


def decode(data: bytes) -> Message:
    """Inverse of :func:`encode`; bytes that are no such message raise :class:`BackendError`."""
    try:
        kind, stage, step, sweep, sender, receiver = _HEADER.unpack_from(data)
        body, round_ = data[_HEADER.size :], Round(Stage(stage), step, sweep)
        if kind == 0:
            width = max(WIDTH[round_.stage], 1)
            values = np.frombuffer(body, dtype="<f8").reshape(-1, width).astype(np.float64)
            return Values(sender, receiver, round_, values)
        if kind == 1:
            return Report(sender, receiver, round_, *_REPORT.unpack(body))
        if kind == 2:
            return Decision(sender, receiver, round_, *_DECISION.unpack(body))
    except (struct.error, ValueError) as error:
        raise BackendError(f"not a solver message: {len(data)} bytes, {error}") from error
    raise BackendError(f"not a solver message: unknown kind {kind}")
