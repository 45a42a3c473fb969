"""Messages of robots that eliminate: one kind of envelope; ``reports.py`` has the bodies."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from ...errors import BackendError

_HEADER = struct.Struct("<BHHH")
# Far from the kinds of the other solvers' messages, so that a stray one is recognised.
FIRST_FRONTAL_KIND = 0xD0


class FrontalKind(IntEnum):
    """Kinds of message: the poses that neighbours share, as they are; who shares poses with whom, and in which order
    all eliminate; what a robot passes on and gets back; and what its sender waits for."""

    START = 0
    PAIRS = 1
    ORDER = 2
    UPDATE = 3
    STEP = 4
    WAIT = 5


@dataclass(frozen=True)
class FrontalMessage:
    """``number``: of the pass that it belongs to; of ``WAIT``, of what its sender waits for."""

    kind: FrontalKind
    number: int
    sender: int
    receiver: int
    body: bytes

    @property
    def payload_bytes(self) -> int:
        """All but the header."""
        return len(self.body)

    @property
    def name(self) -> str:
        """Its kind in a word."""
        return self.kind.name.title()

    @property
    def place(self) -> tuple[int, ...]:
        """Which of its sender's messages of this kind it is: equal for one that is sent again."""
        return int(self.kind), self.number

    @property
    def since(self) -> None:
        """No rounds: whoever sends it again may lack anything."""
        return None

    @property
    def decides(self) -> bool:
        """Whether whoever has it needs no answer."""
        return self.kind in (FrontalKind.START, FrontalKind.ORDER, FrontalKind.STEP)

    @property
    def asks(self) -> bool:
        """Whether it only asks for what its sender waits for."""
        return self.kind is FrontalKind.WAIT

    def check(self) -> None:
        """Bodies are checked when they are read."""

    def encode(self) -> bytes:
        """A header of 7 bytes, then the body."""
        return _HEADER.pack(FIRST_FRONTAL_KIND + self.kind, self.number, self.sender, self.receiver) + self.body

    @classmethod
    def decode(cls, data: bytes) -> FrontalMessage:
        """Inverse of :meth:`encode`; bytes that are no such message raise :class:`BackendError`."""
        try:
            kind, number, sender, receiver = _HEADER.unpack_from(data)
            return cls(FrontalKind(kind - FIRST_FRONTAL_KIND), number, sender, receiver, data[_HEADER.size :])
        except (struct.error, ValueError) as error:
            raise BackendError(f"not an eliminating robot's message: {len(data)} bytes, {error}") from error
