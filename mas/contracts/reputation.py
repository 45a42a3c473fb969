"""Reputation of each other agent, from the outcome of an agent's own contracts with it (thesis
section 2.2.5). No agent is asked about another one: reports cannot lower a third agent's reputation.

Reputation is reliability times consistency, each the mean of a Beta posterior:

    reliability = (g + 1) / (g + p + 1.25)      g: delivered, p: not delivered, older ones forgotten by ``forgetting``
    consistency = (t + 3) / (t + f + 3.5)       t: results that others bear out, f: those that they contradict

An agent that sent nothing in two contracts running, or fell below the limit of either, is not called any more but for a
probe every ``probe_s``: one that comes back, or was judged wrongly, is taken in again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..config import ReputationConfig
from ..protocol.ids import OperationKind
from ..protocol.messages import Award, Bid, Confirmation, Result
from .contract import Contract, ContractState

# Weight of a contract that ended without its result: not delivered, declared failed, or stuck among several members.
_NOT_DELIVERED, _FAILED, _STUCK = 1.0, 0.25, 0.5
# Weight of a message that was refused; of an answer that led to a key-frame that is not there, more than the answer's
# own.
_REFUSED, _MISLED = 0.5, 3.0
# Contracts without a single message that make an agent silent.
_SILENT_AFTER = 2
SILENT = "silent"
CALLED_ANEW = "its manager calls anew"
NEVER_BEGAN = "the optimisation never began"


class Trust(StrEnum):
    """Trust in an agent, which decides whether it is called."""

    GOOD = "good"
    SILENT = "silent"
    UNDELIVERING = "does not deliver"
    UNTRUSTED = "not trusted"


@dataclass
class Reputation:
    """One agent's figures: whole contracts by end, the two pairs of counts, and when the next probe is due."""

    delivered: int = 0
    failed: int = 0
    expired: int = 0
    g: float = 0.0
    p: float = 0.0
    t: float = 0.0
    f: float = 0.0
    blamed: float = 0.0
    refused: int = 0
    stalled: int = 0
    stalls_until_ns: int = 0
    unanswered: int = 0
    probe_ns: int = 0
    trust: Trust = Trust.GOOD

    @property
    def reliability(self) -> float:
        """Mean share of contracts that it delivers, 0 to 1."""
        return (self.g + 1.0) / (self.g + self.p + 1.25)

    @property
    def consistency(self) -> float:
        """Mean share of its results that others bear out, 0 to 1."""
        return (self.t + 3.0) / (self.t + self.f + self.blamed + 3.5)

    @property
    def value(self) -> float:
        """Reputation, 0 to 1."""
        return self.reliability * self.consistency


@dataclass(frozen=True)
class TrustChange:
    """Trust in ``other`` is another than it was, and the figures that this follows from."""

    other: int
    trust: Trust
    reliability: float
    consistency: float
    unanswered: int


class ReputationBook:
    """The records of one agent about the others. What changes a record returns the :class:`TrustChange` that it makes:
    none, or one. ``now_ns``: logical time; an agent that is not trusted any more is probed ``probe_s`` later."""

    def __init__(self, config: ReputationConfig) -> None:
        self.config = config
        self.records: dict[int, Reputation] = {}

    def of(self, other: int) -> Reputation:
        """The record of one agent; a stranger's is empty."""
        record = self.records.get(other)
        if record is None:
            record = self.records[other] = Reputation()
        return record

    def received(self, other: int, now_ns: int) -> tuple[TrustChange, ...]:
        """A message of the other, whatever it is: it is there."""
        self.of(other).unanswered = 0
        return self._changed(other, now_ns)

    def ended(self, contract: Contract, now_ns: int) -> tuple[TrustChange, ...]:
        """A contract that I managed has ended. What I ended myself, or never awarded, is not held against anybody."""
        record = self.of(contract.contractor)
        if contract.state is ContractState.DONE:
            record.delivered += 1
            self._count(record, good=1.0)
        elif contract.state is ContractState.FAILED:
            record.failed += 1
            # Who says that it cannot do the work is more reliable than who sends a result that is none.
            self._count(record, poor=_NOT_DELIVERED if Result in contract.exchanged else _FAILED)
        elif contract.state is ContractState.EXPIRED or contract.reason == SILENT:
            record.expired += 1
            if Award in contract.exchanged:
                stuck = contract.operation is OperationKind.DOPT and contract.reason != SILENT
                self._count(record, poor=_STUCK if stuck else _NOT_DELIVERED)
            elif Bid not in contract.exchanged:
                record.unanswered += 1
        return self._changed(contract.contractor, now_ns)

    def served(self, contract: Contract, now_ns: int) -> tuple[TrustChange, ...]:
        """A contract in which I was the contractor has ended. An optimisation that never ended, began or was awarded:
        its manager answers for that."""
        if contract.operation is not OperationKind.DOPT:
            return ()
        record = self.of(contract.manager)
        if contract.state is ContractState.DONE:
            record.stalled = 0
        never_ended = contract.state is ContractState.EXPIRED and Confirmation in contract.exchanged
        if never_ended or contract.reason == NEVER_BEGAN:
            self._count(record, poor=_STUCK)
            self._stall(record, now_ns)
        left_hanging = contract.state is ContractState.EXPIRED or contract.reason == CALLED_ANEW
        if left_hanging and Bid in contract.exchanged and Award not in contract.exchanged:
            self._stall(record, now_ns)
        return self._changed(contract.manager, now_ns)

    def stalled(self, other: int, now_ns: int) -> None:
        """Because of the other an optimisation came to nothing."""
        self._stall(self.of(other), now_ns)

    def stalls(self, other: int, now_ns: int) -> bool:
        """Whether optimisations with the other are left alone for now, as they came to nothing."""
        return now_ns < self.of(other).stalls_until_ns

    def _stall(self, record: Reputation, now_ns: int) -> None:
        """Longer each time that it happens without a good end in between."""
        record.stalled += 1
        record.stalls_until_ns = now_ns + round(record.stalled * self.config.probe_s * 1e9)

    def misled(self, other: int, now_ns: int) -> tuple[TrustChange, ...]:
        """The other named a key-frame of a third agent that this one does not have."""
        record = self.of(other)
        record.failed += 1
        self._count(record, poor=_MISLED)
        return self._changed(other, now_ns)

    def judged(self, other: int, borne_out: int, contradicted: int, now_ns: int) -> tuple[TrustChange, ...]:
        """Set how many of the other's results agree with the rest of what is known, and how many do not."""
        record = self.of(other)
        record.t, record.f = float(borne_out), float(contradicted)
        return self._changed(other, now_ns)

    def refused(self, other: int, now_ns: int) -> tuple[TrustChange, ...]:
        """A message of the other could not be believed or acted on."""
        record = self.of(other)
        record.refused += 1
        self._count(record, poor=_REFUSED)
        return self._changed(other, now_ns)

    def blame(self, other: int, now_ns: int) -> tuple[TrustChange, ...]:
        """One more bad result, of a kind that is judged once: a map that was rejected."""
        self.of(other).blamed += 1.0
        return self._changed(other, now_ns)

    def may_call(self, other: int, now_ns: int) -> bool:
        """Whether a call is worth its bytes now."""
        return self.trust(other) is Trust.GOOD or now_ns >= self.of(other).probe_ns

    def called(self, other: int, now_ns: int) -> None:
        """A call went out: to one that is not trusted that was the probe."""
        record = self.of(other)
        if self.trust(other) is not Trust.GOOD and now_ns >= record.probe_ns:
            record.probe_ns = now_ns + round(self.config.probe_s * 1e9)

    def trust(self, other: int) -> Trust:
        """Trust in the other now."""
        record = self.of(other)
        if record.consistency < self.config.consistency:
            return Trust.UNTRUSTED
        if record.unanswered >= _SILENT_AFTER:
            return Trust.SILENT
        return Trust.UNDELIVERING if record.reliability < self.config.reliability else Trust.GOOD

    def _changed(self, other: int, now_ns: int) -> tuple[TrustChange, ...]:
        """The change of trust that the figures of one agent make now; the first probe waits its time."""
        record, trust = self.of(other), self.trust(other)
        if trust is record.trust:
            return ()
        if record.trust is Trust.GOOD:
            record.probe_ns = now_ns + round(self.config.probe_s * 1e9)
        record.trust = trust
        return (TrustChange(other, trust, record.reliability, record.consistency, record.unanswered),)

    def _count(self, record: Reputation, good: float = 0.0, poor: float = 0.0) -> None:
        keep = self.config.forgetting
        record.g, record.p = keep * record.g + good, keep * record.p + poor
