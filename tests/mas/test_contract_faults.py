"""The contract net's promises among several agents, whatever is lost, doubled or overtaken on the way."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from hypothesis import given, settings
from hypothesis import strategies as st

from maslam.mas.contracts.contract import Contract, ContractState
from maslam.mas.contracts.ledger import Ledger, OwnMistake, at_once
from maslam.mas.errors import ProtocolError
from maslam.mas.protocol.ids import ContractId, OperationKind
from maslam.mas.protocol.messages import (
    Award,
    Bid,
    Call,
    Cancel,
    Confirmation,
    ContractBody,
    Failure,
    Refusal,
    Rejection,
    Result,
)
from maslam.mas.protocol.tasks import MapOrder, PlaceAnswer

WORDS: dict[str, ContractBody] = {
    "bid": Bid(1, 0),
    "refuse": Refusal("no"),
    "award": Award(MapOrder((1,))),
    "reject": Rejection("no"),
    "confirm": Confirmation(),
    "result": Result(PlaceAnswer(None, 2.0)),
    "fail": Failure("no"),
    "cancel": Cancel("no"),
}
PATIENCE_NS = 20
OPERATIONS = [OperationKind.DVPR, OperationKind.DOPT]
agents = st.integers(0, 3)
actions = st.one_of(
    st.tuples(st.just("call"), agents, st.integers(1, 15), st.sampled_from(OPERATIONS)),
    st.tuples(st.just("say"), agents, st.integers(0, 40), st.sampled_from(sorted(WORDS))),
    # Two messages arrive for each that is lost; what was delivered may stay on the way and come again.
    st.tuples(st.sampled_from(["deliver", "deliver", "again", "lose"]), agents, st.integers(0, 40), st.none()),
    st.tuples(st.just("wait"), agents, st.integers(1, 8), st.none()),
)


@dataclass
class World:
    """Ledgers, messages on the way, and a diary of everything said and heard: ``(agent, key, word)``."""

    count: int
    now_ns: int = 0
    air: list[tuple[int, int, ContractId, ContractBody]] = field(default_factory=list)
    said: set[tuple[int, ContractId, int, type]] = field(default_factory=set)
    heard: set[tuple[int, ContractId, int, type]] = field(default_factory=set)
    ends: dict[tuple[int, ContractId, int], ContractState] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.ledgers = [Ledger(a) for a in range(self.count)]

    def act(self, kind: str, agent: int, number: int, what: object) -> None:
        agent %= self.count
        if kind == "call" and isinstance(what, OperationKind):
            self.call(agent, number, what)
        elif kind == "say":
            self.say(agent, number, WORDS[str(what)])
        elif kind == "wait":
            self.now_ns += number
            for ledger in self.ledgers:
                self.note(ledger.me, ledger.expired(self.now_ns))
        elif self.air:
            at = number % len(self.air)
            message = self.air[at] if kind == "again" else self.air.pop(at)
            if kind != "lose":
                self.deliver(*message)

    def call(self, manager: int, mask: int, operation: OperationKind) -> None:
        others = [a for a in range(self.count) if mask >> a & 1]
        call = Call(operation, self.now_ns + PATIENCE_NS)
        identity, called = self.ledgers[manager].call(operation, others, call.deadline_ns)
        self.air += [(manager, other, identity, call) for other in called]

    def say(self, agent: int, number: int, body: ContractBody) -> None:
        running = self.ledgers[agent].running()
        if not running:
            return
        contract = running[number % len(running)]
        try:
            after = self.ledgers[agent].send(contract, body)
        except OwnMistake:
            return
        other = contract.contractor if contract.manager == agent else contract.manager
        self.said.add((agent, contract.id, contract.contractor, type(body)))
        self.air.append((agent, other, contract.id, body))
        self.note(agent, [after])

    def deliver(self, sender: int, recipient: int, identity: ContractId, body: ContractBody) -> None:
        ledger = self.ledgers[recipient]
        contractor = recipient if identity.manager == sender else sender
        try:
            if isinstance(body, Call):
                self.note(recipient, list(ledger.called(sender, identity, body).superseded))
            else:
                self.note(recipient, [ledger.receive(identity, sender, body)])
        except ProtocolError:
            return
        self.heard.add((recipient, identity, contractor, type(body)))

    def note(self, agent: int, contracts: list[Contract]) -> None:
        for contract in contracts:
            if contract.ended:
                key = (agent, contract.id, contract.contractor)
                assert key not in self.ends, "a contract ended twice"
                self.ends[key] = contract.state

    def check(self) -> None:
        for ledger in self.ledgers:
            running = ledger.running()
            kinds = Counter((c.manager, c.contractor, c.operation) for c in running)
            many = [kind for kind, count in kinds.items() if count > at_once(kind[2])]
            assert not many, "more contracts of a kind for a pair than may run"
            assert not any((ledger.me, c.id, c.contractor) in self.ends for c in running), "an ended contract runs"
        for agent, identity, contractor, word in self.said:
            theirs = {w for a, i, c, w in self.heard if (a, i, c) == (agent, identity, contractor)}
            own = {w for a, i, c, w in self.said if (a, i, c) == (agent, identity, contractor)}
            if word is Award:
                assert Bid in theirs, "an award without a bid"
            if word in (Confirmation, Failure):
                assert Award in theirs, "work without an award"
            if word is Result:
                assert Confirmation in own, "a result without commitment"
            if word is Bid:
                assert agent == contractor and Call in theirs, "a bid without a call"


@given(st.integers(2, 4), st.lists(actions, max_size=60))
@settings(max_examples=300, deadline=None)
def test_promises_hold_whatever_happens_to_messages(count: int, played: list) -> None:  # type: ignore[type-arg]
    world = World(count)
    for action in played:
        world.act(*action)
        world.check()
    world.act("wait", 0, PATIENCE_NS + 1, None)
    assert not any(ledger.running() for ledger in world.ledgers), "a contract did not end"
    for (agent, identity, contractor), state in world.ends.items():
        if agent == identity.manager and state is ContractState.DONE:
            assert world.ends[contractor, identity, contractor] is ContractState.DONE, "done, but not by the contractor"


def test_the_promises_are_put_to_the_test() -> None:
    """The world above can play a whole contract, doubled and out of order: the property is not empty."""
    world = World(2)
    world.act("call", 0, 2, OperationKind.DVPR)
    world.act("again", 0, 0, None)
    world.act("deliver", 0, 0, None)
    for agent, word in ((1, "bid"), (0, "award"), (1, "confirm"), (1, "result")):
        world.act("say", agent, 0, word)
        if word in ("bid", "award"):
            world.act("again", 0, 0, None)
            world.act("deliver", 0, 0, None)
    world.act("deliver", 0, 1, None)
    world.act("deliver", 0, 0, None)
    world.check()
    assert set(world.ends.values()) == {ContractState.DONE} and len(world.ends) == 2
