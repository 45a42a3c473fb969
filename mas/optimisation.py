"""Distributed optimisation among agents (thesis section 3.6): one contract with each member, then separator poses
only."""

from __future__ import annotations

from dataclasses import dataclass, field

from backend.distributed.messages import Message as SolverMessage
from backend.distributed.methods import node_for
from backend.distributed.rounds import Rounds
from backend.distributed.share import Outcome as SolverOutcome
from backend.errors import BackendError
from mas.contract import Contract, ProtocolError, State
from mas.desk import Desk, Trade, WorkError
from mas.identities import ContractId, Operation
from mas.messages import Award, Begin, Bid, Call, Confirmation, Refusal, Rejection, Result
from mas.plan import plan
from mas.posegraph import Adoption, adopt, share_of, terms
from mas.solver_messages import SolverBody, from_wire, to_wire
from mas.tasks import OptimiseAnswer, OptimiseTask, Outcome, Task


@dataclass
class Tender:
    """The manager's side until the award: who still has to answer, and what was bid; alone: no contract."""

    identity: ContractId | None
    pending: set[int]
    bids: dict[int, Bid]


@dataclass
class Session:
    """One optimisation this agent takes part in. ``unconfirmed``: members the manager waits for before it begins;
    ``early``: solver messages that came before the start."""

    identity: ContractId | None
    task: OptimiseTask
    node: Rounds
    contract: Contract | None = None
    unconfirmed: set[int] = field(default_factory=set)
    begun: bool = False
    early: list[tuple[int, SolverBody]] = field(default_factory=list)


class Optimisation(Trade):
    """At most one at a time for an agent. Of two managers that call at once, the lower number goes first."""

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.tender: Tender | None = None
        self.session: Session | None = None
        self.adoptions: list[Adoption] = []
        self._last: ContractId | None = None
        self._terms: tuple[int, Bid] | None = None

    @property
    def busy(self) -> bool:
        return self.session is not None or self.tender is not None

    # -- manager ------------------------------------------------------------------------------------------------------

    def start(self, members: list[int]) -> None:
        """Call for an optimisation with these agents; alone if nobody else is named."""
        others = [a for a in members if a != self.state.me]
        mine = self._my_terms()
        if not others:
            self._award(Tender(None, set(), {self.state.me: mine}))
            return
        identity, called = self.desk.call(Operation.DOPT, others, tuple(sorted(members)))
        if called:
            self.tender = Tender(identity, set(called), {self.state.me: mine})

    def on_bid(self, contract: Contract, bid: Bid) -> None:
        if self.tender is None or self.tender.identity != contract.id:
            self.desk.say(contract, Rejection("no longer wanted"))
            return
        self.tender.bids[contract.contractor] = bid
        self._answered(contract.contractor)

    def _answered(self, contractor: int) -> None:
        tender = self.tender
        if tender is None:
            return
        tender.pending.discard(contractor)
        if not tender.pending:
            self.tender = None
            self._award(tender)

    def _award(self, tender: Tender) -> None:
        """Everyone has answered: plan, award to those who are connected, reject the others."""
        me = self.state.me
        found = plan(me, tender.bids)
        contracts = self.desk.ledger.managed(tender.identity) if tender.identity is not None else []
        for contract in contracts:
            if contract.contractor in found.tasks:
                self.desk.say(contract, Award(found.tasks[contract.contractor]))
            elif contract.state is State.BID:
                self.desk.say(contract, Rejection("not connected"))
        task = found.tasks[me]
        node = node_for(share_of(self.state, task), self.state.config.optimisation.solver)
        others = set(found.members) - {me}
        self.session = Session(tender.identity if others else None, task, node, unconfirmed=others)
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
                    self.desk.tell(member, session.identity, Begin())
            self._run(session)

    def on_result(self, contract: Contract, outcome: Outcome) -> None:
        if not isinstance(outcome, OptimiseAnswer):
            raise WorkError("not the result of an optimisation")

    # -- contractor ---------------------------------------------------------------------------------------------------

    def bid(self, contract: Contract, call: Call) -> Bid | Refusal:
        if self.session is not None:
            return Refusal("busy with an optimisation")
        if not self.state.keyframes:
            return Refusal("nothing to optimise yet")
        if self.tender is not None:
            if contract.manager > self.state.me:
                return Refusal("calling for an optimisation itself")
            given_up, self.tender = self.tender, None
            if given_up.identity is not None:
                self.desk.cancel(self.desk.ledger.managed(given_up.identity), "gives way to a lower number")
        return self._my_terms()

    def work(self, contract: Contract, task: Task) -> None:
        me = self.state.me
        if not isinstance(task, OptimiseTask) or me not in task.members or contract.manager not in task.members:
            raise WorkError("not an optimisation of this agent with the manager")
        if self.busy:
            raise WorkError("busy with an optimisation")
        try:
            node = node_for(share_of(self.state, task), self.state.config.optimisation.solver)
        except (BackendError, ValueError) as error:
            raise WorkError(f"cannot take part: {error}") from error
        self.session = Session(contract.id, task, node, contract)
        self.desk.say(contract, Confirmation())

    def begin(self, sender: int, identity: ContractId | None) -> None:
        """The manager's word that all members have confirmed."""
        session = self.session
        if session is None or session.identity != identity or identity is None or sender != identity.manager:
            raise ProtocolError(f"agent {sender} begins an optimisation that was not agreed on")
        if not session.begun:
            self._run(session)

    def solver(self, sender: int, identity: ContractId | None, body: SolverBody) -> None:
        """A solver message of another member."""
        session = self.session
        if session is None or session.identity != identity:
            if identity is not None and identity == self._last:
                return
            raise ProtocolError(f"agent {sender} sends solver messages without an optimisation")
        if sender not in session.task.members:
            raise ProtocolError(f"agent {sender} takes no part in this optimisation")
        if not session.begun:
            session.early.append((sender, body))
            return
        self._hear(session, sender, body)

    # -- both ---------------------------------------------------------------------------------------------------------

    def on_end(self, contract: Contract) -> None:
        if self.tender is not None and self.tender.identity == contract.id:
            self._answered(contract.contractor)
            return
        session = self.session
        if session is None or session.identity != contract.id or contract.state is State.DONE:
            return
        if contract.manager != self.state.me:
            self.session = None
        elif contract.contractor in session.task.members:
            self.session = None
            self.desk.cancel(self.desk.ledger.managed(contract.id), f"agent {contract.contractor} dropped out")

    def _my_terms(self) -> Bid:
        """The agent's bid, made once for each state it is in: several managers may call at the same time."""
        if self._terms is None or self._terms[0] != self.state.version:
            self._terms = (self.state.version, terms(self.state, self.desk.now_ns))
        return self._terms[1]

    def resend(self) -> None:
        """Say again what other members may have missed (transports that lose messages)."""
        if self.session is not None and self.session.begun:
            session = self.session
            self._send(session, session.node.tick())
            self._finish_if_done(session)

    def _run(self, session: Session) -> None:
        session.begun = True
        self._send(session, session.node.start())
        early, session.early = session.early, []
        for sender, body in early:
            self._hear(session, sender, body)
        self._finish_if_done(session)

    def _hear(self, session: Session, sender: int, body: SolverBody) -> None:
        try:
            out = session.node.handle(from_wire(sender, self.state.me, body))
        except BackendError as error:
            raise ProtocolError(f"solver message of agent {sender}: {error}") from error
        self._send(session, out)
        self._finish_if_done(session)

    def _send(self, session: Session, messages: list[SolverMessage]) -> None:
        for message in messages:
            self.desk.tell(message.receiver, session.identity, to_wire(message))

    def _finish_if_done(self, session: Session) -> None:
        outcome = session.node.outcome
        if outcome is None or self.session is not session:
            return
        self.session, self._last = None, session.identity
        self.adoptions.append(adopt(self.state, session.task, outcome))
        if session.contract is not None:
            self.desk.say(session.contract, Result(_answer(outcome)))
        else:
            self.desk.note(
                "optimised",
                members=list(session.task.members),
                matches=len(session.task.matches),
                sweeps=outcome.rotation_sweeps + outcome.pose_sweeps,
                improved=outcome.accepted,
                reason=outcome.reason,
                cost_before=outcome.cost_before,
                cost_after=outcome.cost_after,
            )


def _answer(outcome: SolverOutcome) -> OptimiseAnswer:
    sweeps = outcome.rotation_sweeps + outcome.pose_sweeps
    return OptimiseAnswer(outcome.accepted, outcome.cost_before, outcome.cost_after, sweeps)
