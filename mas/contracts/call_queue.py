"""Calls to an agent that it has not answered yet: each agent's own pool, since nobody keeps one for all.

The thesis's environment holds the pool of active proposals and idle agents go through it (section 3.8.2; Smith 1980).
Without a server a call goes to those it names, and waits at each of them: who is idle bids at once, who is busy puts
the call into its pool and looks there again as soon as it is idle. It waits no longer than half the time after which
its manager would take it for gone; then it refuses.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..protocol.ids import OperationKind
from ..protocol.messages import Call, Refusal
from .context import AgentContext
from .contract import Contract, ContractState
from .effects import NOTHING, Effects
from .operation import Operation


@dataclass(frozen=True)
class _WaitingCall:
    """A call that waits for its answer, at most until ``until_ns``."""

    contract: Contract
    call: Call
    until_ns: int


class CallQueue:
    """Answers calls by the operations' bids, now or when idle; lower managers first, as all agents prefer them."""

    def __init__(self, context: AgentContext, operations: Mapping[OperationKind, Operation[Any, Any]]) -> None:
        self.context = context
        self._operations = operations
        self._waiting: list[_WaitingCall] = []

    @property
    def waiting(self) -> bool:
        """Whether calls wait for an answer."""
        return bool(self._waiting)

    def take(self, contract: Contract, call: Call) -> Effects:
        """A new call: answer it, or keep it."""
        if not self.context.serves(contract.manager, contract.operation):
            trust = self.context.reputation.trust(contract.manager)
            return self.context.send(contract, Refusal(f"reputation: {trust}"))
        answer = self._answer(contract, call)
        if answer is not None:
            return answer
        patience = self.context.retransmitter.patience_ns(contract.manager) // 2
        self._waiting.append(_WaitingCall(contract, call, self.context.now_ns + patience))
        self._waiting.sort(key=lambda w: w.contract.id)
        return NOTHING

    def inspect(self) -> Effects:
        """Answer what can be answered by now; refuse what waited too long."""
        effects = NOTHING
        for entry in list(self._waiting):
            contract = entry.contract
            answer = self._answer(contract, entry.call) if self._open(contract) else NOTHING
            if answer is not None:
                self._waiting.remove(entry)
                effects += answer
            elif self.context.now_ns >= entry.until_ns:
                self._waiting.remove(entry)
                effects += self.context.send(contract, Refusal("busy"))
        return effects

    def _open(self, contract: Contract) -> bool:
        known = self.context.ledger.find(contract.id, contract.contractor)
        return known is not None and known.state is ContractState.CALLED

    def _answer(self, contract: Contract, call: Call) -> Effects | None:
        """None: not now."""
        answer = self._operations[contract.operation].bid(contract, call)
        return None if answer.body is None else answer.effects + self.context.send(contract, answer.body)
