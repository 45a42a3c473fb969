"""The contract net as one table (Smith 1980; with confirmation: thesis section 2.2.5). No I/O, no clock.

    manager                      contractor
    Call            ->                              CALLED
                    <-           Bid | Refusal      BID | REFUSED
    Award | Rejection ->                            AWARDED | REJECTED
                    <-           Confirmation       WORKING: committed only now
                    <-           Result | Failure   DONE | FAILED
    Cancel          ->                              CANCELLED, at any time before the end
                 deadline passed                    EXPIRED, at both sides on their own

A :class:`Contract` is between one manager and one contractor; a call to many opens one with each, under one id. Both
sides keep their own copy and :func:`advance` it by the same table, so that neither can be led where the other is not
allowed to go: no award without a bid, no work without an award, and every contract ends.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from mas.errors import MasError
from mas.identities import ContractId, Operation
from mas.messages import Award, Bid, Call, Cancel, Confirmation, ContractBody, Failure, Refusal, Rejection, Result


class ProtocolError(MasError):
    """A message that its contract does not allow now, or from this sender."""


class LateMessage(ProtocolError):
    """A message that crossed the end of its contract on the way: nothing is wrong, and nothing is to be done."""


class State(StrEnum):
    CALLED = "called"
    BID = "bid"
    AWARDED = "awarded"
    WORKING = "working"
    DONE = "done"
    REFUSED = "refused"
    REJECTED = "rejected"
    FAILED = "failed"
    CANCELLED = "cancelled"
    EXPIRED = "expired"


ENDED = frozenset({State.DONE, State.REFUSED, State.REJECTED, State.FAILED, State.CANCELLED, State.EXPIRED})

# Who may say what, in which state, and what follows. A call opens a contract and cannot come twice.
CONTRACTOR_SAYS: dict[tuple[State, type], State] = {
    (State.CALLED, Bid): State.BID,
    (State.CALLED, Refusal): State.REFUSED,
    (State.AWARDED, Confirmation): State.WORKING,
    (State.AWARDED, Failure): State.FAILED,
    (State.WORKING, Result): State.DONE,
    (State.WORKING, Failure): State.FAILED,
}
MANAGER_SAYS: dict[tuple[State, type], State] = {
    (State.BID, Award): State.AWARDED,
    (State.BID, Rejection): State.REJECTED,
    (State.CALLED, Cancel): State.CANCELLED,
    (State.BID, Cancel): State.CANCELLED,
    (State.AWARDED, Cancel): State.CANCELLED,
    (State.WORKING, Cancel): State.CANCELLED,
}


@dataclass(frozen=True)
class Contract:
    """One side's copy. ``deadline_ns``: logical time after which it has expired."""

    id: ContractId
    contractor: int
    operation: Operation
    deadline_ns: int
    state: State = State.CALLED
    reason: str = ""

    @property
    def manager(self) -> int:
        return self.id.manager

    @property
    def ended(self) -> bool:
        return self.state in ENDED


def advance(contract: Contract, sender: int, body: ContractBody) -> Contract:
    """The contract after ``sender`` said ``body``; :class:`ProtocolError` if it may not."""
    table = {contract.manager: MANAGER_SAYS, contract.contractor: CONTRACTOR_SAYS}.get(sender)
    state = table.get((contract.state, type(body))) if table else None
    if state is None:
        said = type(body).__name__
        raise ProtocolError(
            f"contract {contract.id.manager}:{contract.id.number} with {contract.contractor}: "
            f"agent {sender} may not say {said} when it is {contract.state}"
        )
    return replace(contract, state=state, reason=getattr(body, "reason", ""))


def expire(contract: Contract, now_ns: int) -> Contract:
    """The contract, expired if its deadline has passed before its end."""
    if contract.ended or now_ns <= contract.deadline_ns:
        return contract
    return replace(contract, state=State.EXPIRED, reason=f"{contract.state} when its time was over")


# Ended contracts an agent remembers, to tell a late message from a wrong one.
_REMEMBERED = 10_000


class Ledger:
    """All running contracts of one agent, as manager and as contractor."""

    def __init__(self, me: int) -> None:
        self.me = me
        self._number = 0
        self._running: dict[tuple[ContractId, int], Contract] = {}
        self._heard: dict[int, int] = {}
        self._ended: dict[tuple[ContractId, int], None] = {}

    def call(self, operation: Operation, contractors: Iterable[int], deadline_ns: int) -> tuple[ContractId, list[int]]:
        """Open one contract as manager with each contractor; at most one of a kind a pair: those that still have one
        are left out. Returns the id and who is to be called."""
        busy = {c.contractor for c in self._running.values() if c.manager == self.me and c.operation is operation}
        free = sorted(set(contractors) - busy - {self.me})
        identity = ContractId(self.me, self._number)
        if free:
            self._number += 1
        for contractor in free:
            self._running[identity, contractor] = Contract(identity, contractor, operation, deadline_ns)
        return identity, free

    def called(self, sender: int, identity: ContractId, call: Call) -> Contract:
        """Open the contractor's side. A manager's numbers only rise: a call seen before is refused."""
        if identity.manager != sender or sender == self.me:
            raise ProtocolError(f"agent {sender} calls in the name of agent {identity.manager}")
        if identity.number <= self._heard.get(sender, -1):
            raise ProtocolError(f"call {sender}:{identity.number} came twice or too late")
        self._heard[sender] = identity.number
        contract = Contract(identity, self.me, call.operation, call.deadline_ns)
        self._running[identity, self.me] = contract
        return contract

    def get(self, identity: ContractId, contractor: int) -> Contract:
        """The running contract; :class:`LateMessage` if it has ended, :class:`ProtocolError` if there never was one."""
        contract = self._running.get((identity, contractor))
        if contract is None and (identity, contractor) in self._ended:
            raise LateMessage(f"contract {identity.manager}:{identity.number} with {contractor} has ended")
        if contract is None:
            raise ProtocolError(f"no running contract {identity.manager}:{identity.number} with {contractor}")
        return contract

    def say(self, contract: Contract, sender: int, body: ContractBody) -> Contract:
        """Advance a contract by what ``sender`` said, and keep the result while it runs."""
        after = advance(contract, sender, body)
        self._keep(after)
        return after

    def expired(self, now_ns: int) -> list[Contract]:
        """Contracts whose deadline has passed: ended by this, sorted."""
        over = [c for c in (expire(c, now_ns) for c in self._running.values()) if c.ended]
        for contract in over:
            self._keep(contract)
        return sorted(over, key=lambda c: (c.id, c.contractor))

    def managed(self, identity: ContractId) -> list[Contract]:
        """The running contracts of one of my calls, by contractor."""
        return [c for (i, _), c in sorted(self._running.items()) if i == identity and c.manager == self.me]

    def running(self, operation: Operation | None = None) -> list[Contract]:
        """All running contracts, of one operation or of all, sorted."""
        found = [c for c in self._running.values() if operation is None or c.operation is operation]
        return sorted(found, key=lambda c: (c.id, c.contractor))

    def _keep(self, contract: Contract) -> None:
        key = (contract.id, contract.contractor)
        if contract.ended:
            self._running.pop(key, None)
            self._ended[key] = None
            if len(self._ended) > _REMEMBERED:
                del self._ended[next(iter(self._ended))]
        elif key in self._running:
            self._running[key] = contract
