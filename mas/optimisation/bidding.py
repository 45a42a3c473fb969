"""An agent's bids for optimisations: what it can bring, and what the last one cost it."""

from __future__ import annotations

from collections.abc import Mapping

from msgspec.structs import replace

from ..contracts.context import AgentContext
from ..contracts.contract import ContractState
from ..policies.utility import ENVELOPE_BYTES, SOLVER_BYTES_A_ROW
from ..protocol.ids import OperationKind
from ..protocol.messages import Bid
from ..state.pose_graph import terms
from .session import OptimisationSession


class BidEstimator:
    """Costs are learned: bytes for each match end, and logical time, of the agent's last optimisation."""

    def __init__(self, context: AgentContext) -> None:
        self.context = context
        self._bytes_a_row = SOLVER_BYTES_A_ROW
        self._took_ns = 0
        self._made: tuple[tuple[int, int | None], Bid] | None = None

    def bid(self, peer: int | None = None) -> Bid:
        """Made once for each state the agent is in: several managers may call at the same time. ``peer``: of an
        optimisation with this agent only."""
        state, now_ns = self.context.state, self.context.now_ns
        if self._made is None or self._made[0] != (state.version, peer):
            bid = terms(state, now_ns, peer)
            rows = 0 if bid.links is None else len(bid.links.matches)
            cost = ENVELOPE_BYTES + round(self._bytes_a_row * rows)
            self._made = ((state.version, peer), replace(bid, cost_bytes=cost))
        return replace(self._made[1], ready_ns=now_ns + self._took_ns)

    def ended(self, session: OptimisationSession) -> None:
        """An optimisation came to its end."""
        self._bytes_a_row = session.sent_bytes / max(len(session.task.matches), 1)
        self._took_ns = self.context.now_ns - session.began_ns


def engaged(context: AgentContext, bid_ns: Mapping[int, int]) -> bool:
    """Whether a manager that got a bid lately may still award: calling now would only get in its way. ``bid_ns``: by
    manager, the time of the last bid to it."""
    now_ns, patience_ns = context.now_ns, context.retransmitter.patience_ns
    mine = {c.manager for c in context.ledger.running(OperationKind.DOPT) if c.contractor == context.me}
    return any(manager not in bid_ns or now_ns - bid_ns[manager] < patience_ns(manager) for manager in mine)


def bids_to_lower(context: AgentContext, manager: int) -> bool:
    """Whether a bid to a lower manager is still open: that one goes first."""
    bids = (c for c in context.ledger.running(OperationKind.DOPT) if c.state is ContractState.BID)
    return any(c.manager < manager for c in bids if c.contractor == context.me)
