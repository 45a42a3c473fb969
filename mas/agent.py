"""One agent: a state machine without I/O. It sees its own key-frames and the messages it gets, and nothing else.

``observe`` takes a key-frame from its sensors, ``handle`` a message, ``tick`` and ``remind`` the logical time; the last
three return the messages to send and the events to log. The same code runs in one process and over a network (thesis
section 3.8.2). The agent decides nothing about an operation: it passes on what comes in, and what follows from it.
"""

from __future__ import annotations

from collections import deque
from typing import Any

from .config import MasConfig
from .contracts.call_queue import CallQueue
from .contracts.context import AgentContext
from .contracts.contract import Contract, ContractState, LateMessage, Repeated
from .contracts.effects import NOTHING, Change, Effects, MembersMissed
from .contracts.ledger import Ledger
from .contracts.operation import Operation, WorkError
from .contracts.reputation import Trust, TrustChange
from .errors import ProtocolError
from .map_exchange.final_round import FinalRound
from .map_exchange.operation import MapExchange
from .optimisation.operation import Optimisation
from .optimisation.pending_matches import PendingMatches
from .place_recognition.candidates import Candidates
from .place_recognition.operation import PlaceRecognition
from .place_recognition.verification import Verification, tell_group
from .policies.base import Outlook, Policy
from .protocol.claims import false_claim
from .protocol.ids import REASON_LENGTH, ContractId, MatchId
from .protocol.messages import (
    Award,
    Begin,
    Bid,
    Call,
    Confirmation,
    ContractBody,
    Failure,
    GroupNotice,
    MapNotice,
    Message,
    Rejection,
    Result,
)
from .protocol.solver_messages import SolverBody
from .protocol.tasks import Outcome
from .state.agent_state import AgentState, Profile
from .state.keyframe import KeyFrame
from .state.pose_graph import Adoption
from .state.positions import uses_positions


class Agent:
    """``state``, ``candidates``, ``maps`` are read by the recorder after the run, never by another agent."""

    def __init__(self, profile: Profile, config: MasConfig, policy: Policy) -> None:
        self.state = AgentState(profile, config)
        self.policy = policy
        self.context = AgentContext(self.state, Ledger(profile.me))
        self.candidates = Candidates(self.state)
        verification = Verification(self.context, self.candidates)
        self.places = PlaceRecognition(self.context, self.candidates, verification)
        self.optimisation = Optimisation(self.context, lambda: policy.peer_to_peer(self.state, self.outlook()))
        self.maps = MapExchange(self.context, policy.worth)
        operations: tuple[Operation[Any, Any], ...] = (self.places, verification, self.optimisation, self.maps)
        self._operations = {operation.kind: operation for operation in operations}
        self.call_queue = CallQueue(self.context, self._operations)
        self._new: list[KeyFrame] = []
        self.pending = PendingMatches(self.state)
        self.final_round = FinalRound(self.context, self.maps)

    # -- what comes in ------------------------------------------------------------------------------------------------

    def meet(self, other: int) -> None:
        """Another agent is there: it can be called from now on."""
        self.state.meet(other)

    def observe(self, keyframe: KeyFrame) -> None:
        """The sensors' next key-frame."""
        self.state.observe(keyframe)
        self.candidates.remember(keyframe)
        self._new.append(keyframe)

    def finish(self) -> None:
        """All sequences are over: from now on the agent only settles what it knows."""
        self.context.close()

    def handle(self, message: Message) -> Effects:
        """Act on a message. One that makes no sense here is refused, which is an event, and changes nothing: that is
        decided before anything changes. An error of another type is this program's own, and nobody's fault."""
        there = NOTHING
        try:
            if message.recipient != self.state.me or message.sender not in self.state.profile.others:
                raise ProtocolError(
                    f"message from {message.sender} to {message.recipient} came to agent {self.state.me}"
                )
            there = Effects(changes=self.context.reputation.received(message.sender, self.context.now_ns))
            effects = self._dispatch(message)
        except Repeated as repeated:
            effects = self.context.answer_again(repeated.contract, message.body)
        except LateMessage:
            effects = NOTHING
        except ProtocolError as error:
            effects = self.context.refuse(message.sender, str(error))
        return self._settled(there + effects)

    def refuse(self, sender: int, reason: str) -> Effects:
        """The transport brought bytes of an agent that are no message, or one in another's name."""
        return self._settled(self.context.refuse(sender, reason))

    def tick(self, now_ns: int) -> Effects:
        """Logical time goes on: contracts expire, and the policy is asked what to do next."""
        effects = self._remind(now_ns) + self.maps.tick()
        for keyframe in self._new:
            effects += self.places.ask(keyframe.index, self.policy.ask(self.state, self.outlook(), keyframe.index))
            if self.state.config.places.own_loops:
                effects += self.places.close_own_loop(keyframe)
        if self._new or self.context.closing:
            effects += self.places.recall(self.policy.recall(self.state, self.outlook(), len(self._new)))
        self._new = []
        effects += self.places.resume() + self.places.verification.resume() + self.places.widen()
        return self._settled(effects + self._pursue())

    def remind(self, now_ns: int) -> Effects:
        """Between two ticks: what expires by now, and what is to be sent again because nobody answered."""
        return self._settled(self._remind(now_ns))

    def _remind(self, now_ns: int) -> Effects:
        self.context.now_ns = now_ns
        effects = self._wound_up(self.context.ended(self.context.ledger.expired(now_ns)))
        effects += self._wound_up(self.context.retransmit())
        return effects + self.optimisation.resend()

    # -- what is going on ---------------------------------------------------------------------------------------------

    @property
    def quiet(self) -> bool:
        """Whether the agent, all sequences over, has nothing left to do unless others bring it something."""
        busy = self.optimisation.waits or self.context.ledger.unsettled or bool(self._new)
        pending = self._pending() or self._new_positions()
        if not self.context.closing or busy or pending or not self.final_round.over:
            return False
        return not self._behind() and not self.places.widening and not self.places.unasked

    @property
    def held_matches(self) -> frozenset[MatchId]:
        """Accepted matches that its poses hold: an optimisation or an update has taken them in, as far as it knows."""
        updates = self.optimisation.running.updates
        updated = updates.matches if updates.settled else frozenset()
        return frozenset(self.state.accepted - (self.pending.matches - updated))

    @property
    def waiting(self) -> bool:
        """Whether others owe it an answer: it wants to be reminded."""
        return self.context.retransmitter.owed or self.optimisation.waits or self.call_queue.waiting

    def outlook(self) -> Outlook:
        """Facts for the policy beside the state."""
        count = len(self.state.keyframes)
        return Outlook(
            pending_matches=len(self._pending()) + self._new_positions(),
            since_optimised=count - self.pending.optimised_at,
            since_bought={a: count - at for a, at in sorted(self.maps.last_bought.items())},
            since_matched={a: count - 1 - at for a, at in sorted(self.candidates.last_matched.items())},
            stale=frozenset(self.maps.stale),
            distances=dict(self.places.distances),
            reachable=frozenset(a for a in self.state.profile.others if self.context.may_call(a)),
            closing=self.context.closing,
            delivered=dict(self.places.sent_queries.delivered),
        )

    def _behind(self) -> bool:
        """Whether others lack earlier key-frames, and wait for them."""
        return any(self.places.sent_queries.unsent(a) for a in self.policy.recall(self.state, self.outlook(), 0))

    def _pending(self) -> set[MatchId]:
        """Matches accepted or withdrawn since the last optimisation and its updates; none when it failed too often at
        the end."""
        if self.context.closing and self.optimisation.running.attempts.hopeless:
            return set()
        return self.pending.matches - self.optimisation.running.updates.considered

    def _new_positions(self) -> bool:
        """Whether no optimisation has used its latest positions, and it is time: alone, or at the end."""
        state = self.state
        if not (self.context.closing or len(state.group) == 1) or self.optimisation.running.attempts.hopeless:
            return False
        if self.context.closing and not state.lengths_settled:
            return True
        return any(k.fixes for k in state.keyframes[self.pending.optimised_at :]) and uses_positions(state)

    def _pursue(self) -> Effects:
        """First optimise what was learned, then buy maps: thesis section 3.8.2's order of operations."""
        effects = self.optimisation.update()
        if not self.optimisation.ready:
            return effects
        outlook = self.outlook()
        members = self.policy.optimise(self.state, outlook)
        if members:
            self.pending.offered(members)
            return effects + self.optimisation.start(members, self._pending())
        sellers = self.policy.buy(self.state, outlook)
        if not self.context.closing:
            return effects + (self.maps.buy(sellers) if sellers else NOTHING)
        return effects + (self.final_round.buy(sellers) if self.optimisation.running.updates.settled else NOTHING)

    # -- messages -----------------------------------------------------------------------------------------------------

    def _dispatch(self, message: Message) -> Effects:
        """Effects of a message; :class:`ProtocolError`, before anything has changed, if it makes no sense."""
        sender, identity, body = message.sender, message.contract, message.body
        if not isinstance(body, Result):  # a result that may not be is an objection: it ends its contract
            objection = false_claim(sender, body, self._everyone)
            if objection and isinstance(body, Bid):
                return self._false_bid(sender, identity, objection)
            if objection:
                raise ProtocolError(objection)
        if isinstance(body, GroupNotice):
            return self._join(body.members, known_by_sender=frozenset(body.members))
        if isinstance(body, MapNotice):
            self.maps.note_offers(sender, body.offers)
            return NOTHING
        if isinstance(body, SolverBody):
            return self.optimisation.solver(sender, identity, body)
        if isinstance(body, Begin):
            return self.optimisation.begin(sender, identity)
        if identity is None:
            raise ProtocolError(f"{type(body).__name__} without a contract")
        if isinstance(body, Call):
            return self._called(sender, identity, body)
        return self._advance(sender, identity, body)

    def _false_bid(self, sender: int, identity: ContractId | None, objection: str) -> Effects:
        """Its contract ends at once: the others' bids would wait for this one until the deadline."""
        managed = self.context.ledger.managed(identity) if identity is not None else []
        spoilt = [contract for contract in managed if contract.contractor == sender]
        return self.context.refuse(sender, objection) + self.context.cancel(spoilt, "a bid that may not be")

    @property
    def _everyone(self) -> frozenset[int] | None:
        """The agents that there are; None where nobody can know."""
        return self.state.profile.everyone if self.state.profile.complete else None

    def _join(self, members: tuple[int, ...], known_by_sender: frozenset[int] = frozenset()) -> Effects:
        """More agents are joined by matches: the group gets a notice, unless the sender knows as much. Agents that it
        has not met are left out: it cannot call them."""
        known = set(self.state.group)
        grown = self.state.join(self.state.profile.known(members))
        return tell_group(self.context) if grown and not known <= known_by_sender else NOTHING

    def _called(self, sender: int, identity: ContractId, body: Call) -> Effects:
        """A call for proposals: bid or refuse."""
        if body.deadline_ns < self.context.now_ns:
            raise LateMessage(f"call of agent {sender} came after its deadline")
        body = self.context.capped(body)
        taken = self.context.ledger.called(sender, identity, body)
        effects = self._wound_up(self.context.ended(taken.superseded)) + self._join(body.members)
        return effects + self.call_queue.take(taken.contract, body)

    def _advance(self, sender: int, identity: ContractId, body: ContractBody) -> Effects:
        """A contract goes on: the ledger allows it or not, then the operation acts."""
        contract = self.context.ledger.receive(identity, sender, body, self._objection)
        operation, effects = self._operations[contract.operation], self.context.received(contract)
        if isinstance(body, Bid):
            if body.ready_ns > contract.deadline_ns:
                return effects + self.context.send(contract, Rejection("ready too late"))
            return effects + operation.on_bid(contract, body)
        if isinstance(body, Award):
            return effects + self._work(contract, body)
        if isinstance(body, Confirmation):
            return effects + operation.on_confirmation(contract)
        if isinstance(body, Result):
            if contract.state is ContractState.FAILED:
                return effects + self.context.refuse(sender, contract.reason)
            return effects + operation.on_result(contract, body.outcome)
        return effects

    def _objection(self, contract: Contract, outcome: Outcome) -> str:
        if outcome.belongs_to is not contract.operation:
            return f"{outcome.kind} is no result of {contract.operation.name.lower()}"
        objection = false_claim(contract.contractor, Result(outcome), self._everyone)
        return (objection or self._operations[contract.operation].objection(contract, outcome))[:REASON_LENGTH]

    def _work(self, contract: Contract, award: Award) -> Effects:
        try:
            if award.task.belongs_to is not contract.operation:
                raise WorkError(f"{award.task.kind} is no task of {contract.operation.name.lower()}")
            return self._operations[contract.operation].work(contract, award.task)
        except WorkError as error:
            return self.context.send(contract, Failure(str(error)[:REASON_LENGTH]))

    # -- what follows -------------------------------------------------------------------------------------------------

    def _settled(self, effects: Effects) -> Effects:
        """Messages and events, once everything that follows is done; calls that waited are answered now."""
        effects = self._wound_up(effects)
        return effects + self._wound_up(self.call_queue.inspect())

    def _wound_up(self, effects: Effects) -> Effects:
        """Wind up what ended, then pass changes on, until nothing follows any more."""
        out, ended, changes = effects.outward, deque(effects.ended), deque(effects.changes)
        while ended or changes:
            more = self._end(ended.popleft()) if ended else self._change(changes.popleft())
            out += more.outward
            ended.extend(more.ended)
            changes.extend(more.changes)
        return out

    def _end(self, contract: Contract) -> Effects:
        operation = self._operations[contract.operation]
        closed = self._wound_up(self.context.close_account(contract, operation.answers_for(contract)))
        return closed + operation.on_end(contract)

    def _change(self, change: Change) -> Effects:
        """One operation did something that others act on."""
        if isinstance(change, MembersMissed):
            again = self.pending.call_again()
            return self.optimisation.running.updates.end("a member missed the optimisation") if again else NOTHING
        if isinstance(change, TrustChange):
            return self._trust(change)
        if isinstance(change, Adoption) and change.borne_out:
            self.pending.used(change.matches, change.elsewhere)
        elif isinstance(change, Adoption):
            self.pending.refused(len(self.state.profile.others))
        self.final_round.reopen()
        return self.maps.realign(change)

    def _trust(self, change: TrustChange) -> Effects:
        """Log in whom trust has changed, and believe the matches that it reported no more, or again."""
        self.state.distrust(change.other, change.trust is Trust.UNTRUSTED)
        return self.context.event(
            "reputation",
            of=change.other,
            trust=str(change.trust),
            reliability=round(change.reliability, 4),
            consistency=round(change.consistency, 4),
            silent=change.unanswered,
        )
