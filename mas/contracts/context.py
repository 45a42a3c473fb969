"""Where an agent's operations do business: its ledger, its outgoing mail, its diary."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from ..protocol.ids import ContractId, OperationKind
from ..protocol.messages import Body, Call, Cancel, ContractBody, Message
from ..state.agent_state import AgentState
from .contract import Contract
from .ledger import Ledger
from .reputation import SILENT, ReputationBook, Trust
from .retransmission import Retransmitter

# Answers waited for one after the other in an optimisation, losses included.
_ROUNDS = 150
# And at most so many times the usual time.
_LONGEST = 4.0


@dataclass(frozen=True)
class Event:
    """A line of ``events.jsonl``: what happened to whom, with its figures."""

    now_ns: int
    agent: int
    kind: str
    fields: dict[str, Any]


@dataclass
class AgentContext:
    """Shared by the operations of one agent. ``now_ns``: logical time of the last tick or message; ``closing``: all
    sequences have ended."""

    state: AgentState
    ledger: Ledger
    now_ns: int = 0
    closing: bool = False
    outbox: list[Message] = field(default_factory=list)
    diary: list[Event] = field(default_factory=list)
    ended: list[Contract] = field(default_factory=list)
    _last_probes: set[int] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.retransmitter = Retransmitter(self.me, self.state.config.link)
        self.reputation = ReputationBook(self.state.config.standing)

    @property
    def me(self) -> int:
        return self.state.me

    def deadline_ns(self, operation: OperationKind, contractors: Iterable[int] = ()) -> int:
        """When a contract opened now expires. An optimisation has many rounds, each of as many messages one after the
        other as there are members: many of them, or slow answers, make it longer."""
        config = self.state.config
        if operation is not OperationKind.DOPT:
            return self.now_ns + round(config.deadline_s * 1e9)
        others = list(contractors)
        slowest = max((self.retransmitter.rtt.wait_ns(c) for c in others), default=0)
        usual = config.optimisation.deadline_s * 1e9
        # Of few answers even the quickest may have been late, because words were lost on the way.
        longest = min(max(usual, float(_ROUNDS * slowest)), _LONGEST * usual)
        return self.now_ns + round(longest * max(1.0, len(others) / 2))

    def calling(self, operation: OperationKind) -> bool:
        """Whether a contract of this kind runs that I manage."""
        return any(c.manager == self.me for c in self.ledger.running(operation))

    def may_call(self, other: int, operation: OperationKind = OperationKind.DVPR) -> bool:
        """Whether a call to the other is worth its bytes. Probes of who is in bad standing are small questions, never
        a part in an optimisation or a sale, and end with the sequences."""
        small = operation not in (OperationKind.DOPT, OperationKind.MAPMERGE)
        if self.closing or not small:
            return self.reputation.regard(other) is Trust.GOOD or (small and other in self._last_probes)
        return self.reputation.may_call(other, self.now_ns)

    def close(self) -> None:
        """All sequences have ended. Who is silent is asked once more: it may have come since the last probe."""
        if not self.closing:
            self.closing = True
            others = self.state.profile.others
            self._last_probes = {a for a in others if self.reputation.regard(a) is Trust.SILENT}

    def serves(self, other: int, operation: OperationKind) -> bool:
        """Whether to work for the other: questions about places always, they let it come back."""
        return operation in (OperationKind.DVPR, OperationKind.RELPOSE) or self.reputation.regard(other) is Trust.GOOD

    def call(
        self, operation: OperationKind, contractors: Iterable[int], members: tuple[int, ...] = ()
    ) -> tuple[ContractId, list[int]]:
        """Call for proposals; returns the contract's id and who was called (not those that still have one of this
        kind, nor those in bad standing)."""
        contractors = sorted(contractors)
        deadline_ns = self.deadline_ns(operation, contractors)
        worth = [c for c in contractors if self.may_call(c, operation)]
        identity, free = self.ledger.call(operation, worth, deadline_ns)
        for contract in self.ledger.managed(identity) if free else []:
            self.reputation.called(contract.contractor, self.now_ns)
            self._last_probes.discard(contract.contractor)
            self._say(contract, contract.contractor, Call(operation, deadline_ns, members))
        return identity, free

    def say(self, contract: Contract, body: ContractBody) -> Contract:
        """Say ``body`` to the other side of a contract, if the contract net allows it now."""
        after = self.ledger.say(self.ledger.get(contract.id, contract.contractor), body)
        self._say(after, contract.contractor if contract.manager == self.me else contract.manager, body)
        self.watch(after)
        return after

    def _say(self, contract: Contract, other: int, body: ContractBody) -> None:
        message = Message(self.me, other, contract.id, body)
        self.retransmitter.said(contract, message, self.now_ns)
        self.outbox.append(message)

    def hear(self, contract: Contract) -> None:
        """The other side said something in a contract, which is like this now."""
        self.retransmitter.heard(contract, self.now_ns)
        self.watch(contract)

    def answer_again(self, contract: Contract, body: Body) -> None:
        """A word came that the contract had heard, or that it is too late for: the other side may have missed mine."""
        if not contract.ended:
            self.retransmitter.heard(contract, self.now_ns)
        message = self.retransmitter.answer(contract, body, self.now_ns)
        if message is not None:
            self.outbox.append(message)

    def remind(self) -> None:
        """Say again what was not answered in time, and give up contractors that have gone silent."""
        for contract in self.retransmitter.silent(self.now_ns):
            self.cancel([contract], SILENT)
        self.outbox += self.retransmitter.due(self.now_ns)

    def watch(self, contract: Contract) -> None:
        """Remember a contract that has ended, for the agent to wind up once the message at hand is dealt with."""
        if contract.ended:
            self.ended.append(contract)

    def cancel(self, contracts: Iterable[Contract], reason: str) -> None:
        """Withdraw contracts that I manage and that still run."""
        for contract in contracts:
            if not contract.ended:
                self.say(contract, Cancel(reason))

    def tell(self, recipient: int, identity: ContractId | None, body: Body) -> None:
        """Put a message into the outgoing mail."""
        self.outbox.append(Message(self.me, recipient, identity, body))

    def note(self, kind: str, **fields: Any) -> None:
        """Write an event into the diary."""
        self.diary.append(Event(self.now_ns, self.me, kind, fields))

    def note_end(self, contract: Contract) -> None:
        """How a contract ended, told once: by its manager."""
        if contract.manager != self.me:
            self.reputation.left_waiting(contract)
        else:
            self.reputation.ended(contract)
            self.note(
                "contract",
                operation=contract.operation.name.lower(),
                contract=f"{contract.manager}:{contract.id.number}",
                contractor=contract.contractor,
                end=str(contract.state),
                reason=contract.reason,
            )
