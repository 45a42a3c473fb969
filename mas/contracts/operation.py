"""What an operation is to its contracts: bids, awards, work and results, as manager and as contractor."""

from __future__ import annotations

from abc import ABC, abstractmethod

from ..protocol.messages import Bid, Call, Refusal
from ..protocol.tasks import Outcome, Task
from ..state.agent_state import AgentState
from .context import AgentContext
from .contract import Contract


class WorkError(Exception):
    """A contractor cannot do what it was awarded; becomes a Failure with this reason."""


class Operation(ABC):
    """One operation, as manager and as contractor. Every method is called with a contract that the ledger has
    advanced."""

    def __init__(self, context: AgentContext) -> None:
        self.context = context

    @property
    def state(self) -> AgentState:
        return self.context.state

    @abstractmethod
    def bid(self, contract: Contract, call: Call) -> Bid | Refusal | None:
        """Contractor: an offer, or why not; None: not now, ask again when something has ended."""

    @abstractmethod
    def on_bid(self, contract: Contract, bid: Bid) -> None:
        """Manager: award or reject now, or wait for the others."""

    @abstractmethod
    def work(self, contract: Contract, task: Task) -> None:
        """Contractor: confirm and do the work, now or over several messages; :class:`WorkError` if it cannot be
        done."""

    @abstractmethod
    def on_result(self, contract: Contract, outcome: Outcome) -> None:
        """Manager: take the result."""

    def on_confirmation(self, contract: Contract) -> None:  # noqa: B027 - most operations have nothing to do here
        """Manager: the contractor is committed."""

    def on_end(self, contract: Contract) -> None:  # noqa: B027
        """Either side: the contract ended, well or not."""
