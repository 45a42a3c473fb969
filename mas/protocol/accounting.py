"""Accounting of messages: the purpose, the kind, and the payload as the published tables count it."""

from __future__ import annotations

from enum import StrEnum
from typing import ClassVar

import msgspec

from .ids import OperationKind


class Traffic(StrEnum):
    """Purpose of a message; everything that is neither task nor outcome nor solver message is negotiation."""

    DVPR = "dvpr"
    RELPOSE = "relpose"
    DOPT = "dopt"
    MAPMERGE = "mapmerge"
    NEGOTIATION = "negotiation"


class Counted(msgspec.Struct, frozen=True, array_like=True):
    """Part of a message. ``belongs_to``: the operation whose work it is, None where it only negotiates."""

    belongs_to: ClassVar[OperationKind | None] = None

    @property
    def traffic(self) -> Traffic:
        """The purpose that its bytes are counted for."""
        return Traffic.NEGOTIATION if self.belongs_to is None else Traffic[self.belongs_to.name]

    @property
    def kind(self) -> str:
        """Its kind in a word, as ``traffic.csv`` lists it."""
        return type(self).__name__

    @property
    def payload_bytes(self) -> int:
        """Bytes as the published tables count them, which know no negotiation, no headers and no lengths."""
        return 0
