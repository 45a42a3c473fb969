"""A method's own message in one of its runs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class InRun:
    """``message`` of the method, of its ``run``: counted from 1."""

    run: int
    message: Any

    @property
    def sender(self) -> int:
        """Of the message."""
        return int(self.message.sender)

    @property
    def receiver(self) -> int:
        """Of the message."""
        return int(self.message.receiver)

    @property
    def payload_bytes(self) -> int:
        """Of the message."""
        return int(self.message.payload_bytes)

    @property
    def name(self) -> str:
        """The message's kind in a word."""
        return str(self.message.name)

    @property
    def place(self) -> tuple[int, ...]:
        """Which of its sender's messages of this kind it is: equal for one that is sent again."""
        return self.run, *self.message.place

    @property
    def since(self) -> None:
        """Whoever sends it again may lack anything."""
        return None

    @property
    def asks(self) -> bool:
        """Whether it only asks for what its sender waits for."""
        return bool(self.message.asks)

    @property
    def decides(self) -> bool:
        """No run ends it all."""
        return False

    def check(self) -> None:
        """:class:`~maslam.backend.errors.BackendError` where the message's numbers cannot be."""
        self.message.check()
