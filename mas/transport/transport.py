"""Carrying messages and counting them: payload as the published tables count it, and true wire bytes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from ..protocol.accounting import Traffic
from ..protocol.ids import ContractId
from ..protocol.messages import Message, decode, encode
from ..protocol.tensors import MessageError

MAX_MESSAGE_BYTES = 64 * 2**20


@dataclass(frozen=True)
class Sent:
    """One message that was transmitted, as ``traffic.csv`` lists it."""

    now_ns: int
    sender: int
    recipient: int
    operation: Traffic
    kind: str
    payload_bytes: int
    wire_bytes: int


@dataclass
class TrafficCount:
    """Messages and bytes so far."""

    messages: int = 0
    payload_bytes: int = 0
    wire_bytes: int = 0

    def add(self, sent: Sent) -> None:
        """Count one more message."""
        self.messages += 1
        self.payload_bytes += sent.payload_bytes
        self.wire_bytes += sent.wire_bytes


class Transport(ABC):
    """Takes typed messages, carries bytes, delivers typed messages; each message is encoded, counted and checked
    once.

    A user's own derives from this class, says how bytes travel (:meth:`carry`, :meth:`arrive`), and is given as
    ``maslam.run(..., transport=...)`` or by an entry point of the group ``maslam.transports``.
    """

    def __init__(
        self, max_message_bytes: int = MAX_MESSAGE_BYTES, record: Callable[[Sent], None] | None = None
    ) -> None:
        self.begin(max_message_bytes, record)

    def begin(self, max_message_bytes: int, record: Callable[[Sent], None] | None = None) -> None:
        """A run begins: longer messages are neither sent nor taken, ``record`` is called with each one sent, and all
        counts are 0."""
        self.max_message_bytes = max_message_bytes
        self.by_operation: dict[Traffic, TrafficCount] = {t: TrafficCount() for t in Traffic}
        self.by_pair: dict[tuple[int, int], TrafficCount] = {}
        self.by_contract: dict[ContractId, TrafficCount] = {}
        self.refused: list[tuple[int, str]] = []
        self._record = record

    def send(self, message: Message, now_ns: int) -> None:
        """Encode, count and take on the way. A message longer than any recipient would take is an error of the
        sender."""
        data = encode(message)
        body = message.body
        if len(data) > self.max_message_bytes:
            raise MessageError(
                f"agent {message.sender}: {body.kind} of {len(data)} bytes, at most {self.max_message_bytes} travel"
            )
        ends = (now_ns, message.sender, message.recipient)
        sent = Sent(*ends, body.traffic, body.kind, body.payload_bytes, len(data))
        self.by_operation[sent.operation].add(sent)
        self.by_pair.setdefault((message.sender, message.recipient), TrafficCount()).add(sent)
        if message.contract is not None:
            self.by_contract.setdefault(message.contract, TrafficCount()).add(sent)
        if self._record is not None:
            self._record(sent)
        self.carry(message.recipient, data)

    def receive(self) -> Message | None:
        """The next message to deliver, None when nothing is on the way; what cannot be believed is dropped and
        counted in ``refused`` with recipient and reason."""
        while (arrived := self.arrive()) is not None:
            recipient, data = arrived
            try:
                message = decode(data, self.max_message_bytes)
                if message.recipient != recipient:
                    raise MessageError(f"message for agent {message.recipient} came to agent {recipient}")
                return message
            except MessageError as error:
                self.refused.append((recipient, str(error)))
        return None

    def advance(self, now_ns: int) -> None:  # noqa: B027 - most transports need not know
        """Logical time goes on; what is due by now arrives."""

    @property
    def waiting(self) -> bool:
        """Whether messages are on the way that are due later."""
        return False

    @abstractmethod
    def carry(self, recipient: int, data: bytes) -> None:
        """Put bytes on the way to the agent ``recipient``; they may not change on it."""

    @abstractmethod
    def arrive(self) -> tuple[int, bytes] | None:
        """Recipient and bytes of the next message that has arrived, None when none is due by now."""


class InProcessTransport(Transport):
    """All agents in one process: bytes arrive in the order in which they were sent, at once and whole."""

    def __init__(
        self, max_message_bytes: int = MAX_MESSAGE_BYTES, record: Callable[[Sent], None] | None = None
    ) -> None:
        super().__init__(max_message_bytes, record)
        self._queue: deque[tuple[int, bytes]] = deque()

    def carry(self, recipient: int, data: bytes) -> None:
        self._queue.append((recipient, data))

    def arrive(self) -> tuple[int, bytes] | None:
        return self._queue.popleft() if self._queue else None
