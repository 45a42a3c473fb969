"""The contract net's promises, whatever anyone says in whatever order."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from maslam.mas.contracts.contract import (
    CONTRACTOR_SENDS,
    ENDED,
    MANAGER_SENDS,
    RESULT_CONFIRMS,
    Contract,
    ContractState,
    LateMessage,
    ProtocolError,
    Repeated,
    advance,
    expire,
)
from maslam.mas.contracts.ledger import Ledger, at_once
from maslam.mas.protocol.ids import ContractId, OperationKind
from maslam.mas.protocol.messages import Award, Bid, Call, Cancel, Confirmation, Failure, Refusal, Rejection, Result
from maslam.mas.protocol.tasks import MapOrder, PlaceAnswer

MANAGER, CONTRACTOR, STRANGER = 3, 5, 8
BODIES = [
    Bid(1, 0),
    Refusal("no"),
    Award(MapOrder((1,))),
    Rejection("no"),
    Confirmation(),
    Result(PlaceAnswer(None, 2.0)),
    Failure("no"),
    Cancel("no"),
]
sayings = st.lists(st.tuples(st.sampled_from([MANAGER, CONTRACTOR, STRANGER]), st.sampled_from(BODIES)), max_size=25)


def opened() -> Contract:
    return Contract(ContractId(MANAGER, 0), CONTRACTOR, OperationKind.DVPR, deadline_ns=100)


@given(sayings)
def test_no_award_without_a_bid_no_work_without_an_award(said: list) -> None:  # type: ignore[type-arg]
    contract = opened()
    heard: list[tuple[int, type]] = []
    for sender, body in said:
        try:
            after = advance(contract, sender, body)
        except ProtocolError:
            continue
        assert not contract.ended, "an ended contract went on"
        assert sender in (MANAGER, CONTRACTOR)
        kinds = [kind for _, kind in heard]
        if isinstance(body, Award):
            assert sender == MANAGER and Bid in kinds
        if isinstance(body, Confirmation):
            assert sender == CONTRACTOR and Award in kinds
        if isinstance(body, Result):
            assert sender == CONTRACTOR and Confirmation in kinds
        assert (sender, type(body)) not in heard, "something was said twice"
        heard.append((sender, type(body)))
        contract = after


@given(sayings)
def test_every_contract_ends(said: list) -> None:  # type: ignore[type-arg]
    contract = opened()
    for sender, body in said:
        try:
            contract = advance(contract, sender, body)
        except ProtocolError:
            continue
    assert expire(contract, now_ns=100) == contract, "the deadline itself is still in time"
    assert expire(contract, now_ns=101).ended


def test_every_state_can_be_reached_and_left_by_the_table() -> None:
    table = {**CONTRACTOR_SENDS, **MANAGER_SENDS}
    reached = {ContractState.CALLED, ContractState.EXPIRED, *table.values()}
    assert reached == set(ContractState)
    assert {state for state, _ in table} == set(ContractState) - ENDED


def test_both_sides_keep_the_same_state() -> None:
    manager, contractor = Ledger(MANAGER), Ledger(CONTRACTOR)
    identity, called = manager.call(OperationKind.MAPMERGE, [CONTRACTOR], deadline_ns=10)
    assert called == [CONTRACTOR]
    contractor.called(MANAGER, identity, Call(OperationKind.MAPMERGE, 10))
    steps = [(CONTRACTOR, BODIES[0]), (MANAGER, BODIES[2]), (CONTRACTOR, BODIES[4]), (CONTRACTOR, BODIES[5])]
    for sender, body in steps:
        speaker, listener = (manager, contractor) if sender == MANAGER else (contractor, manager)
        said = speaker.send(speaker.get(identity, CONTRACTOR), body)
        states = {said.state, listener.receive(identity, sender, body).state}
        assert len(states) == 1
    assert states == {ContractState.DONE}
    assert not manager.running() and not contractor.running()


def test_at_most_one_contract_of_a_kind_a_pair() -> None:
    ledger = Ledger(MANAGER)
    ledger.call(OperationKind.RELPOSE, [1, 2], 10)
    assert ledger.call(OperationKind.RELPOSE, [1, 2, 4], 10)[1] == [4]
    assert ledger.call(OperationKind.DOPT, [1, 2], 10)[1] == [1, 2]


def test_questions_about_places_are_a_few_at_once_in_any_order() -> None:
    """They do not depend on each other's answers; the contractor's side is bounded whatever its manager does."""
    manager, contractor, most = Ledger(MANAGER), Ledger(CONTRACTOR), at_once(OperationKind.DVPR)
    calls = [manager.call(OperationKind.DVPR, [CONTRACTOR], 10) for _ in range(most + 1)]
    assert [free for _, free in calls] == [[CONTRACTOR]] * most + [[]]
    for identity, _ in reversed(calls[:most]):
        assert contractor.called(MANAGER, identity, Call(OperationKind.DVPR, 10)).superseded == ()
    taken = contractor.called(MANAGER, ContractId(MANAGER, 99), Call(OperationKind.DVPR, 10))
    assert [c.id for c in taken.superseded] == [calls[0][0]]
    assert len(contractor.running()) == most


def test_a_call_that_comes_twice_is_refused() -> None:
    ledger = Ledger(CONTRACTOR)
    call = Call(OperationKind.RELPOSE, 10)
    ledger.called(MANAGER, ContractId(MANAGER, 4), call)
    with pytest.raises(Repeated, match="twice"):
        ledger.called(MANAGER, ContractId(MANAGER, 4), call)
    with pytest.raises(LateMessage, match="too late"):
        ledger.called(MANAGER, ContractId(MANAGER, 3), call)
    assert [c.id.number for c in ledger.running()] == [4]


def test_a_newer_call_ends_the_contractors_copy_of_an_older_one() -> None:
    """The manager calls anew only after its own copy has ended: that end was lost on the way."""
    ledger = Ledger(CONTRACTOR)
    over = []
    for number, operation in ((0, OperationKind.RELPOSE), (1, OperationKind.DOPT), (2, OperationKind.RELPOSE)):
        over += ledger.called(MANAGER, ContractId(MANAGER, number), Call(operation, 10)).superseded
    assert [c.id.number for c in ledger.running()] == [1, 2]
    assert [(c.id.number, c.state) for c in over] == [(0, ContractState.CANCELLED)]


def test_a_call_that_its_withdrawal_overtook_opens_nothing() -> None:
    ledger = Ledger(CONTRACTOR)
    with pytest.raises(LateMessage):
        ledger.receive(ContractId(MANAGER, 0), MANAGER, Cancel("no longer wanted"))
    with pytest.raises(LateMessage):
        ledger.called(MANAGER, ContractId(MANAGER, 0), Call(OperationKind.DVPR, 10))
    assert ledger.running() == []


def test_a_result_confirms_too_but_nobody_may_leave_the_confirmation_out() -> None:
    awarded = opened()
    for sender, body in ((CONTRACTOR, BODIES[0]), (MANAGER, BODIES[2])):
        awarded = advance(awarded, sender, body)
    result = Result(PlaceAnswer(None, 2.0))
    assert advance(awarded, CONTRACTOR, result, received=True).state is ContractState.DONE
    with pytest.raises(ProtocolError):
        advance(awarded, CONTRACTOR, result)
    assert set(RESULT_CONFIRMS) == {(ContractState.AWARDED, Result)}


def test_a_word_that_came_twice_is_told_from_one_out_of_place() -> None:
    bid = advance(opened(), CONTRACTOR, BODIES[0])
    with pytest.raises(Repeated):
        advance(bid, CONTRACTOR, BODIES[0])
    with pytest.raises(ProtocolError) as wrong:
        advance(bid, CONTRACTOR, Confirmation())
    assert not isinstance(wrong.value, LateMessage)


def test_nobody_calls_in_another_name() -> None:
    with pytest.raises(ProtocolError, match="in the name"):
        Ledger(CONTRACTOR).called(STRANGER, ContractId(MANAGER, 0), Call(OperationKind.DVPR, 10))


def test_a_late_message_is_told_from_a_wrong_one() -> None:
    ledger = Ledger(MANAGER)
    identity, _ = ledger.call(OperationKind.DVPR, [CONTRACTOR], deadline_ns=10)
    assert [c.state for c in ledger.expired(11)] == [ContractState.EXPIRED]
    with pytest.raises(LateMessage):
        ledger.get(identity, CONTRACTOR)
    with pytest.raises(ProtocolError, match="no running contract"):
        ledger.get(ContractId(MANAGER, 99), CONTRACTOR)
