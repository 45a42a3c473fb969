"""All contracts of one agent, as manager and as contractor: which of them run, and what ended."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from ..protocol.ids import ContractId, OperationKind
from ..protocol.messages import Call, Cancel, ContractBody, Rejection
from .contract import Contract, ContractState, LateMessage, ProtocolError, Repeated, advance, expire

# Ended contracts an agent remembers, to tell a late message from a wrong one.
_REMEMBERED = 10_000


class Ledger:
    """At most one contract of a kind runs with each other agent and direction. No I/O, no clock."""

    def __init__(self, me: int) -> None:
        self.me = me
        self.superseded: list[Contract] = []
        self._number = 0
        self._running: dict[tuple[ContractId, int], Contract] = {}
        self._heard: dict[tuple[int, OperationKind], int] = {}
        self._ended: dict[tuple[ContractId, int], Contract | None] = {}

    def call(
        self, operation: OperationKind, contractors: Iterable[int], deadline_ns: int
    ) -> tuple[ContractId, list[int]]:
        """Open one contract as manager with each contractor; those that still have one of the kind are left out.
        Returns the id and who is to be called."""
        busy = {c.contractor for c in self._running.values() if c.manager == self.me and c.operation is operation}
        free = sorted(set(contractors) - busy - {self.me})
        identity = ContractId(self.me, self._number)
        if free:
            self._number += 1
        for contractor in free:
            self._running[identity, contractor] = Contract(identity, contractor, operation, deadline_ns)
        return identity, free

    def called(self, sender: int, identity: ContractId, call: Call) -> Contract:
        """Open the contractor's side; it ends an earlier one of the kind, whose end at the manager was missed: that
        goes to ``superseded``. A call that was heard before is :class:`Repeated`; one older than the newest of its
        kind, or withdrawn before it came, is a :class:`LateMessage`."""
        if identity.manager != sender or sender == self.me:
            raise ProtocolError(f"agent {sender} calls in the name of agent {identity.manager}")
        key = (identity, self.me)
        known = self._running.get(key) or self._ended.get(key)
        if known is not None:
            raise Repeated(known, f"call {sender}:{identity.number} came twice")
        if key in self._ended or identity.number <= self._heard.get((sender, call.operation), -1):
            raise LateMessage(f"call {sender}:{identity.number} came too late")
        self._heard[sender, call.operation] = identity.number
        for old in self.running(call.operation):
            if old.manager == sender and old.contractor == self.me:
                over = replace(old, state=ContractState.CANCELLED, reason="its manager calls anew")
                self._keep(over)
                self.superseded.append(over)
        contract = Contract(identity, self.me, call.operation, call.deadline_ns)
        self._running[key] = contract
        return contract

    def get(self, identity: ContractId, contractor: int) -> Contract:
        """The running contract; :class:`LateMessage` if it has ended, :class:`ProtocolError` if there never was one."""
        key = (identity, contractor)
        contract = self._running.get(key)
        if contract is not None:
            return contract
        name = f"{identity.manager}:{identity.number} with {contractor}"
        ended = self._ended.get(key)
        if ended is not None:
            raise Repeated(ended, f"contract {name} has ended")
        if key in self._ended:
            raise LateMessage(f"contract {name} was withdrawn before it began")
        raise ProtocolError(f"no running contract {name}")

    def say(self, contract: Contract, body: ContractBody) -> Contract:
        """Advance a contract by what I say, and keep the result while it runs."""
        after = advance(contract, self.me, body)
        self._keep(after)
        return after

    def hear(self, identity: ContractId, sender: int, body: ContractBody) -> Contract:
        """Advance a contract by what the other side said."""
        contractor = sender if identity.manager == self.me else self.me
        key = (identity, contractor)
        fresh = key not in self._running and key not in self._ended
        if fresh and identity.manager == sender and isinstance(body, Cancel | Rejection):
            self._forget(key, None)  # it overtook its call, or that was lost
        after = advance(self.get(identity, contractor), sender, body, heard=True)
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
        mine = [c for (i, _), c in self._running.items() if i == identity and c.manager == self.me]
        return sorted(mine, key=lambda c: c.contractor)

    def running(self, operation: OperationKind | None = None) -> list[Contract]:
        """All running contracts, of one operation or of all, in the order in which they were opened."""
        return [c for c in self._running.values() if operation is None or c.operation is operation]

    def _keep(self, contract: Contract) -> None:
        key = (contract.id, contract.contractor)
        if contract.ended:
            self._running.pop(key, None)
            self._forget(key, contract)
        elif key in self._running:
            self._running[key] = contract

    def _forget(self, key: tuple[ContractId, int], contract: Contract | None) -> None:
        self._ended[key] = contract
        if len(self._ended) > _REMEMBERED:
            del self._ended[next(iter(self._ended))]
