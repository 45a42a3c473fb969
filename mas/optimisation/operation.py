"""Distributed optimisation among agents (thesis section 3.6): one contract with each member, then separator poses
only."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from maslam.backend.distributed.update_messages import UpdateMessage

from ..contracts.context import AgentContext
from ..contracts.contract import Contract, ContractState
from ..contracts.effects import NOTHING, Effects, total
from ..contracts.operation import Answer, Operation, WorkError
from ..errors import ProtocolError
from ..protocol.ids import ContractId, MatchId, OperationKind
from ..protocol.messages import Award, Begin, Bid, Call, Confirmation, Refusal, Rejection
from ..protocol.solver_messages import SolverBody
from ..protocol.tasks import OptimiseAnswer, OptimiseTask
from .bidding import bids_to_lower, engaged
from .contradictions import hold_against
from .planning import Plan, plan
from .running import RunningOptimisation
from .session import OptimisationSession, OptimisationTender, checked_node, node_of


class Optimisation(Operation[OptimiseTask, OptimiseAnswer]):
    """At most one at a time for an agent. Of two managers that call at once, the lower number goes first. What was
    agreed on is ``running``'s."""

    kind = OperationKind.DOPT

    def __init__(self, context: AgentContext, peer_to_peer: Callable[[], bool] = lambda: False) -> None:
        """``peer_to_peer``: whether the agent takes part in others' optimisations with their managers only."""
        super().__init__(context)
        self._peer_to_peer = peer_to_peer
        self.tender: OptimisationTender | None = None
        self._bid_ns: dict[int, int] = {}
        self.running = RunningOptimisation(context)

    @property
    def busy(self) -> bool:
        """Whether the agent calls for an optimisation or takes part in one."""
        return self.running.session is not None or self.tender is not None

    @property
    def waits(self) -> bool:
        """Whether others have to do something yet for an optimisation, or for an update of one."""
        return self.busy or not self.running.updates.settled

    @property
    def ready(self) -> bool:
        """Whether the agent may call for one now: the last has ended at all members, or it is time to try again."""
        settling = self.context.calling(OperationKind.DOPT) or engaged(self.context, self._bid_ns)
        return not self.busy and not settling and self.context.now_ns >= self.running.attempts.not_before_ns

    def update(self) -> Effects:
        """Take new matches in without an optimisation, as far as the last one allows."""
        return NOTHING if self.running.session is not None else self.running.updates.pursue()

    # -- manager ------------------------------------------------------------------------------------------------------

    def start(self, members: list[int], fresh: Iterable[MatchId] = ()) -> Effects:
        """Call for an optimisation with these agents, alone if no other is named; ``fresh``: matches not used yet."""
        without = {self.state.me, self.running.suspicion.left_out}
        others = [a for a in members if a not in without and self.context.may_call(a, OperationKind.DOPT)]
        mine = self.running.estimator.bid()
        if not others:
            return self._award(OptimisationTender(None, set(), {self.state.me: mine}, fresh=frozenset(fresh)))
        asked = tuple(sorted(set(members) - {self.running.suspicion.left_out}))
        call = self.context.call(OperationKind.DOPT, others, asked)
        if call.contractors:
            called, bids = set(call.contractors), {self.state.me: mine}
            self.tender = OptimisationTender(call.identity, called, bids, set(others) - called, frozenset(fresh))
        return call.effects

    def on_bid(self, contract: Contract, bid: Bid) -> Effects:
        if self.tender is None or self.tender.identity != contract.id:
            return self.context.send(contract, Rejection("no longer wanted"))
        effects = self.context.event("peer_to_peer", bidder=contract.contractor) if bid.peer_to_peer else NOTHING
        self.tender.bids[contract.contractor] = bid
        return effects + self._answered(contract.contractor)

    def _answered(self, contractor: int) -> Effects:
        tender = self.tender
        if tender is None or not tender.complete_with(contractor):
            return NOTHING
        self.tender = None
        return self._award(tender)

    def _award(self, tender: OptimisationTender) -> Effects:
        """Everyone has answered: plan, award to those who are connected, reject the others."""
        me = self.state.me
        found = plan(me, tender.bids, self.state.depths(), tender.fresh)
        effects = NOTHING if tender.identity is None else self._answer_bids(tender.identity, found)
        if tender.missing and found.members == (me,):
            self.running.attempts.failed(self.context.now_ns, me)
            return effects + self.running.idle()
        self.running.missed |= bool(tender.missing)
        task = found.tasks[me]
        node, others = node_of(self.state, task), set(found.members) - {me}
        identity = tender.identity if others else None
        self.running.session = session = OptimisationSession(identity, task, node, None, others, found.elsewhere)
        return effects if others else effects + self.running.run(session)

    def _answer_bids(self, identity: ContractId, found: Plan) -> Effects:
        effects = hold_against(self.context, found.contradicted)
        for contract in self.context.ledger.managed(identity):
            if contract.contractor in found.tasks:
                effects += self.context.send(contract, Award(found.tasks[contract.contractor]))
            elif contract.state is ContractState.BID:
                effects += self.context.send(contract, Rejection("not connected"))
        return effects

    def on_confirmation(self, contract: Contract) -> Effects:
        session = self.running.session
        if session is None or session.identity != contract.id:
            return NOTHING
        session.unconfirmed.discard(contract.contractor)
        if session.unconfirmed or session.begun:
            return NOTHING
        others = (m for m in session.task.members if m != self.state.me)
        return total(self.context.tell(m, session.identity, Begin()) for m in others) + self.running.run(session)

    # -- contractor ---------------------------------------------------------------------------------------------------

    def bid(self, contract: Contract, call: Call) -> Answer:
        if self.running.session is not None or bids_to_lower(self.context, contract.manager):
            return Answer(None)
        if not self.state.keyframes:
            return Answer(Refusal("nothing to optimise yet"))
        strange = set(call.members) - self.state.profile.everyone
        if strange:  # its messages would not come here, and the optimisation never end
            return Answer(Refusal(f"agent {min(strange)} is not known here"))
        if self.running.suspicion.left_out in (contract.manager, *call.members):
            return Answer(Refusal("optimisations with one of these were spoilt"))
        effects = NOTHING
        if self.tender is not None:
            if contract.manager > self.state.me:
                return Answer(Refusal("calling for an optimisation itself"))
            effects = self._give_way()
        self._bid_ns[contract.manager] = self.context.now_ns
        return Answer(self.running.estimator.bid(contract.manager if self._peer_to_peer() else None), effects)

    def _give_way(self) -> Effects:
        """Withdraw the own call."""
        given_up, self.tender = self.tender, None
        if given_up is None or given_up.identity is None:
            return self.running.idle()
        contracts = self.context.ledger.managed(given_up.identity)
        return self.context.cancel(contracts, "gives way to a lower number") + self.running.idle()

    def work(self, contract: Contract, task: OptimiseTask) -> Effects:
        if self.busy:
            raise WorkError("busy with an optimisation")
        node = checked_node(self.state, contract, task)
        self.running.session = OptimisationSession(contract.id, task, node, contract, agreed_ns=self.context.now_ns)
        return self.context.send(contract, Confirmation())

    def begin(self, sender: int, identity: ContractId | None) -> Effects:
        """The manager's message that all members have confirmed."""
        session = self.running.session
        if session is None or session.identity != identity or identity is None or sender != identity.manager:
            if identity in self.running.before and identity is not None and sender == identity.manager:
                return NOTHING
            raise ProtocolError(f"agent {sender} begins an optimisation that was not agreed on")
        return NOTHING if session.begun else self.running.run(session)

    def solver(self, sender: int, identity: ContractId | None, body: SolverBody) -> Effects:
        """A solver message of another member."""
        session, message = self.running.session, body.read(sender, self.state.me)
        if isinstance(message, UpdateMessage):  # while an optimisation goes on here, its sender waits
            return NOTHING if session is not None else self.running.updates.handle(identity, message)
        if session is None or session.identity != identity:
            if identity is not None and identity in self.running.before:
                over = self.running.before[identity]
                return NOTHING if over is None else self.running.late(over, message)
            raise ProtocolError(f"agent {sender} sends solver messages without an optimisation")
        if sender not in session.task.members:
            raise ProtocolError(f"agent {sender} takes no part in this optimisation")
        return self.running.solver(session, message)

    # -- both ---------------------------------------------------------------------------------------------------------

    def on_end(self, contract: Contract) -> Effects:
        if self.tender is not None and self.tender.identity == contract.id:
            return self._answered(contract.contractor)
        if contract.state is ContractState.DONE:
            return NOTHING
        session = self.running.session
        if session is None or session.identity != contract.id:
            over = self.running.before.get(contract.id)
            if over is not None and contract.manager == self.state.me and contract.contractor in over.task.members:
                self.running.missed = True
            return NOTHING if self.tender is not None else self.running.idle()
        if contract.manager != self.state.me:
            return self.running.leave(session)
        if contract.contractor not in session.task.members:
            return NOTHING
        effects = self.running.fail(session)
        contracts = self.context.ledger.managed(contract.id)
        return effects + self.context.cancel(contracts, f"agent {contract.contractor} dropped out")

    def resend(self) -> Effects:
        """See :meth:`RunningOptimisation.resend`."""
        return self.running.resend()
