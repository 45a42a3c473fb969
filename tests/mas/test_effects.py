"""What follows from a message is returned; wrong results fail; errors of this program are nobody's fault."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from by_hand import handled, logged, sent, ticked
from factory import town
from garbler import Garbler
from hypothesis import given, settings
from hypothesis import strategies as st
from sample_messages import examples

import maslam.mas
from maslam.backend.errors import BackendError
from maslam.mas.agent import Agent
from maslam.mas.contracts.contract import Contract, ContractState
from maslam.mas.contracts.reputation import SILENT, Trust, TrustChange
from maslam.mas.policies.presets import policy_of, preset
from maslam.mas.protocol.ids import ContractId, OperationKind
from maslam.mas.protocol.messages import (
    Award,
    Bid,
    Call,
    Confirmation,
    ContractBody,
    Failure,
    MapNotice,
    Message,
    Result,
)
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.protocol.tasks import OptimiseAnswer, PlaceAnswer, PlaceQuery
from maslam.mas.protocol.tensors import MessageError
from maslam.mas.simulation import Environment, make_agents, make_transport
from maslam.mas.state.keyframe import keyframes_of


def pair() -> list[Agent]:
    """Two agents that have each seen the same six places, and said nothing."""
    manifest, sequences = town(2, 6, spacing_m=0.0)
    agents = make_agents(manifest, sequences, preset("default"))
    for agent, sequence in zip(agents, sequences, strict=True):
        for keyframe in keyframes_of(sequence):
            agent.observe(keyframe)
    return agents


def awarded() -> tuple[list[Agent], Message]:
    """Agent 0's first place query on its way to agent 1, everything before it delivered."""
    agents = pair()
    mail = ticked(agents[0], 0)
    while not isinstance(mail[0].body, Award):
        mail += handled(agents, mail.pop(0))
    return agents, mail[0]


def back(award: Message, body: ContractBody) -> Message:
    return Message(award.recipient, award.sender, award.contract, body)


def reputation_after(body: ContractBody) -> float:
    """What agent 0 thinks of agent 1's reliability once it was answered with this."""
    agents, award = awarded()
    handled(agents, back(award, Confirmation()))
    handled(agents, back(award, body))
    return agents[0].context.reputation.of(1).reliability


# -- a result is validated before its contract goes on ----------------------------------------------------------------


def test_a_result_of_another_operation_ends_the_contract_as_failed_and_costs_its_sender() -> None:
    agents, award = awarded()
    handled(agents, back(award, Confirmation()))
    candidates = dict(agents[0].candidates.by_id)
    handled(agents, back(award, Result(OptimiseAnswer(True, 2.0, 1.0, 3))))
    (end,) = logged(agents[0], "contract")
    assert (end["end"], end["reason"]) == ("failed", "OptimiseAnswer is no result of dvpr")
    assert [e["reason"] for e in logged(agents[0], "refused")] == ["OptimiseAnswer is no result of dvpr"]
    assert agents[0].candidates.by_id == candidates
    record = agents[0].context.reputation.of(1)
    assert (record.delivered, record.failed) == (0, 1)
    assert not [c for c in agents[0].context.ledger.running() if c.id == award.contract]


def test_a_wrong_result_costs_more_than_to_say_that_one_cannot() -> None:
    good = reputation_after(Result(PlaceAnswer(0, 0.5)))
    honest = reputation_after(Failure("no such thing here"))
    wrong = reputation_after(Result(OptimiseAnswer(True, 2.0, 1.0, 3)))
    assert wrong < honest < good


def test_a_task_of_another_operation_is_answered_by_a_failure() -> None:
    agents = pair()
    contract = ContractId(0, 0)
    sent(agents[1], agents[1].handle(Message(0, 1, contract, Call(OperationKind.RELPOSE, 10**9))))
    effects = agents[1].handle(Message(0, 1, contract, Award(PlaceQuery(0, 7, b"1"))))
    assert [m.body for m in effects.messages] == [Failure("PlaceQuery is no task of relpose")]


def test_a_repeated_wrong_result_is_counted_once() -> None:
    agents, award = awarded()
    handled(agents, back(award, Confirmation()))
    for _ in range(3):
        handled(agents, back(award, Result(OptimiseAnswer(True, 2.0, 1.0, 3))))
    assert agents[0].context.reputation.of(1).failed == 1
    assert len(logged(agents[0], "refused")) == 1


# -- an error of this program is nobody's fault -----------------------------------------------------------------------


@pytest.mark.parametrize("error", [KeyError, IndexError, AttributeError, ValueError, ZeroDivisionError, BackendError])
def test_a_programming_error_in_taking_a_result_escapes(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    agents, award = awarded()
    handled(agents, back(award, Confirmation()))

    def broken(*_: object) -> None:
        raise error("a mistake of ours")

    monkeypatch.setattr(agents[0].places, "on_result", broken)
    with pytest.raises(error, match="a mistake of ours"):
        agents[0].handle(back(award, Result(PlaceAnswer(0, 0.1))))
    assert not logged(agents[0], "refused")


@pytest.mark.parametrize("error", [KeyError, IndexError, AttributeError, ValueError, ZeroDivisionError])
def test_a_programming_error_at_work_escapes_and_is_no_failure(
    error: type[Exception], monkeypatch: pytest.MonkeyPatch
) -> None:
    agents, award = awarded()

    def broken(*_: object) -> None:
        raise error("a mistake of ours")

    monkeypatch.setattr(agents[1].candidates, "nearest_to_decoded", broken)
    with pytest.raises(error, match="a mistake of ours"):
        agents[1].handle(award)


def test_a_programming_error_in_a_check_is_no_bad_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """msgspec takes a ValueError of a check for bad data; so does nobody here."""
    from maslam.mas.protocol import tasks
    from maslam.mas.protocol.messages import decode, encode

    raw = encode(next(m for m in examples() if isinstance(m.body, Award) and m.body.kind == "VerifyTask"))

    def broken(*_: object) -> None:
        raise ValueError("operands could not be broadcast together")

    monkeypatch.setattr(tasks, "check_poses", broken)
    with pytest.raises(ValueError, match="operands") as caught:
        decode(raw, 2**20)
    assert not isinstance(caught.value, MessageError)


@given(st.permutations(range(len(examples()))), st.integers(0, 2))
@settings(max_examples=40, deadline=None)
def test_messages_of_all_kinds_in_any_order_are_acted_on_or_refused(order: list[int], stage: int) -> None:
    """Whatever well-formed messages a peer sends: nothing but typed errors, which handle() catches, is raised."""
    agents, award = awarded()
    assert award.contract is not None
    identity = (award.contract, ContractId(1, 0), ContractId(1, 1))[stage]
    for number in order:
        body = examples()[number].body
        contract = None if examples()[number].contract is None else identity
        sent(agents[0], agents[0].handle(Message(1, 0, contract, body)))


@pytest.mark.parametrize(("name", "seed"), [("maslam", 5), ("default", 1), ("optimised", 17), ("selection", 3)])
def test_a_peer_that_talks_nonsense_in_good_form_breaks_nobody(name: str, seed: int) -> None:
    """Seeds that each brought down an agent once: a stranger in a group, NaN poses, an endless depth, other sums."""

    class Odd(Garbler):
        SEED = seed

    manifest, sequences = town(3, 14, spacing_m=5.0, drifting=0.03)
    config = preset(name)
    agents = make_agents(manifest, sequences, config)
    agents[seed % 3] = Odd(agents[seed % 3].state.profile, config, policy_of(config, seed % 3))
    transport = make_transport(config, lambda sent: None)
    environment = Environment(agents, [keyframes_of(s) for s in sequences], transport, config)
    for step in range(environment.steps + 30):
        environment.step(step)
    odd = environment.agents[seed % 3]
    assert isinstance(odd, Odd) and odd.garbled > 20
    for agent in environment.agents:
        assert np.isfinite(agent.state.poses).all()


def test_a_bid_that_contradicts_itself_does_not_reach_the_plan() -> None:
    bids = [m.body for m in examples() if isinstance(m.body, Bid) and m.body.links is not None]
    assert bids
    for bid in bids:
        with pytest.raises(MessageError):
            Bid(bid.cost_bytes, bid.ready_ns, bid.links, ())


def test_solver_bytes_are_checked_when_they_come_in() -> None:
    good = next(m.body for m in examples() if isinstance(m.body, SolverBody))
    for cut in range(len(good.data)):
        try:
            SolverBody(good.data[:cut])
        except MessageError:
            continue


# -- nothing is left for others to take -------------------------------------------------------------------------------

MUTATORS = {"append", "appendleft", "extend", "insert", "clear", "pop", "popleft", "remove", "add", "discard", "update"}
MUTATORS |= {"setdefault", "difference_update", "intersection_update", "sort"}


def mutable_attributes(agent: Agent) -> set[str]:
    """Names of the lists, sets and dictionaries that the parts of an agent show."""
    final, context = agent.final_round, agent.context
    parts = [
        agent.places,
        agent.places.verification,
        agent.optimisation,
        agent.maps,
        agent.candidates,
        agent.pending,
        final,
    ]
    parts += [context, context.ledger, context.retransmitter, context.reputation, agent.call_queue]
    shown = [(name, value) for part in parts for name, value in vars(part).items() if not name.startswith("_")]
    return {name for name, value in shown if hasattr(value, "clear") or isinstance(value, bool)}


def changes_from_outside(tree: ast.AST, names: set[str]) -> Iterator[int]:
    """Lines where an attribute of these names is changed through anything but ``self``."""

    def foreign(node: ast.expr) -> bool:
        while isinstance(node, ast.Subscript):
            node = node.value
        named = isinstance(node, ast.Attribute) and node.attr in names
        return named and not (isinstance(node.value, ast.Name) and node.value.id == "self")  # type: ignore[union-attr]

    for node in ast.walk(tree):
        if isinstance(node, ast.Assign | ast.Delete):
            targets = node.targets
        elif isinstance(node, ast.AugAssign | ast.AnnAssign):
            targets = [node.target]
        else:
            targets = []
        for target in targets:
            if any(foreign(t) for t in (target.elts if isinstance(target, ast.Tuple) else [target])):
                yield node.lineno  # type: ignore[attr-defined]
        called = node.func if isinstance(node, ast.Call) else None
        if isinstance(called, ast.Attribute) and called.attr in MUTATORS and foreign(called.value):
            yield called.lineno


def test_what_a_part_of_an_agent_shows_is_changed_by_that_part_alone() -> None:
    names = mutable_attributes(pair()[0])
    assert {"copies", "stale", "last_bought", "distances", "by_id"} <= names, "the test looks at what it should"
    folder = Path(maslam.mas.__file__).parent
    found = []
    for path in sorted(folder.rglob("*.py")):
        lines = changes_from_outside(ast.parse(path.read_text(encoding="utf-8")), names)
        found += [f"{path.relative_to(folder)}:{line}" for line in lines]
    assert found == []


def drains(tree: ast.AST) -> Iterator[int]:
    """Lines that take what an attribute has gathered and leave it empty: ``out, a.b = a.b, []``, or a local of it that
    is emptied in the same function (``out = list(a.b)`` and ``a.b.clear()``)."""

    def empty(value: ast.expr) -> bool:
        none = isinstance(value, ast.List | ast.Set | ast.Tuple) and not value.elts
        made = (
            isinstance(value, ast.Call)
            and not value.args
            and ast.unparse(value.func) in ("set", "list", "dict", "deque")
        )
        return none or made or (isinstance(value, ast.Dict) and not value.keys)

    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Assign)
            and isinstance(node.targets[0], ast.Tuple)
            and isinstance(node.value, ast.Tuple)
        ):
            taken = {ast.unparse(v) for v in node.value.elts}
            for target, value in zip(node.targets[0].elts, node.value.elts, strict=False):
                if isinstance(target, ast.Attribute) and empty(value) and ast.unparse(target) in taken:
                    yield node.lineno
        if isinstance(node, ast.FunctionDef):
            called = [n for n in ast.walk(node) if isinstance(n, ast.Call) and isinstance(n.func, ast.Attribute)]
            emptied = {ast.unparse(n.func.value): n.lineno for n in called if n.func.attr == "clear"}  # type: ignore[attr-defined]
            read = {
                ast.unparse(a)
                for n in ast.walk(node)
                if isinstance(n, ast.Call) and ast.unparse(n.func) in ("list", "tuple", "set", "sorted")
                for a in n.args
            }
            yield from (line for attribute, line in emptied.items() if attribute in read)


def test_nothing_gathers_what_others_drain() -> None:
    folder = Path(maslam.mas.__file__).parent
    found = []
    for path in sorted(folder.rglob("*.py")):
        lines = drains(ast.parse(path.read_text(encoding="utf-8")))
        found += [f"{path.relative_to(folder)}:{line}" for line in lines]
    assert found == []


def test_the_rule_about_drains_sees_them() -> None:
    source = """
def changes(self):
    touched, self._touched = self._touched, set()
    early, session.early = session.early, []
    given_up, self.tender = self.tender, None
def other(self):
    out = sorted(self.changed)
    self.changed.clear()
    self.unrelated.clear()
"""
    assert sorted(drains(ast.parse(source))) == [3, 4, 8]


def test_trust_that_changes_is_logged_by_the_message_that_changes_it() -> None:
    """An agent that was silent sends anything: its return is an effect of that message."""
    agents = pair()
    context = agents[0].context
    silent = replace(
        Contract(ContractId(0, 0), 1, OperationKind.DVPR, 10), state=ContractState.CANCELLED, reason=SILENT
    )
    for _ in range(2):
        effects = context.close_account(silent, silent.contractor)
    assert [c.trust for c in effects.changes if isinstance(c, TrustChange)] == [Trust.SILENT]
    back = agents[0].handle(Message(1, 0, None, MapNotice(())))
    assert [(e.kind, e.fields["of"], e.fields["trust"]) for e in back.events] == [("reputation", 1, "good")]
    assert not any(e.kind == "reputation" for e in agents[0].handle(Message(1, 0, None, MapNotice(()))).events)


def test_the_rule_about_changes_from_outside_sees_them() -> None:
    drained = "out, self.desk.held = self.desk.held, []\nself.maps.held.clear()\nself.maps.held[3] = 1\nself.held = 2"
    assert sorted(changes_from_outside(ast.parse(drained), {"held"})) == [1, 2, 3]
