"""One agent: a state machine without I/O. It sees its own key-frames and the messages it gets, and nothing else.

``observe`` takes a key-frame from its sensors, ``handle`` a message, ``tick`` the logical time; the last two return
what is to be sent. The same code runs in one process and over a network (thesis section 3.8.2).
"""

from __future__ import annotations

from dataclasses import dataclass

from .config import MasConfig
from .contracts.call_queue import CallQueue
from .contracts.context import AgentContext, Event
from .contracts.contract import Contract, LateMessage, ProtocolError, Repeated
from .contracts.ledger import Ledger
from .contracts.operation import Operation, WorkError
from .contracts.reputation import Trust
from .map_exchange.final_round import FinalRound
from .map_exchange.operation import MapExchange
from .optimisation.operation import Optimisation
from .optimisation.pending_matches import PendingMatches
from .place_recognition.candidates import Candidates
from .place_recognition.operation import PlaceRecognition
from .place_recognition.verification import Verification, tell_group
from .policies.base import Outlook, Policy
from .protocol.ids import ContractId, MatchId, OperationKind
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
from .state.agent_state import AgentState, Profile
from .state.keyframe import KeyFrame

_REASON_LENGTH = 200


@dataclass(frozen=True)
class Refused:
    """A message that could not be acted on, and why."""

    sender: int
    reason: str


class Agent:
    """``state``, ``book``, ``maps`` are read by the recorder after the run, never by another agent."""

    def __init__(self, profile: Profile, config: MasConfig, policy: Policy) -> None:
        self.state = AgentState(profile, config)
        self.policy = policy
        self.context = AgentContext(self.state, Ledger(profile.me))
        self.book = Candidates(self.state)
        verification = Verification(self.context, self.book)
        self.places = PlaceRecognition(self.context, self.book, verification)
        self.optimisation = Optimisation(self.context, lambda: policy.peer_to_peer(self.state, self.outlook()))
        self.maps = MapExchange(self.context, policy.worth)
        self.refused: list[Refused] = []
        self._operations: dict[OperationKind, Operation] = {
            OperationKind.DVPR: self.places,
            OperationKind.RELPOSE: verification,
            OperationKind.DOPT: self.optimisation,
            OperationKind.MAPMERGE: self.maps,
        }
        self.pool = CallQueue(self.context, self._operations)
        self._new: list[KeyFrame] = []
        self.news = PendingMatches(self.state)
        self.final = FinalRound(self.context, self.maps)

    # -- what comes in ------------------------------------------------------------------------------------------------

    def observe(self, keyframe: KeyFrame) -> None:
        """The sensors' next key-frame."""
        self.state.observe(keyframe)
        self.book.remember(keyframe)
        self._new.append(keyframe)

    def finish(self) -> None:
        """The environment's word that all sequences are over: from now on the agent only settles what it knows."""
        self.context.close()

    def handle(self, message: Message) -> list[Message]:
        """Act on a message; one that makes no sense here is refused and remembered, and changes nothing."""
        try:
            if message.recipient != self.state.me or message.sender not in self.state.profile.others:
                raise ProtocolError(
                    f"message from {message.sender} to {message.recipient} came to agent {self.state.me}"
                )
            self.context.reputation.heard(message.sender)
            self._dispatch(message)
        except Repeated as repeated:
            self.context.answer_again(repeated.contract, message.body)
        except LateMessage:
            pass
        except (ProtocolError, WorkError, ValueError) as error:
            self.refused.append(Refused(message.sender, str(error)))
            self.context.note("refused", sender=message.sender, reason=str(error))
        return self._settle()

    def tick(self, now_ns: int) -> list[Message]:
        """Logical time goes on: contracts expire, and the policy is asked what to do next."""
        self._remind(now_ns)
        self.maps.tick()
        for keyframe in self._new:
            self.places.ask(keyframe.index, self.policy.ask(self.state, self.outlook(), keyframe.index))
            if self.state.config.places.own_loops:
                self.places.close_own_loop(keyframe)
        if self._new or self.context.closing:
            self.places.recall(self.policy.recall(self.state, self.outlook(), len(self._new)))
        self._new = []
        self.places.resume()
        self.places.verification.resume()
        self._pursue()
        return self._settle()

    def remind(self, now_ns: int) -> list[Message]:
        """Between two ticks: what expires by now, and what is to be said again because nobody answered."""
        self._remind(now_ns)
        return self._settle()

    def _remind(self, now_ns: int) -> None:
        self.context.now_ns = now_ns
        for contract in self.context.ledger.expired(now_ns):
            self.context.watch(contract)
        self._settle_contracts()
        self.context.remind()
        self._settle_contracts()
        self.optimisation.resend()

    # -- what is going on ---------------------------------------------------------------------------------------------

    @property
    def quiet(self) -> bool:
        """Whether the agent, all sequences over, has nothing left to do unless others bring it something."""
        busy = self.optimisation.busy or bool(self.context.ledger.running()) or bool(self._new)
        return self.context.closing and not busy and not self._news() and self.final.over and not self._behind()

    @property
    def waiting(self) -> bool:
        """Whether others owe it an answer: it wants to be reminded."""
        return self.context.retransmitter.owed or self.optimisation.busy or self.pool.waiting

    @property
    def diary(self) -> list[Event]:
        """What happened so far, oldest first."""
        return self.context.diary

    def outlook(self) -> Outlook:
        """What the policy may know beside the state."""
        count = len(self.state.keyframes)
        return Outlook(
            news=len(self._news()),
            since_optimised=count - self.news.optimised_at,
            since_bought={a: count - at for a, at in sorted(self.maps.last_bought.items())},
            since_matched={a: count - 1 - at for a, at in sorted(self.book.last_matched.items())},
            stale=frozenset(self.maps.stale),
            distances=dict(self.places.distances),
            reachable=frozenset(a for a in self.state.profile.others if self.context.may_call(a)),
            closing=self.context.closing,
            delivered=dict(self.places.told.delivered),
        )

    def _behind(self) -> bool:
        """Whether others wait to be told of earlier key-frames."""
        return any(self.places.told.untold(a) for a in self.policy.recall(self.state, self.outlook(), 0))

    def _news(self) -> set[MatchId]:
        """Matches accepted or withdrawn since the last optimisation; none when it failed too often at the end."""
        if self.context.closing and self.optimisation.attempts.hopeless:
            return set()
        return self.news.matches

    def _pursue(self) -> None:
        """First optimise what was learned, then buy maps: thesis section 3.8.2's order of operations."""
        if not self.optimisation.ready:
            return
        outlook = self.outlook()
        members = self.policy.optimise(self.state, outlook)
        if members:
            self.news.offered(members)
            self.optimisation.start(members)
            return
        sellers = self.policy.buy(self.state, outlook)
        if self.context.closing:
            sellers = [] if self.context.calling(OperationKind.MAPMERGE) else self.final.choose(sellers)
        if sellers:
            self.maps.buy(sellers)

    # -- messages -----------------------------------------------------------------------------------------------------

    def _dispatch(self, message: Message) -> None:
        sender, identity, body = message.sender, message.contract, message.body
        if isinstance(body, GroupNotice):
            known = set(self.state.group)
            # Who knows no more than the sender has nothing to pass on: the sender has told them all.
            if self.state.join(body.members) and not known <= set(body.members):
                tell_group(self.context)
        elif isinstance(body, MapNotice):
            self.maps.hear_of(sender, body.offers)
        elif isinstance(body, SolverBody):
            self.optimisation.solver(sender, identity, body)
        elif isinstance(body, Begin):
            self.optimisation.begin(sender, identity)
        elif identity is None:
            raise ProtocolError(f"{type(body).__name__} without a contract")
        elif isinstance(body, Call):
            self._called(sender, identity, body)
        else:
            self._advance(sender, identity, body)

    def _called(self, sender: int, identity: ContractId, body: Call) -> None:
        """A call for proposals: bid or refuse."""
        if body.deadline_ns < self.context.now_ns:
            raise LateMessage(f"call of agent {sender} came after its deadline")
        contract = self.context.ledger.called(sender, identity, body)
        superseded, self.context.ledger.superseded = self.context.ledger.superseded, []
        for old in superseded:
            self.context.watch(old)
        self._settle_contracts()
        if body.members and self.state.join(body.members):
            tell_group(self.context)
        self.pool.take(contract, body)

    def _advance(self, sender: int, identity: ContractId, body: ContractBody) -> None:
        """A contract goes on: the ledger allows it or not, then the operation acts."""
        contract = self.context.ledger.hear(identity, sender, body)
        self.context.hear(contract)
        trade = self._operations[contract.operation]
        if isinstance(body, Bid) and body.ready_ns > contract.deadline_ns:
            self.context.say(contract, Rejection("ready too late"))
        elif isinstance(body, Bid):
            trade.on_bid(contract, body)
        elif isinstance(body, Award):
            self._work(trade, contract, body)
        elif isinstance(body, Confirmation):
            trade.on_confirmation(contract)
        elif isinstance(body, Result):
            trade.on_result(contract, body.outcome)

    def _work(self, trade: Operation, contract: Contract, award: Award) -> None:
        try:
            trade.work(contract, award.task)
        except (WorkError, ValueError) as error:
            self.context.say(contract, Failure(str(error)[:_REASON_LENGTH]))

    def _settle(self) -> list[Message]:
        """Wind up what ended, take over what an optimisation brought, and hand out the mail."""
        self._settle_contracts()
        self.pool.inspect()
        self._settle_contracts()
        out, self.context.outbox = self.context.outbox, []
        return out

    def _settle_contracts(self) -> None:
        while self.context.ended or self.optimisation.adoptions:
            while self.context.ended:
                contract = self.context.ended.pop(0)
                self.context.note_end(contract)
                self._note_standing()
                self._operations[contract.operation].on_end(contract)
            adoptions, self.optimisation.adoptions = self.optimisation.adoptions, []
            for adoption in adoptions:
                self.news.used(adoption.matches)
                self.maps.realign(adoption)
                self.maps.stale.update(self.state.partners())
                self.final.searching = True
            if self.optimisation.attempts.missed and not self.optimisation.busy:
                self.optimisation.attempts.missed = False
                self.news.call_again()

    def _note_standing(self) -> None:
        """Who is regarded otherwise since the last contract."""
        for other, record in self.context.reputation.changes(self.context.now_ns):
            self.context.note(
                "standing",
                of=other,
                regard=str(record.regard),
                reliability=round(record.reliability, 4),
                honesty=round(record.honesty, 4),
                silent=record.unheard,
            )
            self.state.distrust(other, record.regard is Trust.UNTRUSTED)
