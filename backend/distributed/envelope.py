"""What messages of methods without rounds have in common: a kind, which of its sender's it is, two ends and a body."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum
from typing import ClassVar, Self

from ..errors import BackendError


@dataclass(frozen=True)
class Envelope:
    """A message whose ``body`` its method reads; ``number`` means what the method says. A subclass names its header,
    the byte of its first kind, its kinds, and of what it is a message."""

    kind: IntEnum
    number: int
    sender: int
    receiver: int
    body: bytes

    header: ClassVar[struct.Struct]
    first_kind: ClassVar[int]
    kinds: ClassVar[type[IntEnum]]
    of: ClassVar[str]

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
    def asks(self) -> bool:
        """Whether it only asks for what its sender waits for."""
        return self.kind.name == "WAIT"

    def check(self) -> None:
        """Bodies are checked when they are read."""

    def encode(self) -> bytes:
        """The header, then the body."""
        return self.header.pack(self.first_kind + self.kind, self.number, self.sender, self.receiver) + self.body

    @classmethod
    def decode(cls, data: bytes) -> Self:
        """Inverse of :meth:`encode`; bytes that are no such message raise :class:`BackendError`."""
        try:
            kind, number, sender, receiver = cls.header.unpack_from(data)
            return cls(cls.kinds(kind - cls.first_kind), number, sender, receiver, data[cls.header.size :])
        except (struct.error, ValueError) as error:
            raise BackendError(f"not {cls.of} message: {len(data)} bytes, {error}") from error
