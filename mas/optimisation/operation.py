"""Distributed optimisation among agents (thesis section 3.6): one contract with each member, then separator poses
only."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.distributed.update_messages import UpdateMessage
from maslam.backend.distributed.wire import SolverMessage
from maslam.backend.errors import BackendError

from ..contracts.context import AgentContext
from ..contracts.contract import Contract, ContractState
from ..contracts.effects import NOTHING, Effects, MembersMissed, total
from ..contracts.operation import Answer, Operation, WorkError
from ..contracts.reputation import NEVER_BEGAN
from ..errors import ProtocolError
from ..policies.utility import ENVELOPE_BYTES
from ..protocol.ids import REASON_LENGTH, ContractId, MatchId, OperationKind
from ..protocol.messages import Award, Begin, Bid, Call, Confirmation, Failure, Refusal, Rejection, Result
from ..protocol.solver_messages import SolverBody
from ..protocol.tasks import OptimiseAnswer, OptimiseTask
from ..protocol.tensors import MessageError
from ..state.pose_graph import adopt, believable
from .bidding import BidEstimator, bids_to_lower, engaged
from .contradictions import hold_against
from .group_updates import GroupUpdates
from .own_judgement import CLEARLY_WORSE, judged
from .planning import Plan, plan
from .session import Backoff, OptimisationSession, OptimisationTender, SessionHistory, checked_node, node_of
from .suspicion import Suspicion

# How many times as long as a silent contractor is waited for members of an optimisation wait for each other.
_PATIENCE = 2


class Optimisation(Operation[OptimiseTask, OptimiseAnswer]):
    """At most one at a time for an agent. Of two managers that call at once, the lower number goes first.
    Nobody can be sure that all others have received the last message (two generals). So whoever has not keeps its poses
    where they were: a frame is named for the key-frame it begins with, which no optimisation moves, so that estimates
    of before and after lie in the same one. Its contract ends without a result, and the manager calls again.
    """

    kind = OperationKind.DOPT

    def __init__(self, context: AgentContext, peer_to_peer: Callable[[], bool] = lambda: False) -> None:
        """``peer_to_peer``: whether the agent takes part in others' optimisations with their managers only."""
        super().__init__(context)
        self._peer_to_peer = peer_to_peer
        self.tender: OptimisationTender | None = None
        self.session: OptimisationSession | None = None
        self._rtt = context.retransmitter.rtt
        self.attempts = Backoff(context.state.config.link, self._rtt)
        self.repeated = 0
        self._missed = False
        self._bid_ns: dict[int, int] = {}
        self._before = SessionHistory()
        self.suspicion = Suspicion(self.state.me)
        self._estimator = BidEstimator(context)
        self.updates = GroupUpdates(context)

    @property
    def busy(self) -> bool:
        """Whether the agent calls for an optimisation or takes part in one."""
        return self.session is not None or self.tender is not None

    @property
    def waits(self) -> bool:
        """Whether others have to do something yet for an optimisation, or for an update of one."""
        return self.busy or not self.updates.settled

    @property
    def ready(self) -> bool:
        """Whether the agent may call for one now: the last has ended at all members, or it is time to try again."""
        settling = self.context.calling(OperationKind.DOPT) or engaged(self.context, self._bid_ns)
        return not self.busy and not settling and self.context.now_ns >= self.attempts.not_before_ns

    def update(self) -> Effects:
        """Take new matches in without an optimisation, as far as the last one allows."""
        return NOTHING if self.session is not None else self.updates.pursue()

    # -- manager ------------------------------------------------------------------------------------------------------

    def start(self, members: list[int], fresh: Iterable[MatchId] = ()) -> Effects:
        """Call for an optimisation with these agents, alone if no other is named; ``fresh``: matches not used yet."""
        without = {self.state.me, self.suspicion.left_out}
        others = [a for a in members if a not in without and self.context.may_call(a, OperationKind.DOPT)]
        mine = self._estimator.bid()
        if not others:
            return self._award(OptimisationTender(None, set(), {self.state.me: mine}, fresh=frozenset(fresh)))
        asked = tuple(sorted(set(members) - {self.suspicion.left_out}))
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
            self.attempts.failed(self.context.now_ns, me)
            return effects + self._idle()
        self._missed |= bool(tender.missing)
        task = found.tasks[me]
        node, others = node_of(self.state, task), set(found.members) - {me}
        identity = tender.identity if others else None
        self.session = session = OptimisationSession(identity, task, node, None, others, found.elsewhere)
        return effects if others else effects + self._run(session)

    def _answer_bids(self, identity: ContractId, found: Plan) -> Effects:
        effects = hold_against(self.context, found.contradicted)
        for contract in self.context.ledger.managed(identity):
            if contract.contractor in found.tasks:
                effects += self.context.send(contract, Award(found.tasks[contract.contractor]))
            elif contract.state is ContractState.BID:
                effects += self.context.send(contract, Rejection("not connected"))
        return effects

    def on_confirmation(self, contract: Contract) -> Effects:
        session = self.session
        if session is None or session.identity != contract.id:
            return NOTHING
        session.unconfirmed.discard(contract.contractor)
        if session.unconfirmed or session.begun:
            return NOTHING
        others = (m for m in session.task.members if m != self.state.me)
        return total(self.context.tell(m, session.identity, Begin()) for m in others) + self._run(session)

    # -- contractor ---------------------------------------------------------------------------------------------------

    def bid(self, contract: Contract, call: Call) -> Answer:
        if self.session is not None or bids_to_lower(self.context, contract.manager):
            return Answer(None)
        if not self.state.keyframes:
            return Answer(Refusal("nothing to optimise yet"))
        if self.suspicion.left_out in (contract.manager, *call.members):
            return Answer(Refusal("optimisations with one of these were spoilt"))
        effects = NOTHING
        if self.tender is not None:
            if contract.manager > self.state.me:
                return Answer(Refusal("calling for an optimisation itself"))
            effects = self._give_way()
        self._bid_ns[contract.manager] = self.context.now_ns
        return Answer(self._estimator.bid(contract.manager if self._peer_to_peer() else None), effects)

    def _give_way(self) -> Effects:
        """Withdraw the own call."""
        given_up, self.tender = self.tender, None
        if given_up is None or given_up.identity is None:
            return self._idle()
        contracts = self.context.ledger.managed(given_up.identity)
        return self.context.cancel(contracts, "gives way to a lower number") + self._idle()

    def work(self, contract: Contract, task: OptimiseTask) -> Effects:
        if self.busy:
            raise WorkError("busy with an optimisation")
        node = checked_node(self.state, contract, task)
        self.session = OptimisationSession(contract.id, task, node, contract, agreed_ns=self.context.now_ns)
        return self.context.send(contract, Confirmation())

    def begin(self, sender: int, identity: ContractId | None) -> Effects:
        """The manager's message that all members have confirmed."""
        session = self.session
        if session is None or session.identity != identity or identity is None or sender != identity.manager:
            if identity in self._before and identity is not None and sender == identity.manager:
                return NOTHING
            raise ProtocolError(f"agent {sender} begins an optimisation that was not agreed on")
        return NOTHING if session.begun else self._run(session)

    def solver(self, sender: int, identity: ContractId | None, body: SolverBody) -> Effects:
        """A solver message of another member."""
        session, message = self.session, body.read(sender, self.state.me)
        if isinstance(message, UpdateMessage):  # while an optimisation goes on here, its sender waits
            return NOTHING if session is not None else self.updates.handle(identity, message)
        if session is None or session.identity != identity:
            if identity is not None and identity in self._before:
                over, now_ns = self._before[identity], self.context.now_ns
                return NOTHING if over is None else self._repeat(over, over.late(message, now_ns, self._rtt))
            raise ProtocolError(f"agent {sender} sends solver messages without an optimisation")
        if sender not in session.task.members:
            raise ProtocolError(f"agent {sender} takes no part in this optimisation")
        if session.begun:
            return self._receive(session, message)
        session.keep(message)
        # Nobody begins before the manager has sent the others Begin: so that was sent to me, too.
        return NOTHING if session.contract is None else self._run(session)

    # -- both ---------------------------------------------------------------------------------------------------------

    def on_end(self, contract: Contract) -> Effects:
        if self.tender is not None and self.tender.identity == contract.id:
            return self._answered(contract.contractor)
        if contract.state is ContractState.DONE:
            return NOTHING
        session = self.session
        if session is None or session.identity != contract.id:
            over = self._before.get(contract.id)
            if over is not None and contract.manager == self.state.me and contract.contractor in over.task.members:
                self._missed = True
            return self._idle()
        if contract.manager != self.state.me:
            return self._leave(session)
        if contract.contractor not in session.task.members:
            return NOTHING
        effects = self._fail(session)
        contracts = self.context.ledger.managed(contract.id)
        return effects + self.context.cancel(contracts, f"agent {contract.contractor} dropped out")

    def _leave(self, session: OptimisationSession) -> Effects:
        """Out of an optimisation that did not come to its end; late messages of it are ignored."""
        self.session = None
        self._before.remember(session.identity, None)
        return self._idle()

    def _fail(self, session: OptimisationSession) -> Effects:
        """The same, to be tried again later."""
        self.attempts.failed(self.context.now_ns, self.state.me)
        return self._leave(session)

    def _idle(self) -> Effects:
        """Once nothing goes on here, it shows that members have missed the last optimisation."""
        if not self._missed or self.busy:
            return NOTHING
        self._missed = False
        return Effects(changes=(MembersMissed(),))

    def resend(self) -> Effects:
        """Send again what other members may have missed, if nothing goes on; give up where there is no end in sight."""
        session = self.session
        if session is None:
            return self.updates.resend()
        if not session.begun:
            return self._await_beginning(session)
        others = set(session.task.members) - {self.state.me}
        silent = session.silent(self.context.now_ns, self._patience_ns(others))
        if silent:
            sure = (
                silent[0] if len(silent) == 1 else self.suspicion.spoilt(session.task.members, self._manager(session))
            )
            if sure is not None:
                self.context.reputation.stalled(sure, self.context.now_ns)
            reason = f"agents {silent} send nothing"
            effects = self.context.event("optimisation_left", members=list(session.task.members), reason=reason)
            return effects + self._give_up(session, reason)
        if others and self._no_end_in_sight(session, others):
            # Somebody is gone, or the others are through and their last message does not reach this agent.
            effects = self._fail(session)
            reason = "the last message did not arrive"
            effects += self.context.event("optimisation_left", members=list(session.task.members), reason=reason)
            if session.contract is not None:
                effects += self.context.send(session.contract, Failure(reason))
            return effects
        due = session.link.due(session.node, self.context.now_ns, self._rtt)
        return self._repeat(session, due) + self._finish_if_done(session)

    def _await_beginning(self, session: OptimisationSession) -> Effects:
        """A contractor waits for the manager's word that all have confirmed as long as the manager may wait for it."""
        if session.contract is None:
            return NOTHING
        if self.context.now_ns <= session.agreed_ns + self._patience_ns([session.contract.manager]):
            return NOTHING
        return self._leave(session) + self.context.send(session.contract, Failure(NEVER_BEGAN))

    def _patience_ns(self, others: Iterable[int]) -> int:
        """How long members may be silent: a manager may have to give up another one first."""
        patience_ns = self.context.retransmitter.patience_ns
        return _PATIENCE * max((patience_ns(other) for other in others), default=0)

    def _no_end_in_sight(self, session: OptimisationSession, others: set[int]) -> bool:
        """Whether it has taken too long, or has got no further for twice as long as anybody may be silent."""
        now_ns = self.context.now_ns
        deadline_ns = self.context.deadline_ns(OperationKind.DOPT, others) - now_ns
        still_ns = now_ns - session.link.went_on_ns
        return now_ns > session.began_ns + deadline_ns or still_ns > self._patience_ns(others)

    def _run(self, session: OptimisationSession) -> Effects:
        start = session.begin(self.context.now_ns)
        effects = self._send(session, start.messages)
        for message in start.early:
            effects += self._receive(session, message)
        return effects + self._finish_if_done(session)

    def _receive(self, session: OptimisationSession, message: SolverMessage) -> Effects:
        try:
            reply = session.receive(message, self.context.now_ns, self._rtt)
        except BackendError as error:
            # The others wait for what this message should have been: rather begin anew without its sender.
            self.context.reputation.stalled(message.sender, self.context.now_ns)
            refused = self.context.refuse(message.sender, f"solver message of agent {message.sender}: {error}")
            return refused + self._give_up(session, f"agent {message.sender} sent what makes no sense")
        effects = self._repeat(session, reply.again) + self._send(session, reply.messages)
        return effects + self._finish_if_done(session)

    def _send(self, session: OptimisationSession, messages: Sequence[SolverMessage]) -> Effects:
        session.sent_bytes += sum(ENVELOPE_BYTES + m.payload_bytes for m in messages)
        try:
            bodies = [(m.receiver, SolverBody.of(m)) for m in messages]
        except MessageError as error:  # the solver ran away: nobody could use its numbers
            return self._give_up(session, str(error))
        return total(self.context.tell(receiver, session.identity, body) for receiver, body in bodies)

    def _give_up(self, session: OptimisationSession, reason: str) -> Effects:
        if self.session is not session:
            return NOTHING
        effects = self._fail(session)
        if session.contract is not None:
            return effects + self.context.send(session.contract, Failure(reason[:REASON_LENGTH]))
        contracts = [] if session.identity is None else self.context.ledger.managed(session.identity)
        return effects + self.context.cancel(contracts, reason[:REASON_LENGTH])

    def _repeat(self, session: OptimisationSession, messages: Sequence[SolverMessage]) -> Effects:
        self.repeated += len(messages)
        return self._send(session, messages)

    def _judged(self, session: OptimisationSession, outcome: SolverOutcome) -> tuple[SolverOutcome, Effects]:
        """The outcome as far as the agent's own measurements bear it out; who solved it answers for the rest."""
        members = session.task.members
        mine = judged(self.state, session.task, session.node.share, outcome)
        if mine is outcome:
            good = outcome.accepted and len(members) > 1
            return outcome, self._held_against(self.suspicion.ended_well(members) if good else None)
        leader = getattr(session.node, "leader", None)
        suspect = self.suspicion.spoilt(members, self._manager(session), leader)
        figures = {"reason": CLEARLY_WORSE, "members": list(members), "by": suspect}
        return mine, self._held_against(suspect) + self.context.event("optimisation_refused", **figures)

    def _manager(self, session: OptimisationSession) -> int:
        return self.state.me if session.contract is None else session.contract.manager

    def _held_against(self, suspect: int | None) -> Effects:
        """An agent that spoilt an optimisation is left alone for a while, and trusted less."""
        if suspect is None:
            return NOTHING
        self.context.reputation.stalled(suspect, self.context.now_ns)
        return Effects(changes=self.context.reputation.blame(suspect, self.context.now_ns))

    def _finish_if_done(self, session: OptimisationSession) -> Effects:
        outcome = session.node.outcome
        if outcome is None or self.session is not session:
            return NOTHING
        if not believable(outcome.poses.values(), outcome.units.values()):
            return self._give_up(session, "the solution is not finite")
        outcome, effects = self._judged(session, outcome)
        self.session = None
        self.attempts.succeeded()
        self._before.remember(session.identity, session)
        self._estimator.ended(session)
        adopted = adopt(self.state, session.task, outcome, session.elsewhere)
        good = outcome.reason != CLEARLY_WORSE
        effects += Effects(changes=(replace(adopted, borne_out=good),))
        effects += (self.updates.begin(session, outcome) if good else NOTHING) + self._idle()
        if session.contract is None:
            return effects + self.context.event("optimised", **session.figures(outcome))
        sweeps = outcome.rotation_sweeps + outcome.pose_sweeps
        answer = OptimiseAnswer(outcome.accepted, outcome.cost_before, outcome.cost_after, sweeps)
        return effects + self.context.send(session.contract, Result(answer))
