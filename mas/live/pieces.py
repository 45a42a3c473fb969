"""Long messages between two agents, in pieces: few in flight at once, each sent again until it is acknowledged.

Short messages are not acknowledged here: contracts repeat what is not answered. A map of a megabyte would have to start
again from its first byte each time that one of its packets is lost.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

from .framing import PIECE_BYTES, MessagePiece, PiecesReceived, cut

IN_FLIGHT = 4
"""Pieces that may be on their way: 16 kB."""
_FIRST_WAIT_NS, _LONGEST_WAIT_NS = 300_000_000, 3_000_000_000
# A message of which nothing was acknowledged for so long is given up: its recipient is not there.
_GIVEN_UP_NS = 30_000_000_000
# Long messages that a recipient keeps the beginnings of, and finished ones that it remembers.
_UNFINISHED, _FINISHED = 4, 64
_BITS = 32


@dataclass
class _Outgoing:
    """``unsent`` indices; ``flying``: when each was sent last; ``acknowledged_ns``: when one was last."""

    pieces: list[MessagePiece]
    acknowledged_ns: int
    unsent: deque[int]
    flying: dict[int, int] = field(default_factory=dict)
    tries: dict[int, int] = field(default_factory=dict)


class PieceSender:
    """Long messages to one agent, one after the other. Times are of any clock that goes on."""

    def __init__(self) -> None:
        self._number = 0
        self._queue: deque[bytes] = deque()
        self._current: _Outgoing | None = None
        self.given_up = 0
        self._took_ns = _FIRST_WAIT_NS

    def put(self, message: bytes) -> None:
        """Take a message on its way, after those before it."""
        self._queue.append(message)

    @property
    def queued_bytes(self) -> int:
        """Bytes of messages that wait for the one on its way."""
        return sum(len(m) for m in self._queue)

    @property
    def busy(self) -> bool:
        """Whether anything is on its way or waits."""
        return self._current is not None or bool(self._queue)

    def due(self, now_ns: int) -> list[MessagePiece]:
        """Pieces to send now: new ones as far as there is room, and those that nobody acknowledged in time."""
        current = self._going(now_ns)
        if current is None:
            return []
        late = [i for i, at in sorted(current.flying.items()) if now_ns - at >= self._wait_ns(current, i)]
        for index in late:
            current.tries[index] = current.tries.get(index, 0) + 1
        while current.unsent and len(current.flying) < IN_FLIGHT:
            index = current.unsent.popleft()
            current.flying[index] = now_ns
            late.append(index)
        current.flying.update(dict.fromkeys(late, now_ns))
        return [current.pieces[i] for i in late]

    def acknowledge(self, received: PiecesReceived, now_ns: int) -> None:
        """The other side says which pieces it has."""
        current = self._current
        if current is None or current.pieces[0].number != received.number:
            return
        later = {received.first + bit for bit in range(_BITS) if received.later >> bit & 1}
        for index in [i for i in current.flying if i < received.first or i in later]:
            if not current.tries.get(index):
                self._took_ns = round(0.75 * self._took_ns + 0.25 * (now_ns - current.flying[index]))
            del current.flying[index]
            current.acknowledged_ns = now_ns
        if not current.flying and not current.unsent:
            self._current = None

    def _going(self, now_ns: int) -> _Outgoing | None:
        current = self._current
        if current is not None and now_ns - current.acknowledged_ns >= _GIVEN_UP_NS:
            self.given_up += 1
            current = self._current = None
        if current is None and self._queue:
            pieces = cut(self._number, self._queue.popleft())
            self._number = (self._number + 1) % 2**32
            current = self._current = _Outgoing(pieces, now_ns, deque(range(len(pieces))))
        return current

    def _wait_ns(self, current: _Outgoing, index: int) -> int:
        first = max(4 * self._took_ns, _FIRST_WAIT_NS // 3)
        return min(first * 2 ** current.tries.get(index, 0), _LONGEST_WAIT_NS)


@dataclass
class _Incoming:
    count: int
    parts: dict[int, bytes] = field(default_factory=dict)
    first: int = 0  # the first piece that has not come

    def add(self, index: int, data: bytes) -> None:
        self.parts[index] = data
        while self.first in self.parts:
            self.first += 1


@dataclass(frozen=True)
class PieceTaken:
    """What to answer to a piece, and the message that it completed."""

    answer: PiecesReceived | None
    message: bytes | None = None


class PieceReceiver:
    """Long messages of one agent, of at most ``max_message_bytes``; what does not fit together is dropped, and so is
    the oldest of too many that were begun."""

    def __init__(self, max_message_bytes: int) -> None:
        self.max_message_bytes = max_message_bytes
        self._begun: dict[int, _Incoming] = {}
        self._finished: dict[int, int] = {}

    def take(self, piece: MessagePiece) -> PieceTaken:
        """Keep a piece."""
        number = piece.number
        if number in self._finished:
            return PieceTaken(PiecesReceived(number, self._finished[number], 0))
        incoming = self._begun.get(number)
        if incoming is None:
            if (piece.count - 1) * PIECE_BYTES >= self.max_message_bytes:
                return PieceTaken(None)
            while len(self._begun) >= _UNFINISHED:
                del self._begun[next(iter(self._begun))]
            incoming = self._begun[number] = _Incoming(piece.count)
        if incoming.count != piece.count:
            return PieceTaken(None)
        incoming.add(piece.index, piece.data)
        if len(incoming.parts) < incoming.count:
            return PieceTaken(_answer(number, incoming))
        del self._begun[number]
        self._finished[number] = incoming.count
        if len(self._finished) > _FINISHED:
            del self._finished[next(iter(self._finished))]
        whole = b"".join(incoming.parts[i] for i in range(incoming.count))
        return PieceTaken(PiecesReceived(number, incoming.count, 0), whole)


def _answer(number: int, incoming: _Incoming) -> PiecesReceived:
    later = sum(1 << bit for bit in range(_BITS) if incoming.first + bit in incoming.parts)
    return PiecesReceived(number, incoming.first, later)
