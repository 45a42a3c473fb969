"""The optimisation that an agent takes part in, from its beginning to its end: solver messages, patience, and what is
adopted of its result."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.distributed.wire import SolverMessage
from maslam.backend.errors import BackendError

from ..contracts.context import AgentContext
from ..contracts.effects import NOTHING, Effects, MembersMissed, total
from ..contracts.reputation import NEVER_BEGAN
from ..policies.utility import ENVELOPE_BYTES
from ..protocol.ids import REASON_LENGTH, OperationKind
from ..protocol.messages import Failure, Result
from ..protocol.solver_messages import SolverBody
from ..protocol.tasks import OptimiseAnswer
from ..protocol.tensors import MessageError
from ..state.pose_graph import adopt, believable
from .bidding import BidEstimator
from .group_updates import GroupUpdates
from .own_judgement import CLEARLY_WORSE, judged
from .session import Backoff, OptimisationSession, SessionHistory
from .suspicion import Suspicion
from .undecided import UndecidedMatches, undecided_matches

# How many times as long as a silent contractor is waited for members of an optimisation wait for each other.
_PATIENCE = 2


class RunningOptimisation:
    """At most one ``session`` at a time; those that are over are kept in ``before``, for messages that come late.

    Nobody can be sure that all others have received the last message (two generals). So whoever has not keeps its poses
    where they were: a frame is named for the key-frame it begins with, which no optimisation moves, so that estimates
    of before and after lie in the same one. Its contract ends without a result, and the manager calls again:
    ``missed`` says that a member has not. ``undecided``: what the last optimisation left open, where this agent was
    elected.
    """

    def __init__(self, context: AgentContext) -> None:
        self.context = context
        self.session: OptimisationSession | None = None
        self._rtt = context.retransmitter.rtt
        self.attempts = Backoff(context.state.config.link, self._rtt)
        self.repeated = 0
        self.missed = False
        self.before = SessionHistory()
        self.suspicion = Suspicion(context.state.me)
        self.estimator = BidEstimator(context)
        self.updates = GroupUpdates(context)
        self.undecided: tuple[UndecidedMatches, ...] = ()

    def solver(self, session: OptimisationSession, message: SolverMessage) -> Effects:
        """A solver message of another member of the present session."""
        if session.begun:
            return self.receive(session, message)
        session.keep(message)
        # Nobody begins before the manager has sent the others Begin: so that was sent to me, too.
        return NOTHING if session.contract is None else self.run(session)

    def late(self, session: OptimisationSession, message: SolverMessage) -> Effects:
        """One of a session that is over here."""
        return self.repeat(session, session.late(message, self.context.now_ns, self._rtt))

    def leave(self, session: OptimisationSession) -> Effects:
        """Out of an optimisation that did not come to its end; late messages of it are ignored."""
        self.session = None
        self.before.remember(session.identity, None)
        return self.idle()

    def fail(self, session: OptimisationSession) -> Effects:
        """Out of it, as :meth:`leave`, to be tried again later."""
        self.attempts.failed(self.context.now_ns, self.context.state.me)
        return self.leave(session)

    def idle(self) -> Effects:
        """Once nothing goes on here, it shows that members have missed the last optimisation."""
        if not self.missed or self.session is not None:
            return NOTHING
        self.missed = False
        return Effects(changes=(MembersMissed(),))

    def resend(self) -> Effects:
        """Send again what other members may have missed, if nothing goes on; give up where there is no end in sight."""
        session = self.session
        if session is None:
            return self.updates.resend()
        if not session.begun:
            return self._await_beginning(session)
        others = set(session.task.members) - {self.context.state.me}
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
            effects = self.fail(session)
            reason = "the last message did not arrive"
            effects += self.context.event("optimisation_left", members=list(session.task.members), reason=reason)
            if session.contract is not None:
                effects += self.context.send(session.contract, Failure(reason))
            return effects
        due = session.link.due(session.node, self.context.now_ns, self._rtt)
        return self.repeat(session, due) + self._finish_if_done(session)

    def _await_beginning(self, session: OptimisationSession) -> Effects:
        """A contractor waits for the manager's word that all have confirmed as long as the manager may wait for it."""
        if session.contract is None:
            return NOTHING
        if self.context.now_ns <= session.agreed_ns + self._patience_ns([session.contract.manager]):
            return NOTHING
        return self.leave(session) + self.context.send(session.contract, Failure(NEVER_BEGAN))

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

    def run(self, session: OptimisationSession) -> Effects:
        """Begin the session, and receive what came early."""
        start = session.begin(self.context.now_ns)
        effects = self._send(session, start.messages)
        for message in start.early:
            effects += self.receive(session, message)
        return effects + self._finish_if_done(session)

    def receive(self, session: OptimisationSession, message: SolverMessage) -> Effects:
        """A solver message of a session that has begun."""
        try:
            reply = session.receive(message, self.context.now_ns, self._rtt)
        except BackendError as error:
            # The others wait for what this message should have been: rather begin anew without its sender.
            self.context.reputation.stalled(message.sender, self.context.now_ns)
            refused = self.context.refuse(message.sender, f"solver message of agent {message.sender}: {error}")
            return refused + self._give_up(session, f"agent {message.sender} sent what makes no sense")
        effects = self.repeat(session, reply.again) + self._send(session, reply.messages)
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
        effects = self.fail(session)
        if session.contract is not None:
            return effects + self.context.send(session.contract, Failure(reason[:REASON_LENGTH]))
        contracts = [] if session.identity is None else self.context.ledger.managed(session.identity)
        return effects + self.context.cancel(contracts, reason[:REASON_LENGTH])

    def repeat(self, session: OptimisationSession, messages: Sequence[SolverMessage]) -> Effects:
        """Send messages again, and count them."""
        self.repeated += len(messages)
        return self._send(session, messages)

    def _judged(self, session: OptimisationSession, outcome: SolverOutcome) -> tuple[SolverOutcome, Effects]:
        """The outcome as far as the agent's own measurements bear it out; who solved it answers for the rest."""
        members = session.task.members
        mine = judged(self.context.state, session.task, session.node.share, outcome)
        if mine is outcome:
            good = outcome.accepted and len(members) > 1
            return outcome, self._held_against(self.suspicion.ended_well(members) if good else None)
        leader = getattr(session.node, "leader", None)
        suspect = self.suspicion.spoilt(members, self._manager(session), leader)
        figures = {"reason": CLEARLY_WORSE, "members": list(members), "by": suspect}
        return mine, self._held_against(suspect) + self.context.event("optimisation_refused", **figures)

    def _left_open(self, outcome: SolverOutcome) -> Effects:
        """Say what selection did not decide: nobody else knows it."""
        self.undecided = undecided_matches(outcome)
        said = ((list(u.agents), [str(m) for m in u.kept], [str(m) for m in u.rejected]) for u in self.undecided)
        return total(self.context.event("undecided", agents=a, kept=k, rejected=r) for a, k, r in said)

    def _manager(self, session: OptimisationSession) -> int:
        return self.context.state.me if session.contract is None else session.contract.manager

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
        self.before.remember(session.identity, session)
        self.estimator.ended(session)
        adopted = adopt(self.context.state, session.task, outcome, session.elsewhere)
        good = outcome.reason != CLEARLY_WORSE
        effects += Effects(changes=(replace(adopted, borne_out=good),)) + self._left_open(outcome)
        effects += (self.updates.begin(session, outcome) if good else NOTHING) + self.idle()
        if session.contract is None:
            return effects + self.context.event("optimised", **session.figures(outcome))
        sweeps = outcome.rotation_sweeps + outcome.pose_sweeps
        answer = OptimiseAnswer(outcome.accepted, outcome.cost_before, outcome.cost_after, sweeps)
        return effects + self.context.send(session.contract, Result(answer))
