"""Messages of updates: one kind of envelope; ``additions.py`` and ``corrections.py`` have the bodies."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from ..errors import BackendError

_HEADER = struct.Struct("<BHHHH")
# Far from the kinds of the other solvers' messages, so that a stray one is recognised.
FIRST_UPDATE_KIND = 0xF0


class UpdateKind(IntEnum):
    """``EDGES`` to the elected robot, ``CORRECTION`` from it, ``RECEIVED`` from either; ``LOST``: the sender no longer
    has what updates go on from, and the group is to be solved anew."""

    EDGES = 0
    CORRECTION = 1
    RECEIVED = 2
    LOST = 3


@dataclass(frozen=True)
class UpdateMessage:
    """``epoch``: the solution of the whole group that updates go on from; ``serial``: number of the sender's message of
    edges, of the receiver's correction, or of what was received."""

    kind: UpdateKind
    epoch: int
    serial: int
    sender: int
    receiver: int
    body: bytes = b""

    @property
    def payload_bytes(self) -> int:
        """All but the header."""
        return len(self.body)

    @property
    def name(self) -> str:
        """Its kind in a word."""
        return f"Update{self.kind.name.title()}"

    def check(self) -> None:
        """What is said by the kind alone has no body; other bodies are checked when they are read, before anything
        changes."""
        if self.kind in (UpdateKind.RECEIVED, UpdateKind.LOST) and self.body:
            raise BackendError(f"{self.name} with a body of {len(self.body)} bytes")

    def encode(self) -> bytes:
        """A header of 9 bytes, then the body."""
        return (
            _HEADER.pack(FIRST_UPDATE_KIND + self.kind, self.epoch, self.serial, self.sender, self.receiver) + self.body
        )

    @classmethod
    def decode(cls, data: bytes) -> UpdateMessage:
        """Inverse of :meth:`encode`; bytes that are no such message raise :class:`BackendError`."""
        try:
            kind, epoch, serial, sender, receiver = _HEADER.unpack_from(data)
            body = data[_HEADER.size :]
            return cls(UpdateKind(kind - FIRST_UPDATE_KIND), epoch, serial, sender, receiver, body)
        except (struct.error, ValueError) as error:
            raise BackendError(f"not a message of an update: {len(data)} bytes, {error}") from error


def stranger_to(message: UpdateMessage) -> list[UpdateMessage]:
    """Answer to a message of a solution that the receiver does not have: its sender learns of it."""
    kind = UpdateKind.RECEIVED if message.kind is UpdateKind.LOST else UpdateKind.LOST
    answer = UpdateMessage(kind, message.epoch, 0, message.receiver, message.sender)
    return [] if message.kind is UpdateKind.RECEIVED else [answer]
