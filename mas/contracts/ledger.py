"""All contracts of one agent, as manager and as contractor: which of them run, and what ended."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

from ..errors import ProtocolError
from ..protocol.ids import ContractId, OperationKind
from ..protocol.messages import Call, Cancel, ContractBody, Rejection, Result
from ..protocol.tasks import Outcome
from .contract import Contract, ContractState, LateMessage, Repeated, advance, expire, failed
from .reputation import CALLED_ANEW

# Ended contracts an agent remembers with each other one, to tell a late message from a wrong one: nobody can make it
# forget those with others.
_REMEMBERED = 2000
# Contracts of a kind that run at once with each other agent and direction. Questions about places do not depend on each
# other's answers, and where answers take long more key-frames come than could be asked about one after the other.
_AT_ONCE = {OperationKind.DVPR: 8}


class OwnMistake(RuntimeError):
    """This agent was about to send what the contract net does not allow: an error of the program, not of a peer."""


@dataclass(frozen=True)
class CallTaken:
    """A call as its contractor enters it; ``superseded``: the contracts of its kind that it ends."""

    contract: Contract
    superseded: tuple[Contract, ...] = ()


def at_once(operation: OperationKind) -> int:
    """How many contracts of a kind may run at once with each other agent and direction."""
    return _AT_ONCE.get(operation, 1)


class Ledger:
    """At most one contract of a kind runs with each other agent and direction; of questions about places a few. No I/O,
    no clock."""

    def __init__(self, me: int) -> None:
        self.me = me
        self._number = 0
        self._running: dict[tuple[ContractId, int], Contract] = {}
        self._newest_call: dict[tuple[int, OperationKind], int] = {}
        self._ended: dict[tuple[ContractId, int], Contract | None] = {}
        self._ended_with: dict[int, deque[tuple[ContractId, int]]] = {}

    def call(
        self, operation: OperationKind, contractors: Iterable[int], deadline_ns: int
    ) -> tuple[ContractId, list[int]]:
        """Open one contract as manager with each contractor; those that have as many of the kind as may run are left
        out. Returns the id and who is to be called."""
        running = Counter(c.contractor for c in self.running(operation) if c.manager == self.me)
        free = sorted(c for c in set(contractors) - {self.me} if running[c] < at_once(operation))
        identity = ContractId(self.me, self._number)
        if free:
            self._number += 1
        for contractor in free:
            self._running[identity, contractor] = Contract(identity, contractor, operation, deadline_ns)
        return identity, free

    def called(self, sender: int, identity: ContractId, call: Call) -> CallTaken:
        """Open the contractor's side; where more of the kind run than may, the earliest ends: its end at the manager
        was missed. A call that was received before is :class:`Repeated`; one withdrawn before it came, or older than
        the newest of its kind where one runs at a time, is a :class:`LateMessage`."""
        if identity.manager != sender or sender == self.me:
            raise ProtocolError(f"agent {sender} calls in the name of agent {identity.manager}")
        key = (identity, self.me)
        known = self._running.get(key) or self._ended.get(key)
        if known is not None:
            raise Repeated(known, f"call {sender}:{identity.number} came twice")
        several = at_once(call.operation)
        newest = self._newest_call.get((sender, call.operation), -1)
        if key in self._ended or (identity.number <= newest and several == 1):
            raise LateMessage(f"call {sender}:{identity.number} came too late")
        self._newest_call[sender, call.operation] = max(identity.number, newest)
        running = [c for c in self.running(call.operation) if c.manager == sender and c.contractor == self.me]
        running.sort(key=lambda c: c.id, reverse=True)
        superseded = tuple(
            replace(old, state=ContractState.CANCELLED, reason=CALLED_ANEW) for old in running[several - 1 :]
        )
        for old in superseded:
            self._keep(old)
        contract = Contract(identity, self.me, call.operation, call.deadline_ns)
        self._running[key] = contract
        return CallTaken(contract, superseded)

    def find(self, identity: ContractId, contractor: int) -> Contract | None:
        """The contract if it runs."""
        return self._running.get((identity, contractor))

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

    def send(self, contract: Contract, body: ContractBody) -> Contract:
        """Advance a contract by what I send, and keep it while it runs; :class:`OwnMistake` if I may not."""
        try:
            after = advance(self.get(contract.id, contract.contractor), self.me, body)
        except ProtocolError as error:
            raise OwnMistake(str(error)) from error
        self._keep(after)
        return after

    def receive(
        self,
        identity: ContractId,
        sender: int,
        body: ContractBody,
        objection: Callable[[Contract, Outcome], str] = lambda contract, outcome: "",
    ) -> Contract:
        """Advance a contract by what the other side has sent. A result to which there is an ``objection`` ends it as
        failed, with that reason."""
        contractor = sender if identity.manager == self.me else self.me
        key = (identity, contractor)
        fresh = key not in self._running and key not in self._ended
        if fresh and identity.manager == sender and isinstance(body, Cancel | Rejection):
            self._forget(key, None)  # it overtook its call, or that was lost
        before = self.get(identity, contractor)
        after = advance(before, sender, body, received=True)
        if isinstance(body, Result):
            reason = objection(before, body.outcome)
            after = failed(after, reason) if reason else after
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

    @property
    def unsettled(self) -> bool:
        """Whether a contract runs in which I manage or owe something. Who has bid owes nothing: the manager knows
        whether there will be an award, and may have said in vain that there will not."""
        return any(c.manager == self.me or c.state is not ContractState.BID for c in self._running.values())

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
        identity, contractor = key
        other = contractor if identity.manager == self.me else identity.manager
        keys = self._ended_with.setdefault(other, deque())
        if key not in self._ended:
            keys.append(key)
        self._ended[key] = contract
        if len(keys) > _REMEMBERED:
            del self._ended[keys.popleft()]
