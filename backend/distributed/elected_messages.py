"""Messages of an elected group: one kind of envelope; ``contribution.py`` and ``solution.py`` have its bodies."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from ..errors import BackendError

_HEADER = struct.Struct("<BBHH")
# Far from the kinds of the other solvers' messages, so that a stray one is recognised.
FIRST_KIND = 0xE0


class Kind(IntEnum):
    """Kinds of message, in the order in which they are sent; ``WAIT``, sent again and again, names the kind that its
    sender waits for. ``FINER`` and ``REMAINDER``, before a solution, ask for what was rounded off, and give it: their
    first byte says for the how many-th time."""

    SIZE = 0
    CONTRIBUTION = 1
    SOLUTION = 2
    COST = 3
    DECISION = 4
    WAIT = 5
    FINER = 6
    REMAINDER = 7


@dataclass(frozen=True)
class ElectedMessage:
    """``term``: how many elected robots have fallen silent so far, as the sender knows."""

    kind: Kind
    term: int
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
        again = self.body[:1] if self.kind in (Kind.FINER, Kind.REMAINDER) else b""
        return int(self.kind), self.term, *again

    @property
    def since(self) -> None:
        """No rounds: whoever sends it again may lack anything."""
        return None

    @property
    def decides(self) -> bool:
        """Whether whoever has it needs no answer."""
        return self.kind in (Kind.SIZE, Kind.DECISION)

    @property
    def asks(self) -> bool:
        """Whether it only asks for what its sender waits for."""
        return self.kind is Kind.WAIT

    def check(self) -> None:
        """Bodies are checked when they are read."""

    def encode(self) -> bytes:
        """A header of 6 bytes, then the body."""
        return _HEADER.pack(FIRST_KIND + self.kind, self.term, self.sender, self.receiver) + self.body

    @classmethod
    def decode(cls, data: bytes) -> ElectedMessage:
        """Inverse of :meth:`encode`; bytes that are no such message raise :class:`BackendError`."""
        try:
            kind, term, sender, receiver = _HEADER.unpack_from(data)
            return cls(Kind(kind - FIRST_KIND), term, sender, receiver, data[_HEADER.size :])
        except (struct.error, ValueError) as error:
            raise BackendError(f"not an elected solver's message: {len(data)} bytes, {error}") from error
