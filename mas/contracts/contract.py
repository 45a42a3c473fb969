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

Where messages get lost, come twice or overtake each other, the copies may differ for a while, never contradict:

* a message of a type that was sent already is :class:`Repeated`: it changes nothing, and is answered with one's own
  last message;
* a result confirms as well (:data:`RESULT_CONFIRMS`), as its contractor committed itself before;
* a manager calls anew only when its earlier contract of the kind has ended: the contractor ends its copy of that too;
* whatever arrives after the end, or after a newer call, is a :class:`LateMessage`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

from ..errors import ProtocolError
from ..protocol.ids import ContractId, OperationKind
from ..protocol.messages import Award, Bid, Cancel, Confirmation, ContractBody, Failure, Refusal, Rejection, Result


class LateMessage(ProtocolError):
    """A message that crossed the end of its contract on the way: nothing is wrong, and nothing is to be done."""


class Repeated(LateMessage):
    """A message that its contract has received already: nothing changes, but the other side may have missed the
    answer."""

    def __init__(self, contract: Contract, text: str) -> None:
        super().__init__(text)
        self.contract = contract


class ContractState(StrEnum):
    """States of a contract (Smith 1980): after the call the bid, the award, the work; the other six are ends."""

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


ENDED = frozenset(
    {
        ContractState.DONE,
        ContractState.REFUSED,
        ContractState.REJECTED,
        ContractState.FAILED,
        ContractState.CANCELLED,
        ContractState.EXPIRED,
    }
)

# Who may send what, in which state, and what follows. A call opens a contract and cannot come twice.
CONTRACTOR_SENDS: dict[tuple[ContractState, type], ContractState] = {
    (ContractState.CALLED, Bid): ContractState.BID,
    (ContractState.CALLED, Refusal): ContractState.REFUSED,
    (ContractState.AWARDED, Confirmation): ContractState.WORKING,
    (ContractState.AWARDED, Failure): ContractState.FAILED,
    (ContractState.WORKING, Result): ContractState.DONE,
    (ContractState.WORKING, Failure): ContractState.FAILED,
}
MANAGER_SENDS: dict[tuple[ContractState, type], ContractState] = {
    (ContractState.BID, Award): ContractState.AWARDED,
    (ContractState.BID, Rejection): ContractState.REJECTED,
    (ContractState.CALLED, Cancel): ContractState.CANCELLED,
    (ContractState.BID, Cancel): ContractState.CANCELLED,
    (ContractState.AWARDED, Cancel): ContractState.CANCELLED,
    (ContractState.WORKING, Cancel): ContractState.CANCELLED,
}
# What a manager takes although it missed the confirmation; no contractor may send it so.
RESULT_CONFIRMS: dict[tuple[ContractState, type], ContractState] = {(ContractState.AWARDED, Result): ContractState.DONE}


@dataclass(frozen=True)
class Contract:
    """One side's copy. ``deadline_ns``: logical time after which it has expired; ``exchanged``: the types of
    the messages so far."""

    id: ContractId
    contractor: int
    operation: OperationKind
    deadline_ns: int
    state: ContractState = ContractState.CALLED
    reason: str = ""
    exchanged: frozenset[type] = frozenset()

    @property
    def manager(self) -> int:
        """The agent that called."""
        return self.id.manager

    @property
    def ended(self) -> bool:
        """Whether nothing more is due from either side."""
        return self.state in ENDED


def advance(contract: Contract, sender: int, body: ContractBody, received: bool = False) -> Contract:
    """The contract after ``sender`` has sent ``body``; :class:`ProtocolError` if it may not, :class:`Repeated` if it
    has sent one before. ``received``: this is the copy of the one who receives it."""
    table = {contract.manager: MANAGER_SENDS, contract.contractor: CONTRACTOR_SENDS}.get(sender)
    key = (contract.state, type(body))
    state = table.get(key) if table else None
    if state is None and received and sender == contract.contractor:
        state = RESULT_CONFIRMS.get(key)
    if state is None:
        name = type(body).__name__
        text = (
            f"contract {contract.id.manager}:{contract.id.number} with {contract.contractor}: "
            f"agent {sender} may not send {name} when it is {contract.state}"
        )
        raise Repeated(contract, text) if table and type(body) in contract.exchanged else ProtocolError(text)
    return replace(
        contract, state=state, reason=getattr(body, "reason", ""), exchanged=contract.exchanged | {type(body)}
    )


def failed(contract: Contract, reason: str) -> Contract:
    """The contract after a result that cannot be believed."""
    return replace(contract, state=ContractState.FAILED, reason=reason)


def expire(contract: Contract, now_ns: int) -> Contract:
    """The contract, expired if its deadline has passed before its end."""
    if contract.ended or now_ns <= contract.deadline_ns:
        return contract
    return replace(contract, state=ContractState.EXPIRED, reason=f"{contract.state} when its time was over")
