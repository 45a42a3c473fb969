"""What an agent thinks of each other agent, from what came of its own contracts with it (the citizen approach, thesis
section 2.2.5). Nobody is asked about anybody else: nobody can be talked down.

Standing is reliability times honesty, each the mean of a Beta posterior:

    reliability = (g + 1) / (g + p + 1.25)      g: delivered, p: not delivered, older ones forgotten by ``forgetting``
    honesty     = (t + 3) / (t + f + 3.5)       t: results that others bear out, f: those that they contradict

Who did not say a word in two contracts running, or fell below the limit of either, is not called any more but for a
probe every ``probe_s``: so who comes back, or was wronged, is taken in again.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..config import StandingConfig
from ..protocol.ids import OperationKind
from ..protocol.messages import Award, Bid, Confirmation, Result
from .contract import Contract, ContractState

# What a contract that ended without its result counts as: not done, said so, or stuck among several members.
_NOT_DELIVERED, _FAILED, _STUCK = 1.0, 0.25, 0.5
# Contracts without a single word that make an agent silent.
_SILENT_AFTER = 2
SILENT = "silent"


class Trust(StrEnum):
    """How an agent is dealt with."""

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
    unheard: int = 0
    probe_ns: int = 0
    regard: Trust = Trust.GOOD

    @property
    def reliability(self) -> float:
        return (self.g + 1.0) / (self.g + self.p + 1.25)

    @property
    def honesty(self) -> float:
        return (self.t + 3.0) / (self.t + self.f + self.blamed + 3.5)

    @property
    def value(self) -> float:
        """Reputation, 0 to 1."""
        return self.reliability * self.honesty


class ReputationBook:
    """The records of one agent about the others."""

    def __init__(self, config: StandingConfig) -> None:
        self.config = config
        self.records: dict[int, Reputation] = {}
        # Whose figures may have changed since :meth:`changes` looked last.
        self._touched: set[int] = set()

    def of(self, other: int) -> Reputation:
        """The record of one agent, to look at; a stranger's is empty."""
        record = self.records.get(other)
        if record is None:
            record = self.records[other] = Reputation()
        return record

    def _touch(self, other: int) -> Reputation:
        """The record of one agent, to change it."""
        self._touched.add(other)
        return self.of(other)

    def received(self, other: int) -> None:
        """A message of the other, whatever it is: it is there."""
        self._touch(other).unheard = 0

    def ended(self, contract: Contract) -> None:
        """A contract that I managed has ended. What I ended myself, or never awarded, is not held against anybody."""
        record = self._touch(contract.contractor)
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
                record.unheard += 1

    def left_waiting(self, contract: Contract) -> None:
        """An optimisation that I took part in never ended: its manager answers for that."""
        if (
            contract.operation is OperationKind.DOPT
            and contract.state is ContractState.EXPIRED
            and Confirmation in contract.exchanged
        ):
            self._count(self._touch(contract.manager), poor=_STUCK)

    def judged(self, other: int, borne_out: int, contradicted: int) -> None:
        """How many of the other's results now agree with the rest of what is known, and how many do not."""
        record = self._touch(other)
        record.t, record.f = float(borne_out), float(contradicted)

    def blame(self, other: int, weight: float = 1.0) -> None:
        """One more bad result, of a kind that is judged once: a map that was rejected."""
        self._touch(other).blamed += weight

    def may_call(self, other: int, now_ns: int) -> bool:
        """Whether a call is worth its bytes now."""
        return self.regard(other) is Trust.GOOD or now_ns >= self.of(other).probe_ns

    def called(self, other: int, now_ns: int) -> None:
        """A call went out: to one in bad standing that was the probe."""
        record = self.of(other)
        if self.regard(other) is not Trust.GOOD and now_ns >= record.probe_ns:
            record.probe_ns = now_ns + round(self.config.probe_s * 1e9)

    def regard(self, other: int) -> Trust:
        """How to deal with the other now."""
        record = self.of(other)
        if record.honesty < self.config.honesty:
            return Trust.UNTRUSTED
        if record.unheard >= _SILENT_AFTER:
            return Trust.SILENT
        return Trust.UNDELIVERING if record.reliability < self.config.reliability else Trust.GOOD

    def changes(self, now_ns: int) -> list[tuple[int, Reputation]]:
        """Agents that are regarded otherwise than when this was asked last; the first probe waits its time."""
        out = []
        touched, self._touched = self._touched, set()
        for other in sorted(touched):
            record, regard = self.of(other), self.regard(other)
            if regard is not record.regard:
                if record.regard is Trust.GOOD:
                    record.probe_ns = now_ns + round(self.config.probe_s * 1e9)
                record.regard = regard
                out.append((other, record))
        return out

    def _count(self, record: Reputation, good: float = 0.0, poor: float = 0.0) -> None:
        keep = self.config.forgetting
        record.g, record.p = keep * record.g + good, keep * record.p + poor
