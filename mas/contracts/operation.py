"""Base class of operations: bids, awards, work and results, as manager and as contractor."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar, Generic, TypeVar

from ..errors import MasError
from ..protocol.ids import OperationKind
from ..protocol.messages import Bid, Call, Refusal
from ..state.agent_state import AgentState
from .context import AgentContext
from .contract import Contract
from .effects import NOTHING, Effects

AnyTask = TypeVar("AnyTask")
AnyOutcome = TypeVar("AnyOutcome")


class WorkError(MasError):
    """A contractor cannot do what it was awarded; becomes a Failure with this reason."""


@dataclass(frozen=True)
class Answer:
    """To a call for proposals. ``body`` None: not now, ask again when something has ended."""

    body: Bid | Refusal | None
    effects: Effects = NOTHING


class Operation(ABC, Generic[AnyTask, AnyOutcome]):
    """One operation, as manager and as contractor. Every method is called with a contract that the ledger has
    advanced, and returns what follows."""

    kind: ClassVar[OperationKind]

    def __init__(self, context: AgentContext) -> None:
        self.context = context

    @property
    def state(self) -> AgentState:
        """What the agent knows: shared by all of its operations."""
        return self.context.state

    @abstractmethod
    def bid(self, contract: Contract, call: Call) -> Answer:
        """Contractor: an offer, or why there is none."""

    @abstractmethod
    def on_bid(self, contract: Contract, bid: Bid) -> Effects:
        """Manager: award or reject now, or wait for the others."""

    @abstractmethod
    def work(self, contract: Contract, task: AnyTask) -> Effects:
        """Contractor: confirm and do the work, now or over several messages; :class:`WorkError` if it cannot be done,
        before anything has changed."""

    def objection(self, contract: Contract, outcome: AnyOutcome) -> str:
        """Manager: why a result cannot be believed, empty where it can; asked before the contract goes on."""
        return ""

    def on_result(self, contract: Contract, outcome: AnyOutcome) -> Effects:
        """Manager: take a result that there is no objection to. Of an optimisation every member knows it by itself."""
        return NOTHING

    def answers_for(self, contract: Contract) -> int:
        """Manager: the agent that is to blame where the contractor has declared a contract failed."""
        return contract.contractor

    def on_confirmation(self, contract: Contract) -> Effects:
        """Manager: the contractor is committed. Most operations have nothing to do here."""
        return NOTHING

    def on_end(self, contract: Contract) -> Effects:
        """Either side: the contract ended, well or not."""
        return NOTHING
