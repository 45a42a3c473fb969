"""Messages of robots that solve with priors: sums and decisions between runs of the method, and the method's own."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader
from ..envelope import Envelope

# Far from the kinds of the other solvers' messages, so that a stray one is recognised.
FIRST_PRIOR_KIND = 0xC0
IN_A_RUN = 0xC8
"""First byte of a method's own message in one of its runs."""


class PriorKind(IntEnum):
    """Kinds of message: sums, up the tree of members; what follows, down it."""

    SUMS = 0
    NEXT = 1


@dataclass(frozen=True)
class PriorMessage(Envelope):
    """``number``: how many decisions there were before it."""

    kind: PriorKind

    header = struct.Struct("<BHHH")
    first_kind = FIRST_PRIOR_KIND
    kinds = PriorKind
    of = "a message about priors, no such"

    @property
    def decides(self) -> bool:
        """Whether whoever has it needs no answer."""
        return self.kind is PriorKind.NEXT


def numbers_in(body: bytes) -> Array:
    """The numbers of a body, all finite."""
    if len(body) % 8:
        raise BackendError(f"sums of priors in {len(body)} bytes")
    numbers = CompactReader(body).array(len(body) // 8, "<f8")
    if not np.isfinite(numbers).all():
        raise BackendError("sums of priors that are not finite")
    return numbers


def body_of(numbers: Array) -> bytes:
    """Inverse of :func:`numbers_in`."""
    return np.asarray(numbers, dtype="<f8").tobytes()
