"""Who of an elected group leads it, term by term, and patience with who is silent: messages without their contents."""

from __future__ import annotations

import struct
from abc import ABC, abstractmethod
from collections.abc import Iterable
from typing import Any

from ..config import SolverConfig
from ..errors import BackendError
from .elected_messages import ElectedMessage, Kind
from .share import Share, SolverOutcome

_SIZE = struct.Struct("<I")
_WAIT = struct.Struct("<B")
# Messages of a member that are kept until it is known who is elected.
_EARLY = 16


class ElectedTerms(ABC):
    """Call ``start()`` once, then ``handle`` with every message addressed to it, in any order; send what they return.

    ``outcome`` is None while it works. ``tick()`` asks for what has not come, which its sender then sends again: a few
    bytes instead of a whole graph. And it counts: after ``elected_patience`` ticks without a word the elected robot
    leaves silent members out; after twice as many the members turn to the next robot. Members left out keep their
    poses.
    """

    def __init__(self, share: Share, config: SolverConfig) -> None:
        self.share = share
        self.outcome: SolverOutcome | None = None
        self._config = config
        self._sizes: dict[int, int] = {}
        self._order: list[int] = []
        self._term = self._silent = 0
        self._left_out: set[int] = set()
        self._said: list[ElectedMessage] = []
        self._early: list[ElectedMessage] = []

    # -- supplied by who knows the contents --------------------------------------------------------------------------

    @abstractmethod
    def _begin(self) -> list[ElectedMessage]:
        """Begin a term: contribute to its elected robot, or begin to gather."""

    @abstractmethod
    def _begin_without(self, silent: set[int]) -> list[ElectedMessage]:
        """As the elected robot: begin although these members never said how much they have."""

    @abstractmethod
    def _take(self, message: ElectedMessage) -> list[ElectedMessage]:
        """Receive a message of this term."""

    @abstractmethod
    def _awaited_in_term(self) -> list[tuple[Kind, list[int]]]:
        """What has not come in this term, and from whom."""

    @abstractmethod
    def _go_on_without(self) -> list[ElectedMessage]:
        """As the elected robot, out of patience: go on without who is silent, or give up."""

    def _is_for(self, said: ElectedMessage, wanted: int) -> bool:
        """Whether a message is what its receiver waits for."""
        return bool(said.kind == wanted)

    # -- what happens to it ------------------------------------------------------------------------------------------

    @property
    def leader(self) -> int | None:
        """The elected robot; None until it is known."""
        return self._order[self._term % len(self._order)] if self._order else None

    def start(self) -> list[ElectedMessage]:
        """Return the first messages."""
        out = self._sizes_to_all()
        return [*out, *self._elect()] if len(self.share.members) == 1 else out

    def handle(self, message: ElectedMessage) -> list[ElectedMessage]:
        """Receive a message; returns the messages to send because of it."""
        if not isinstance(message, ElectedMessage):
            raise BackendError(f"robot {self.share.robot} was handed a message of another method")
        if message.receiver != self.share.robot or message.sender not in self.share.members:
            raise BackendError(
                f"robot {self.share.robot} was handed a message from {message.sender} for {message.receiver}"
            )
        if message.kind is Kind.WAIT and (self.outcome is not None or message.term <= self._term):
            return self._answer(message)
        if self.outcome is not None:
            return []
        if message.kind is Kind.SIZE:
            self._sizes[message.sender] = unpack(_SIZE, message.body)[0]
            if not self._order:
                return self._elect() if len(self._sizes) == len(self.share.members) else []
        elif not self._order and message.term == self._term:
            if sum(m.sender == message.sender for m in self._early) < _EARLY:
                self._early.append(message)
            return []
        out = self._join(message.term) if message.term > self._term else []
        if message.term < self._term:
            return out
        return [*out, *self._take(message)]

    def tick(self) -> list[ElectedMessage]:
        """Ask for what has not come; with patience at its end, return the messages that leave silent members out."""
        if self.outcome is not None:
            return []
        self._silent += 1
        waits = [wait for kind, members in self._awaited() for wait in self._wait(members, kind)]
        if self._silent < self._config.elected_patience:
            return waits
        if not self._order:
            return [*waits, *self._elect_without()]
        if self.leader == self.share.robot:
            return [*waits, *self._go_on_without()]
        if self._silent < 2 * self._config.elected_patience:
            return waits
        return self._join(self._term + 1)

    def again(self, message: ElectedMessage) -> list[ElectedMessage]:
        """What the sender of a message that came before may have missed: it asks for that, nothing else tells."""
        asks = isinstance(message, ElectedMessage) and message.kind is Kind.WAIT
        return self._answer(message) if asks else []

    def _awaited(self) -> list[tuple[Kind, list[int]]]:
        """What has not come, and from whom."""
        if not self._order:
            return [(Kind.SIZE, [r for r in self._others() if r not in self._sizes])]
        return self._awaited_in_term()

    def _answer(self, message: ElectedMessage) -> list[ElectedMessage]:
        """To a member that waits for something of this robot's: that, or the decision. Where this robot cannot give it
        yet, it asks for what it lacks in its own time."""
        asker, wanted = message.sender, unpack(_WAIT, message.body)[0]
        said = [m for m in self._said if m.receiver == asker]
        decision = [m for m in said if m.kind is Kind.DECISION]
        if decision:
            return decision
        if wanted == Kind.SIZE or message.term < self._term:
            return self._to([asker], Kind.SIZE, _SIZE.pack(self._sizes[self.share.robot]))
        return [m for m in said if self._is_for(m, wanted)]

    def _wait(self, members: list[int], kind: Kind) -> list[ElectedMessage]:
        return self._to(members, Kind.WAIT, _WAIT.pack(kind))

    def _sizes_to_all(self) -> list[ElectedMessage]:
        return self._to(self._others(), Kind.SIZE, _SIZE.pack(self._sizes[self.share.robot]))

    def _elect(self) -> list[ElectedMessage]:
        """Most to send first; a robot not yet received from comes last."""
        self._order = sorted(self.share.members, key=lambda r: (-self._sizes.get(r, -1), r))
        out = self._join(self._term)
        early, self._early = self._early, []
        return [*out, *(reply for message in early for reply in self.handle(message))]

    def _elect_without(self) -> list[ElectedMessage]:
        """Out of patience with members from which nothing has come: an elected robot goes on without them."""
        silent = {r for r in self._others() if r not in self._sizes}
        out = self._elect()
        return [*out, *self._begin_without(silent)] if self.leader == self.share.robot else out

    def _join(self, term: int) -> list[ElectedMessage]:
        """Begin a term."""
        if not self._order:
            self._order = sorted(self.share.members, key=lambda r: (-self._sizes.get(r, -1), r))
        self._term, self._silent, self._said = term, 0, []
        self._left_out = {r for r in self._order[: min(term, len(self._order))] if r != self.leader}
        return self._begin()

    def _others(self) -> list[int]:
        return [r for r in self.share.members if r != self.share.robot]

    def _members(self) -> list[int]:
        """The robots that take part."""
        return [r for r in self.share.members if r not in self._left_out]

    def _to(self, receivers: Iterable[int], kind: Kind, body: bytes) -> list[ElectedMessage]:
        return [ElectedMessage(kind, self._term, self.share.robot, r, body) for r in receivers]

    def _say(self, messages: list[ElectedMessage]) -> list[ElectedMessage]:
        """Send, and keep for retransmission until a newer message replaces it."""
        self._said = messages
        return list(messages)


def unpack(layout: struct.Struct, body: bytes) -> tuple[Any, ...]:
    """The numbers of a message's body; :class:`BackendError` where it is none."""
    try:
        return layout.unpack(body)
    except struct.error as error:
        raise BackendError(f"an elected solver's message of {len(body)} bytes does not fit its kind") from error
