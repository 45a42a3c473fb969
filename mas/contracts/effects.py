"""Effects of a message or of time: values that an operation returns, and that its agent acts on.

No operation reaches into another one, or leaves anything for others to collect. It changes its own state and returns
:class:`Effects`; the agent passes ``ended`` and ``changes`` on to whom they concern until nothing follows any more, and
returns what is left of them, messages and events, to its environment.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

from ..protocol.messages import Message
from ..state.pose_graph import Adoption, UpdatedPoses
from .contract import Contract
from .reputation import TrustChange


@dataclass(frozen=True)
class Event:
    """A line of ``events.jsonl``: what happened to ``agent`` at ``now_ns`` (logical time), with its figures."""

    now_ns: int
    agent: int
    kind: str
    fields: dict[str, Any]


@dataclass(frozen=True)
class MembersMissed:
    """Some members have not adopted the last optimisation, or were not there: its matches are pending once more."""


Change = Adoption | UpdatedPoses | MembersMissed | TrustChange
"""A change by one operation that others act on."""


@dataclass(frozen=True)
class Effects:
    """``messages`` to send and ``events`` to log, both in order; ``ended``: contracts that came to their end;
    ``changes`` that concern other operations. ``a + b``: first a, then b."""

    messages: tuple[Message, ...] = ()
    events: tuple[Event, ...] = ()
    ended: tuple[Contract, ...] = ()
    changes: tuple[Change, ...] = ()

    def __add__(self, other: Effects) -> Effects:
        return Effects(
            self.messages + other.messages,
            self.events + other.events,
            self.ended + other.ended,
            self.changes + other.changes,
        )

    @property
    def outward(self) -> Effects:
        """Messages and events alone."""
        return Effects(self.messages, self.events)


NOTHING = Effects()


def total(effects: Iterable[Effects]) -> Effects:
    """All of them, in order."""
    return sum(effects, NOTHING)
