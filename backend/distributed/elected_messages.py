"""Messages of an elected group: one kind of envelope; ``contribution.py`` and ``solution.py`` have its bodies."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from .envelope import Envelope

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
class ElectedMessage(Envelope):
    """``number``: the term, how many elected robots have fallen silent so far, as the sender knows."""

    kind: Kind

    header = struct.Struct("<BBHH")
    first_kind = FIRST_KIND
    kinds = Kind
    of = "an elected solver's"

    @property
    def term(self) -> int:
        """See ``number``."""
        return self.number

    @property
    def place(self) -> tuple[int, ...]:
        """See :class:`Envelope`."""
        again = self.body[:1] if self.kind in (Kind.FINER, Kind.REMAINDER) else b""
        return *super().place, *again

    @property
    def decides(self) -> bool:
        """Whether whoever has it needs no answer."""
        return self.kind in (Kind.SIZE, Kind.DECISION)
