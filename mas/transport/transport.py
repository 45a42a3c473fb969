"""Carrying messages and counting them: payload as the published tables count it, and true wire bytes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from ..protocol.accounting import Traffic
from ..protocol.ids import ContractId
from ..protocol.messages import Award, Message, decode, encode
from ..protocol.tasks import OwnerQuery
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


@dataclass(frozen=True)
class HandedOver:
    """Bytes that have arrived: who handed them over, as the transport knows it (on a network by its certificate, never
    by the bytes), and for whom."""

    sender: int
    recipient: int
    data: bytes


@dataclass(frozen=True)
class RefusedMessage:
    """Bytes that are no message, or one in another's name: who handed them over, to whom, and what is wrong."""

    sender: int
    recipient: int
    reason: str


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
    once. It knows who hands a message over, whatever the message says: one in another's name is not delivered.

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
        self.owner_queries: dict[int, int] = {}
        self.refused = 0
        self._record = record

    def send(self, message: Message, now_ns: int, handed_by: int | None = None) -> None:
        """Encode, count and take on the way. ``handed_by``: the agent that hands it over, if that is not the sender
        that it names. A message longer than any recipient would take is an error of the sender."""
        data = encode(message)
        body = message.body
        if len(data) > self.max_message_bytes:
            raise MessageError(
                f"agent {message.sender}: {body.kind} of {len(data)} bytes, at most {self.max_message_bytes} travel"
            )
        sender = message.sender if handed_by is None else handed_by
        ends = (now_ns, sender, message.recipient)
        sent = Sent(*ends, body.traffic, body.kind, body.payload_bytes, len(data))
        self.by_operation[sent.operation].add(sent)
        self.by_pair.setdefault((sender, message.recipient), TrafficCount()).add(sent)
        if isinstance(body, Award) and isinstance(body.task, OwnerQuery):
            self.owner_queries[message.recipient] = self.owner_queries.get(message.recipient, 0) + 1
        if message.contract is not None:
            self.by_contract.setdefault(message.contract, TrafficCount()).add(sent)
        if self._record is not None:
            self._record(sent)
        self.carry(sender, message.recipient, data)

    def receive(self) -> Message | RefusedMessage | None:
        """The next message to deliver, or what is wrong with bytes that cannot be believed, which count in ``refused``;
        None when nothing is on the way."""
        arrived = self.arrive()
        if arrived is None:
            return None
        sender, recipient = arrived.sender, arrived.recipient
        try:
            message = decode(arrived.data, self.max_message_bytes)
            if message.recipient != recipient:
                raise MessageError(f"message for agent {message.recipient} came to agent {recipient}")
            if message.sender != sender:
                raise MessageError(f"agent {sender} sends in the name of agent {message.sender}")
            return message
        except MessageError as error:
            self.refused += 1
            return RefusedMessage(sender, recipient, str(error))

    def advance(self, now_ns: int) -> None:  # noqa: B027 - most transports need not know
        """Logical time goes on; what is due by now arrives."""

    @property
    def waiting(self) -> bool:
        """Whether messages are on the way that are due later."""
        return False

    @abstractmethod
    def carry(self, sender: int, recipient: int, data: bytes) -> None:
        """Put bytes that the agent ``sender`` hands over on the way to the agent ``recipient``; they may not change on
        it."""

    @abstractmethod
    def arrive(self) -> HandedOver | None:
        """The next message that has arrived, None when none is due by now."""


class InProcessTransport(Transport):
    """All agents in one process: bytes arrive in the order in which they were sent, at once and whole."""

    def __init__(
        self, max_message_bytes: int = MAX_MESSAGE_BYTES, record: Callable[[Sent], None] | None = None
    ) -> None:
        super().__init__(max_message_bytes, record)
        self._queue: deque[HandedOver] = deque()

    def carry(self, sender: int, recipient: int, data: bytes) -> None:
        self._queue.append(HandedOver(sender, recipient, data))

    def arrive(self) -> HandedOver | None:
        return self._queue.popleft() if self._queue else None
