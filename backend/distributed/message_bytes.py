"""Messages between solver nodes as bytes: little endian, a header of 10 (of coded numbers: 5), then the numbers."""

from __future__ import annotations

import struct

import numpy as np

from ..errors import BackendError
from .compact import CompactReader, CompactWriter
from .messages import (
    STANDING,
    USED,
    Coded,
    Decision,
    Deltas,
    NodeMessage,
    Report,
    RoundWait,
    SeparatorState,
    Standing,
    Status,
    Values,
    Wanted,
)
from .solver_stage import WIDTH, Round, SolverStage, number_type, width_of

# kind, stage, step, sweep, sender, receiver
_HEADER = struct.Struct("<BBHHHH")
_REPORT = struct.Struct("<dd")
_DECISION = struct.Struct("<?d")
_WANTED = struct.Struct("<B")
# Kind of coded numbers, with their stage; their header is another, as short as its numbers.
_CODED = 0x20
# In the kind: rows have one number more than their stage, the log unit.
_SCALED = 0x40


def encode(message: NodeMessage) -> bytes:
    """The message as bytes, little endian: a header of 10, then its numbers."""
    r = message.round
    if isinstance(message, Coded):
        return encode_coded(message, (message.sender, message.receiver))
    kind = (Values, Report, Decision, Deltas, SeparatorState, Status, RoundWait).index(type(message))
    if _columns(message) > WIDTH[r.stage]:
        kind |= _SCALED
    head = _HEADER.pack(kind, r.stage, r.step, r.sweep, message.sender, message.receiver)
    match message:
        case Values():
            return head + np.ascontiguousarray(message.values, dtype=number_type(r.stage)).tobytes()
        case Deltas():
            return head + _pack(message.scales) + np.ascontiguousarray(message.steps, dtype="<i1").tobytes()
        case Report():
            return head + _REPORT.pack(message.change, message.cost) + _pack(message.numbers)
        case Decision():
            return head + _DECISION.pack(message.go_on, message.cost) + _pack(message.numbers)
        case SeparatorState():
            numbers = np.ascontiguousarray(message.values, dtype=number_type(r.stage)).tobytes()
            return head + USED.pack(message.version, message.used) + numbers
        case Status():
            return head + b"".join(_pack_standing(s) for s in message.standings)
        case RoundWait():
            return head + bytes([message.wanted])


def decode(data: bytes) -> NodeMessage:
    """Inverse of :func:`encode`; bytes that are no such message raise :class:`BackendError`."""
    try:
        if is_coded(data):
            source = CompactReader(data[1:])
            return decode_coded(data[0], (source.count(), source.count()), source)
        kind, stage, step, sweep, sender, receiver = _HEADER.unpack_from(data)
        body, round_ = data[_HEADER.size :], Round(SolverStage(stage), step, sweep)
        kind, scaled = kind & ~_SCALED, bool(kind & _SCALED)
        width = max(width_of(round_.stage, scaled), 1)
        if kind == 0:
            values = np.frombuffer(body, dtype=number_type(round_.stage)).reshape(-1, width).astype(np.float64)
            return Values(sender, receiver, round_, values)
        if kind == 1:
            change, cost = _REPORT.unpack_from(body)
            return Report(sender, receiver, round_, change, cost, _unpack(body[_REPORT.size :]))
        if kind == 2:
            go_on, cost = _DECISION.unpack_from(body)
            return Decision(sender, receiver, round_, go_on, cost, _unpack(body[_DECISION.size :]))
        if kind == 3:
            scales = 4 * (width - 4)
            steps = np.frombuffer(body[scales:], dtype="<i1").reshape(-1, width)
            return Deltas(sender, receiver, round_, _unpack(body[:scales]), steps)
        if kind == 4:
            values = np.frombuffer(body[USED.size :], dtype=number_type(round_.stage)).reshape(-1, width)
            version, used = USED.unpack_from(body)
            return SeparatorState(sender, receiver, round_, version, used, values.astype(np.float64))
        if kind == 5:
            return Status(sender, receiver, round_, _unpack_standings(body))
        if kind == 6:
            (wanted,) = _WANTED.unpack(body)
            return RoundWait(sender, receiver, round_, Wanted(wanted))
    except (struct.error, ValueError) as error:
        raise BackendError(f"not a solver message: {len(data)} bytes, {error}") from error
    raise BackendError(f"not a solver message: unknown kind {kind}")


def is_coded(data: bytes) -> bool:
    """Whether these are coded numbers."""
    return bool(data) and _CODED <= data[0] < _SCALED


def encode_coded(message: Coded, ends: tuple[int, ...]) -> bytes:
    """Coded numbers as bytes, with these of its ``ends``: both, or none where a carrier names them."""
    out = CompactWriter()
    for number in (*ends, message.round.step, message.round.sweep):
        out.count(number)
    return bytes([_CODED | message.round.stage]) + out.bytes() + message.body


def decode_coded(kind: int, ends: tuple[int, int], source: CompactReader) -> Coded:
    """Inverse of :func:`encode_coded`, from what comes after the ends."""
    try:
        stage = SolverStage(kind & ~_CODED)
    except ValueError as error:
        raise BackendError(f"not a solver message: {error}") from error
    step, sweep = source.count(), source.count()
    return Coded(*ends, Round(stage, step, sweep), source.rest())


def _columns(message: NodeMessage) -> int:
    """Numbers in a row of its separators; 0 where it has none."""
    match message:
        case Values() | SeparatorState():
            return message.values.shape[1]
        case Deltas():
            return message.steps.shape[1]
    return 0


def _pack(numbers: tuple[float, ...]) -> bytes:
    return np.array(numbers, dtype="<f4").tobytes()


def _unpack(data: bytes) -> tuple[float, ...]:
    return tuple(np.frombuffer(data, dtype="<f4").astype(np.float64).tolist())


def _pack_standing(s: Standing) -> bytes:
    head = STANDING.pack(s.robot, s.serial, s.version, s.quiet, len(s.used))
    return head + b"".join(USED.pack(*pair) for pair in s.used)


def _unpack_standings(data: bytes) -> tuple[Standing, ...]:
    standings, at = [], 0
    while at < len(data):
        robot, serial, version, quiet, count = STANDING.unpack_from(data, at)
        at += STANDING.size
        used = tuple(USED.unpack_from(data, at + k * USED.size) for k in range(count))
        at += count * USED.size
        standings.append(Standing(robot, serial, version, quiet, used))
    return tuple(standings)
