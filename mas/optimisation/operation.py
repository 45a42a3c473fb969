"""Distributed optimisation among agents (thesis section 3.6): one contract with each member, then separator poses
only."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from maslam.backend.errors import BackendError

from ..contracts.context import AgentContext
from ..contracts.contract import Contract, ContractState, ProtocolError
from ..contracts.operation import Operation, WorkError
from ..policies.utility import ENVELOPE_BYTES
from ..protocol.ids import ContractId, OperationKind
from ..protocol.messages import Award, Begin, Bid, Call, Confirmation, Failure, Refusal, Rejection, Result
from ..protocol.solver_messages import SolverBody, SolverMessage, decides, from_wire, to_wire
from ..protocol.solver_messages import payload_bytes as solver_payload
from ..protocol.tasks import OptimiseAnswer, OptimiseTask, Outcome, Task
from ..state.pose_graph import Adoption, adopt, share_of
from .bidding import BidEstimator
from .contradictions import hold_against
from .planning import plan
from .session import Backoff, OptimisationSession, OptimisationTender, SessionHistory, solver_node


class Optimisation(Operation):
    """At most one at a time for an agent. Of two managers that call at once, the lower number goes first.

    Nobody can be sure that all others have heard the last message (two generals). So whoever has not keeps its poses
    where they were: a frame is named for the key-frame it begins with, which no optimisation moves, so that estimates
    of before and after lie in the same one. Its contract ends without a result, and the manager calls again.
    """

    def __init__(self, context: AgentContext, peer_to_peer: Callable[[], bool] = lambda: False) -> None:
        """``peer_to_peer``: whether the agent takes part in others' optimisations with their managers only."""
        super().__init__(context)
        self._peer_to_peer = peer_to_peer
        self.tender: OptimisationTender | None = None
        self.session: OptimisationSession | None = None
        self.adoptions: list[Adoption] = []
        self.attempts = Backoff(context.state.config.link)
        self.repeated = 0
        self._bid_ns: dict[int, int] = {}
        self._before = SessionHistory()
        self.terms = BidEstimator(context)

    @property
    def busy(self) -> bool:
        return self.session is not None or self.tender is not None

    @property
    def ready(self) -> bool:
        """Whether the agent may call for one now: the last has ended at all members, or it is time to try again."""
        settling = self.context.calling(OperationKind.DOPT) or self._engaged
        return not self.busy and not settling and self.context.now_ns >= self.attempts.not_before_ns

    @property
    def _engaged(self) -> bool:
        """Whether a manager that got a bid lately may still award: calling now would only get in its way."""
        since_ns = self.context.now_ns - round(self.state.config.link.silence_s * 1e9)
        mine = (c for c in self.context.ledger.running(OperationKind.DOPT) if c.contractor == self.state.me)
        return any(self._bid_ns.get(c.manager, since_ns) > since_ns for c in mine)

    # -- manager ------------------------------------------------------------------------------------------------------

    def start(self, members: list[int]) -> None:
        """Call for an optimisation with these agents; alone if nobody else is named."""
        others = [a for a in members if a != self.state.me and self.context.may_call(a, OperationKind.DOPT)]
        mine = self.terms.bid()
        if not others:
            self._award(OptimisationTender(None, set(), {self.state.me: mine}))
            return
        identity, called = self.context.call(OperationKind.DOPT, others, tuple(sorted(members)))
        if called:
            self.tender = OptimisationTender(identity, set(called), {self.state.me: mine}, set(others) - set(called))

    def on_bid(self, contract: Contract, bid: Bid) -> None:
        if self.tender is None or self.tender.identity != contract.id:
            self.context.say(contract, Rejection("no longer wanted"))
            return
        if bid.peer_to_peer:
            self.context.note("peer_to_peer", bidder=contract.contractor)
        self.tender.bids[contract.contractor] = bid
        self._answered(contract.contractor)

    def _answered(self, contractor: int) -> None:
        tender = self.tender
        if tender is None:
            return
        tender.pending.discard(contractor)
        if contractor not in tender.bids:
            tender.missing.add(contractor)
        if not tender.pending:
            self.tender = None
            self._award(tender)

    def _award(self, tender: OptimisationTender) -> None:
        """Everyone has answered: plan, award to those who are connected, reject the others."""
        me = self.state.me
        found = plan(me, tender.bids, self.state.depths())
        if tender.identity is not None:
            hold_against(self.context, found.contradicted)
        contracts = self.context.ledger.managed(tender.identity) if tender.identity is not None else []
        for contract in contracts:
            if contract.contractor in found.tasks:
                self.context.say(contract, Award(found.tasks[contract.contractor]))
            elif contract.state is ContractState.BID:
                self.context.say(contract, Rejection("not connected"))
        if tender.missing and found.members == (me,):
            self.attempts.failed(self.context.now_ns, self.state.me)
            return
        self.attempts.missed |= bool(tender.missing)
        task = found.tasks[me]
        node = solver_node(share_of(self.state, task), self.state.config.optimisation.solver)
        others = set(found.members) - {me}
        self.session = OptimisationSession(tender.identity if others else None, task, node, unconfirmed=others)
        if not others:
            self._run(self.session)

    def on_confirmation(self, contract: Contract) -> None:
        session = self.session
        if session is None or session.identity != contract.id:
            return
        session.unconfirmed.discard(contract.contractor)
        if not session.unconfirmed and not session.begun:
            for member in session.task.members:
                if member != self.state.me:
                    self.context.tell(member, session.identity, Begin())
            self._run(session)

    def on_result(self, contract: Contract, outcome: Outcome) -> None:
        if not isinstance(outcome, OptimiseAnswer):
            raise WorkError("not the result of an optimisation")

    # -- contractor ---------------------------------------------------------------------------------------------------

    def bid(self, contract: Contract, call: Call) -> Bid | Refusal | None:
        if self.session is not None or self._bid_to_lower(contract):
            return None
        if not self.state.keyframes:
            return Refusal("nothing to optimise yet")
        if self.tender is not None:
            if contract.manager > self.state.me:
                return Refusal("calling for an optimisation itself")
            given_up, self.tender = self.tender, None
            if given_up.identity is not None:
                self.context.cancel(self.context.ledger.managed(given_up.identity), "gives way to a lower number")
        self._bid_ns[contract.manager] = self.context.now_ns
        return self.terms.bid(contract.manager if self._peer_to_peer() else None)

    def _bid_to_lower(self, contract: Contract) -> bool:
        """Whether a bid to a lower manager is still open: that one goes first."""
        bids = (c for c in self.context.ledger.running(OperationKind.DOPT) if c.state is ContractState.BID)
        return any(c.manager < contract.manager for c in bids if c.contractor == self.state.me)

    def work(self, contract: Contract, task: Task) -> None:
        me = self.state.me
        if not isinstance(task, OptimiseTask) or me not in task.members or contract.manager not in task.members:
            raise WorkError("not an optimisation of this agent with the manager")
        if self.busy:
            raise WorkError("busy with an optimisation")
        try:
            node = solver_node(share_of(self.state, task), self.state.config.optimisation.solver)
        except (BackendError, ValueError) as error:
            raise WorkError(f"cannot take part: {error}") from error
        self.session = OptimisationSession(contract.id, task, node, contract)
        self.context.say(contract, Confirmation())

    def begin(self, sender: int, identity: ContractId | None) -> None:
        """The manager's word that all members have confirmed."""
        session = self.session
        if session is None or session.identity != identity or identity is None or sender != identity.manager:
            if identity in self._before and identity is not None and sender == identity.manager:
                return
            raise ProtocolError(f"agent {sender} begins an optimisation that was not agreed on")
        if not session.begun:
            self._run(session)

    def solver(self, sender: int, identity: ContractId | None, body: SolverBody) -> None:
        """A solver message of another member."""
        session = self.session
        if session is None or session.identity != identity:
            if identity is not None and identity in self._before:
                self._late(self._before[identity], sender, body)
                return
            raise ProtocolError(f"agent {sender} sends solver messages without an optimisation")
        if sender not in session.task.members:
            raise ProtocolError(f"agent {sender} takes no part in this optimisation")
        if not session.begun and session.contract is None:
            session.early.append((sender, body))
            return
        if not session.begun:
            self._run(session)  # nobody begins before the manager's word, so that was given
        if self.session is session:
            self._hear(session, sender, body)

    def _late(self, session: OptimisationSession | None, sender: int, body: SolverBody) -> None:
        """Another member still works on what is over here. All it can lack is the last decision: nobody ends before all
        have reported. Decisions are not answered, or two who are done would talk for ever."""
        if session is None or sender not in session.task.members or decides(body):
            return
        found = session.link.again(session.node, sender, body, self.context.now_ns, self.context.retransmitter.rtt)
        self._repeat(session, [m for m in found if decides(m)])

    # -- both ---------------------------------------------------------------------------------------------------------

    def on_end(self, contract: Contract) -> None:
        if self.tender is not None and self.tender.identity == contract.id:
            self._answered(contract.contractor)
            return
        if contract.state is ContractState.DONE:
            return
        session = self.session
        if session is None or session.identity != contract.id:
            over = self._before.get(contract.id)
            if over is not None and contract.manager == self.state.me and contract.contractor in over.task.members:
                self.attempts.missed = True
        elif contract.manager != self.state.me:
            self._leave(session)
        elif contract.contractor in session.task.members:
            self._leave(session)
            self.attempts.failed(self.context.now_ns, self.state.me)
            self.context.cancel(self.context.ledger.managed(contract.id), f"agent {contract.contractor} dropped out")

    def _leave(self, session: OptimisationSession) -> None:
        """Out of an optimisation that did not come to its end; late messages of it are ignored."""
        self.session = None
        self._before.remember(session.identity, None)

    def resend(self) -> None:
        """Say again what other members may have missed, if nothing goes on; give up where there is no end in sight."""
        session = self.session
        if session is not None and session.begun:
            others = set(session.task.members) - {self.state.me}
            patience_ns = self.context.deadline_ns(OperationKind.DOPT, others) - self.context.now_ns
            if others and self.context.now_ns > session.began_ns + patience_ns:
                # The others are through, and their last word does not reach this agent.
                self._leave(session)
                self.attempts.failed(self.context.now_ns, self.state.me)
                if session.contract is not None:
                    self.context.say(session.contract, Failure("the last word did not arrive"))
                return
            self._repeat(session, session.link.due(session.node, self.context.now_ns, self.context.retransmitter.rtt))

    def _run(self, session: OptimisationSession) -> None:
        session.begun, session.began_ns = True, self.context.now_ns
        session.link.goes_on(self.context.now_ns)
        self._send(session, session.node.start())
        early, session.early = session.early, []
        for sender, body in early:
            self._hear(session, sender, body)
        self._finish_if_done(session)

    def _hear(self, session: OptimisationSession, sender: int, body: SolverBody) -> None:
        try:
            out = session.node.handle(from_wire(sender, self.state.me, body))
        except BackendError as error:
            raise ProtocolError(f"solver message of agent {sender}: {error}") from error
        now_ns = self.context.now_ns
        if session.link.seen(sender, body) and not out:
            self._repeat(
                session, session.link.again(session.node, sender, body, now_ns, self.context.retransmitter.rtt)
            )
        elif out:
            session.link.goes_on(now_ns)
        self._send(session, out)
        self._finish_if_done(session)

    def _send(self, session: OptimisationSession, messages: Sequence[SolverMessage]) -> None:
        for message in messages:
            body = to_wire(message)
            session.sent_bytes += ENVELOPE_BYTES + solver_payload(body)
            self.context.tell(message.receiver, session.identity, body)

    def _repeat(self, session: OptimisationSession, messages: Sequence[SolverMessage]) -> None:
        self.repeated += len(messages)
        self._send(session, messages)

    def _finish_if_done(self, session: OptimisationSession) -> None:
        outcome = session.node.outcome
        if outcome is None or self.session is not session:
            return
        self.session = None
        self.attempts.succeeded()
        self._before.remember(session.identity, session)
        self.terms.paid(session)
        self.adoptions.append(adopt(self.state, session.task, outcome))
        sweeps = outcome.rotation_sweeps + outcome.pose_sweeps
        if session.contract is not None:
            answer = OptimiseAnswer(outcome.accepted, outcome.cost_before, outcome.cost_after, sweeps)
            self.context.say(session.contract, Result(answer))
        else:
            self.context.note(
                "optimised",
                members=list(session.task.members),
                matches=len(session.task.matches),
                sweeps=sweeps,
                improved=outcome.accepted,
                reason=outcome.reason,
                cost_before=outcome.cost_before,
                cost_after=outcome.cost_after,
            )
