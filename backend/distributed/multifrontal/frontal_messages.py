"""Messages of robots that eliminate: one kind of envelope; ``reports.py`` has the bodies."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

from ..envelope import Envelope

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
class FrontalMessage(Envelope):
    """``number``: of the pass that it belongs to; of ``WAIT``, of what its sender waits for."""

    kind: FrontalKind

    header = struct.Struct("<BHHH")
    first_kind = FIRST_FRONTAL_KIND
    kinds = FrontalKind
    of = "an eliminating robot's"

    @property
    def decides(self) -> bool:
        """Whether whoever has it needs no answer."""
        return self.kind in (FrontalKind.START, FrontalKind.ORDER, FrontalKind.STEP)
