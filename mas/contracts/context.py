"""Shared context of an agent's operations: its state, contracts, reputation of others, logical time."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import msgspec

from ..protocol.ids import REASON_LENGTH, ContractId, OperationKind
from ..protocol.messages import Body, Call, Cancel, ContractBody, Message
from ..state.agent_state import AgentState
from .contract import Contract
from .effects import NOTHING, Effects, Event, total
from .ledger import Ledger
from .reputation import SILENT, ReputationBook, Trust
from .retransmission import Retransmitter

# Answers waited for one after the other in an optimisation, losses included, and in any other contract.
_ROUNDS, _ANSWERS = 150, 30
# And at most so many times the usual time of an optimisation.
_LONGEST = 4.0
# Refused messages of each other agent that are logged one by one; later those whose number is a power of two.
_LOGGED = 100


# Of an agent that is silent when all sequences are over, half of ``probe_s`` apart: a black hole of ten seconds ends
# before the last one.
_PROBES = 3


@dataclass(frozen=True)
class _LastProbes:
    """Of a silent agent: how many probes are ``left``, and when the ``next`` may go out."""

    left: int
    next_ns: int


@dataclass(frozen=True)
class CallSent:
    """A call for proposals: its number, the contractors that were called, and the effects."""

    identity: ContractId
    contractors: tuple[int, ...]
    effects: Effects


@dataclass
class AgentContext:
    """Shared by the operations of one agent. ``now_ns``: logical time of the last tick or message; ``closing``: all
    sequences have ended.

    A method that sends or logs changes the contracts at once, and returns the rest as :class:`Effects`.
    """

    state: AgentState
    ledger: Ledger
    now_ns: int = 0
    closing: bool = False
    _last_probes: dict[int, _LastProbes] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.retransmitter = Retransmitter(self.me, self.state.config.link)
        self.reputation = ReputationBook(self.state.config.reputation)

    @property
    def me(self) -> int:
        """The agent's own number."""
        return self.state.me

    # -- who may be called --------------------------------------------------------------------------------------------

    def deadline_ns(self, operation: OperationKind, contractors: Iterable[int] = ()) -> int:
        """Deadline, ns of logical time, of a contract opened now; slow answers make it longer. An optimisation has
        many rounds, each of as many messages one after the other as there are members: so do many of them."""
        config, others = self.state.config, list(contractors)
        slowest = max((self.retransmitter.rtt.wait_ns(c) for c in others), default=0)
        usual = config.optimisation.deadline_s * 1e9
        # Of few answers even the quickest may have been late, because messages were lost on the way.
        longest = _LONGEST * usual
        if operation is not OperationKind.DOPT:
            least = config.deadline_s * 1e9
            return self.now_ns + round(max(least, min(float(_ANSWERS * slowest), longest)))
        return self.now_ns + round(min(max(usual, float(_ROUNDS * slowest)), longest) * max(1.0, len(others) / 2))

    def capped(self, call: Call) -> Call:
        """The call with a deadline that this agent itself could have set at most."""
        config = self.state.config
        longest = config.deadline_s
        if call.operation is OperationKind.DOPT:
            longest = _LONGEST * config.optimisation.deadline_s * max(1.0, len(self.state.profile.others) / 2)
        latest_ns = self.now_ns + round(longest * 1e9)
        return call if call.deadline_ns <= latest_ns else msgspec.structs.replace(call, deadline_ns=latest_ns)

    def calling(self, operation: OperationKind) -> bool:
        """Whether a contract of this kind runs that I manage."""
        return any(c.manager == self.me for c in self.ledger.running(operation))

    def may_call(self, other: int, operation: OperationKind = OperationKind.DVPR) -> bool:
        """Whether a call to the other is worth its bytes. Probes of agents that are not trusted are small questions,
        never a part in an optimisation or a sale, and end with the sequences."""
        small = operation not in (OperationKind.DOPT, OperationKind.MAPMERGE)
        if not small and self.reputation.stalls(other, self.now_ns):
            return False
        if self.closing or not small:
            return self.reputation.trust(other) is Trust.GOOD or (small and self._last_probe_due(other))
        return self.reputation.may_call(other, self.now_ns)

    def close(self) -> None:
        """All sequences have ended. Who is silent is asked a few times more: it may come, or come back."""
        self.closing = True

    def may_come_back(self, other: int) -> bool:
        """Whether a silent agent is still to be probed, or may have come by a probe that is under way."""
        if self.reputation.trust(other) is not Trust.SILENT:
            return False
        known = self._last_probes.get(other)
        return known is None or known.left > 0 or self.now_ns < known.next_ns

    def _last_probe_due(self, other: int) -> bool:
        known = self._last_probes.get(other, _LastProbes(_PROBES, self.now_ns))
        return self.reputation.trust(other) is Trust.SILENT and known.left > 0 and self.now_ns >= known.next_ns

    def _probed(self, other: int) -> None:
        """A call went out; to one that is silent after the end that was a probe."""
        if self.closing and self.reputation.trust(other) is Trust.SILENT:
            left = self._last_probes[other].left if other in self._last_probes else _PROBES
            wait_ns = round(self.state.config.reputation.probe_s * 0.5e9)
            self._last_probes[other] = _LastProbes(left - 1, self.now_ns + wait_ns)

    def serves(self, other: int, operation: OperationKind) -> bool:
        """Whether to work for the other: questions about places always, they let it come back."""
        if operation in (OperationKind.DVPR, OperationKind.RELPOSE):
            return True
        stalls = operation is OperationKind.DOPT and self.reputation.stalls(other, self.now_ns)
        return self.reputation.trust(other) is Trust.GOOD and not stalls

    # -- contracts ----------------------------------------------------------------------------------------------------

    def call(self, operation: OperationKind, contractors: Iterable[int], members: tuple[int, ...] = ()) -> CallSent:
        """Call for proposals those of the contractors that have no contract of this kind running, and are worth it."""
        contractors = sorted(contractors)
        deadline_ns = self.deadline_ns(operation, contractors)
        worth = [c for c in contractors if self.may_call(c, operation)]
        identity, free = self.ledger.call(operation, worth, deadline_ns)
        effects = NOTHING
        for contract in self.ledger.managed(identity) if free else []:
            self.reputation.called(contract.contractor, self.now_ns)
            self._probed(contract.contractor)
            effects += self._sent(contract, contract.contractor, Call(operation, deadline_ns, members))
        return CallSent(identity, tuple(free), effects)

    def send(self, contract: Contract, body: ContractBody) -> Effects:
        """Send ``body`` to the other side of a contract; :class:`~.ledger.OwnMistake` if the contract net does not
        allow it now."""
        after = self.ledger.send(contract, body)
        other = contract.contractor if contract.manager == self.me else contract.manager
        return self._sent(after, other, body) + self.ended([after])

    def _sent(self, contract: Contract, other: int, body: ContractBody) -> Effects:
        message = Message(self.me, other, contract.id, body)
        self.retransmitter.sent(contract, message, self.now_ns)
        return Effects(messages=(message,))

    def received(self, contract: Contract) -> Effects:
        """The other side has sent something in a contract, which is like this now."""
        self.retransmitter.received(contract, self.now_ns)
        return self.ended([contract])

    def answer_again(self, contract: Contract, body: Body) -> Effects:
        """A message came that the contract has received already, or that it is too late for: the other side may have
        missed mine."""
        if not contract.ended:
            self.retransmitter.received(contract, self.now_ns)
        message = self.retransmitter.answer(contract, body, self.now_ns)
        return NOTHING if message is None else Effects(messages=(message,))

    def retransmit(self) -> Effects:
        """Send again what was not answered in time, and give up contractors that have gone silent."""
        silent = self.cancel(self.retransmitter.silent(self.now_ns), SILENT)
        return silent + Effects(messages=tuple(self.retransmitter.due(self.now_ns)))

    def cancel(self, contracts: Iterable[Contract], reason: str) -> Effects:
        """Withdraw contracts that I manage and that still run."""
        return total(self.send(contract, Cancel(reason)) for contract in contracts if not contract.ended)

    def ended(self, contracts: Iterable[Contract]) -> Effects:
        """Contracts among these that are over."""
        return Effects(ended=tuple(c for c in contracts if c.ended))

    def close_account(self, contract: Contract, answers_for: int) -> Effects:
        """A contract has ended: count it for the other side's reputation, or, where its failure is another agent's
        fault, for that of the one that ``answers_for`` it; its manager logs the event."""
        if contract.manager != self.me:
            return Effects(changes=self.reputation.served(contract, self.now_ns))
        if answers_for != contract.contractor:
            changes = self.reputation.misled(answers_for, self.now_ns)
        else:
            changes = self.reputation.ended(contract, self.now_ns)
        return Effects(changes=changes) + self.event(
            "contract",
            operation=contract.operation.name.lower(),
            contract=f"{contract.manager}:{contract.id.number}",
            contractor=contract.contractor,
            end=str(contract.state),
            reason=contract.reason,
        )

    def judged(self, other: int, borne_out: int, contradicted: int) -> Effects:
        """So many of the other's matches agree with the rest of what is known, and so many do not."""
        return Effects(changes=self.reputation.judged(other, borne_out, contradicted, self.now_ns))

    # -- beside contracts ---------------------------------------------------------------------------------------------

    def tell(self, recipient: int, identity: ContractId | None, body: Body) -> Effects:
        """Send a message that is no step of a contract."""
        return Effects(messages=(Message(self.me, recipient, identity, body),))

    def event(self, kind: str, **fields: Any) -> Effects:
        """Log an event."""
        return Effects(events=(Event(self.now_ns, self.me, kind, fields),))

    def refuse(self, sender: int, reason: str) -> Effects:
        """Log a message that cannot be believed or acted on, and count it against its sender. Of many only some are
        logged: whoever sends them shall not fill the disk."""
        if sender not in self.state.profile.others:
            return self.event("refused", sender=sender, reason=reason[:REASON_LENGTH])
        changes, count = self.reputation.refused(sender, self.now_ns), self.reputation.of(sender).refused
        if count > _LOGGED and count & (count - 1):
            return Effects(changes=changes)
        more = {"count": count} if count > _LOGGED else {}
        return Effects(changes=changes) + self.event("refused", sender=sender, reason=reason[:REASON_LENGTH], **more)
