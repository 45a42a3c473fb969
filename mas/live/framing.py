"""Frames: what travels from one agent to another at once. Short messages share one, a long one is cut into pieces."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

from ..errors import MasError

PIECE_BYTES = 4000
"""Longer messages travel in pieces of so many bytes, which are sent again one by one."""
FRAME_BYTES = 16_000
"""MessageBundle share a frame up to this length."""
_PIECE = struct.Struct("<BIHH")
_RECEIVED = struct.Struct("<BIHI")
_PHASE = struct.Struct("<BHB")
_PHASE_RECEIVED = struct.Struct("<BH")
_LIST_RECEIVED = struct.Struct("<BI")


class FrameError(MasError):
    """A frame that cannot be read."""


class FrameKind(IntEnum):
    """First byte of a frame."""

    MESSAGES = 0
    PIECE = 1
    RECEIVED = 2
    PHASE = 3
    PHASE_RECEIVED = 4
    REVOKED = 5
    REVOKED_RECEIVED = 6


class DrivePhase(IntEnum):
    """How far an agent is: it tells its neighbours, so that all know when all is over.

    ``DRIVING``: it still sees new images. ``CLOSING``: it settles what it knows. ``RESTING``: it has nothing left to
    do unless others bring it something. ``LEAVING``: it goes.
    """

    DRIVING = 0
    CLOSING = 1
    RESTING = 2
    LEAVING = 3


@dataclass(frozen=True)
class MessageBundle:
    """Whole messages."""

    messages: tuple[bytes, ...]


@dataclass(frozen=True)
class MessagePiece:
    """Piece ``index`` of ``count`` of the long message ``number``."""

    number: int
    index: int
    count: int
    data: bytes


@dataclass(frozen=True)
class PiecesReceived:
    """Of the long message ``number`` all pieces before ``first`` have come, and of the 32 from ``first`` on those
    whose bits are set in ``later``."""

    number: int
    first: int
    later: int


@dataclass(frozen=True)
class PhaseNotice:
    """The sender's phase; ``number`` grows with each."""

    number: int
    phase: DrivePhase


@dataclass(frozen=True)
class PhaseReceived:
    """The notice of this number has come."""

    number: int


@dataclass(frozen=True)
class RevokedNotice:
    """The newest list of revoked certificates that the sender has (DER)."""

    der: bytes


@dataclass(frozen=True)
class RevokedReceived:
    """The sender has the list of this number, or a newer one."""

    number: int


Frame = MessageBundle | MessagePiece | PiecesReceived | PhaseNotice | PhaseReceived | RevokedNotice | RevokedReceived


def pack_frame(frame: Frame) -> bytes:
    """The bytes of a frame."""
    match frame:
        case MessageBundle(messages):
            parts = [bytes([FrameKind.MESSAGES])]
            for message in messages:
                parts += [_length(len(message)), message]
            return b"".join(parts)
        case MessagePiece(number, index, count, data):
            return _PIECE.pack(FrameKind.PIECE, number, index, count) + data
        case PiecesReceived(number, first, later):
            return _RECEIVED.pack(FrameKind.RECEIVED, number, first, later)
        case PhaseNotice(number, phase):
            return _PHASE.pack(FrameKind.PHASE, number, phase)
        case PhaseReceived(number):
            return _PHASE_RECEIVED.pack(FrameKind.PHASE_RECEIVED, number)
        case RevokedNotice(der):
            return bytes([FrameKind.REVOKED]) + der
        case RevokedReceived(number):
            return _LIST_RECEIVED.pack(FrameKind.REVOKED_RECEIVED, number)


def unpack_frame(data: bytes) -> Frame:
    """What the bytes of a frame say; :class:`FrameError` where that is nothing."""
    kind = data[0] if data else None
    try:
        if kind == FrameKind.MESSAGES:
            return MessageBundle(tuple(_split(data)))
        if kind == FrameKind.PIECE:
            _, number, index, count = _PIECE.unpack_from(data)
            return _checked(MessagePiece(number, index, count, data[_PIECE.size :]))
        if kind == FrameKind.RECEIVED:
            return PiecesReceived(*_RECEIVED.unpack(data)[1:])
        if kind == FrameKind.PHASE:
            _, number, phase = _PHASE.unpack(data)
            return PhaseNotice(number, DrivePhase(phase))
        if kind == FrameKind.PHASE_RECEIVED:
            return PhaseReceived(_PHASE_RECEIVED.unpack(data)[1])
        if kind == FrameKind.REVOKED:
            return RevokedNotice(data[1:])
        if kind == FrameKind.REVOKED_RECEIVED:
            return RevokedReceived(_LIST_RECEIVED.unpack(data)[1])
    except (struct.error, ValueError) as error:
        raise FrameError(f"frame of {len(data)} bytes cannot be read: {error}") from error
    raise FrameError(f"frame of {len(data)} bytes: there is no kind {kind}")


def cut(number: int, message: bytes) -> list[MessagePiece]:
    """The pieces of a long message."""
    count = -(-len(message) // PIECE_BYTES)
    if count > 0xFFFF:
        raise FrameError(f"message of {len(message)} bytes: more than {0xFFFF} pieces")
    parts = (message[i * PIECE_BYTES : (i + 1) * PIECE_BYTES] for i in range(count))
    return [MessagePiece(number, i, count, part) for i, part in enumerate(parts)]


def bundled(messages: Sequence[bytes]) -> list[MessageBundle]:
    """Short messages in frames of at most :data:`FRAME_BYTES`, in order."""
    frames: list[list[bytes]] = []
    room = 0
    for message in messages:
        if len(message) + 3 > room:
            frames.append([])
            room = FRAME_BYTES
        frames[-1].append(message)
        room -= len(message) + 3
    return [MessageBundle(tuple(frame)) for frame in frames]


def _checked(piece: MessagePiece) -> MessagePiece:
    last = piece.index == piece.count - 1
    if not piece.index < piece.count or not 0 < len(piece.data) <= PIECE_BYTES:
        raise FrameError(f"piece {piece.index} of {piece.count}, {len(piece.data)} bytes")
    if not last and len(piece.data) != PIECE_BYTES:
        raise FrameError(
            f"piece {piece.index} of {piece.count} has {len(piece.data)} bytes, all but the last have more"
        )
    return piece


def _length(count: int) -> bytes:
    """One byte below 128, else three."""
    return bytes([count]) if count < 0x80 else bytes([0x80]) + struct.pack("<H", count)


def _split(data: bytes) -> list[bytes]:
    out, at = [], 1
    while at < len(data):
        count, at = data[at], at + 1
        if count == 0x80:
            (count,) = struct.unpack_from("<H", data, at)
            at += 2
        elif count > 0x80:
            raise FrameError(f"a length of {count}")
        if not count or at + count > len(data):
            raise FrameError(f"a message of {count} bytes where {len(data) - at} are left")
        out.append(data[at : at + count])
        at += count
    return out
