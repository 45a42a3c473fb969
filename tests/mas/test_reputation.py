"""What agents think of each other, and what bids are worth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from factory import talkative, town
from hypothesis import given
from hypothesis import strategies as st
from saboteurs import live

from maslam.mas.config import FaultsConfig, ReputationConfig
from maslam.mas.contracts.contract import Contract, ContractState
from maslam.mas.contracts.reputation import SILENT, ReputationBook, Trust
from maslam.mas.contracts.retries import RetryBudget
from maslam.mas.policies.utility import orders, utility
from maslam.mas.protocol.ids import ContractId, OperationKind
from maslam.mas.protocol.messages import Award, Bid, Confirmation, Message, Offer, Result
from maslam.mas.protocol.solver_messages import SolverBody
from maslam.mas.state.match_audit import judged

CONFIG = ReputationConfig()
SECOND = 1_000_000_000
CALL = Contract(ContractId(0, 0), 1, OperationKind.DVPR, 10)


def ended(
    state: ContractState, *said: type, reason: str = "", operation: OperationKind = OperationKind.DVPR
) -> Contract:
    return replace(CALL, state=state, exchanged=frozenset(said), reason=reason, operation=operation)


DONE = ended(ContractState.DONE, Bid, Award, Confirmation, Result)
NOT_DELIVERED = ended(ContractState.EXPIRED, Bid, Award, Confirmation)
UNHEARD = ended(ContractState.CANCELLED, reason=SILENT)


def reputation_after(*contracts: Contract) -> ReputationBook:
    reputation = ReputationBook(CONFIG)
    for contract in contracts:
        reputation.ended(contract, 0)
    return reputation


def test_standing_is_the_mean_of_what_was_seen() -> None:
    """By hand: prior (1, 0.25); one delivery, then one failure to deliver, older ones at 0.95."""
    record = reputation_after(DONE, NOT_DELIVERED).of(1)
    assert record.reliability == pytest.approx((0.95 + 1) / (0.95 + 1 + 1.25))
    record.t, record.f = 4, 2
    assert record.consistency == pytest.approx((4 + 3) / (4 + 2 + 3.5))
    assert record.value == pytest.approx(record.reliability * record.consistency)


def test_a_few_losses_ruin_nobody_and_nothing_delivered_does() -> None:
    good = reputation_after(*[DONE] * 10, NOT_DELIVERED, DONE, NOT_DELIVERED)
    assert good.trust(1) is Trust.GOOD
    idle = reputation_after(*[NOT_DELIVERED] * 3)
    assert idle.trust(1) is Trust.UNDELIVERING


def test_what_a_manager_did_itself_is_held_against_nobody() -> None:
    """Given way, rejected, refused, never awarded: no change."""
    mine = [
        ended(ContractState.CANCELLED, Bid, reason="gives way to a lower number"),
        ended(ContractState.REJECTED, Bid),
        ended(ContractState.REFUSED),
        ended(ContractState.EXPIRED, Bid),
    ]
    assert reputation_after(*mine * 5).of(1).value == ReputationBook(CONFIG).of(1).value


def test_who_vanished_is_probed_now_and_then_and_welcome_when_it_comes_back() -> None:
    reputation = ReputationBook(CONFIG)
    assert reputation.ended(UNHEARD, 0) == ()
    assert [(c.other, c.trust) for c in reputation.ended(UNHEARD, 0)] == [(1, Trust.SILENT)]
    assert reputation.trust(1) is Trust.SILENT
    probes = []
    for now_s in range(45):
        if reputation.may_call(1, now_s * SECOND):
            reputation.called(1, now_s * SECOND)
            probes.append(now_s)
    assert probes == [10, 20, 30, 40]
    assert [(c.other, c.trust) for c in reputation.received(1, 45 * SECOND)] == [(1, Trust.GOOD)]
    assert reputation.received(1, 45 * SECOND) == (), "a change is told once, by what makes it"
    assert reputation.trust(1) is Trust.GOOD and reputation.may_call(1, 45 * SECOND)


def test_one_silence_is_bad_luck() -> None:
    reputation = reputation_after(UNHEARD)
    reputation.received(1, 0)
    reputation.ended(UNHEARD, 0)
    assert reputation.trust(1) is Trust.GOOD


def test_who_is_contradicted_more_than_borne_out_is_not_trusted_until_that_changes() -> None:
    reputation = ReputationBook(CONFIG)
    for borne_out, contradicted, trusted in ((0, 3, True), (0, 4, False), (10, 4, True), (2, 6, False)):
        before = reputation.trust(1)
        changes = reputation.judged(1, borne_out, contradicted, 0)
        assert [c.trust for c in changes] == ([] if reputation.trust(1) is before else [reputation.trust(1)])
        assert (reputation.trust(1) is not Trust.UNTRUSTED) is trusted


@given(st.lists(st.sampled_from([DONE, NOT_DELIVERED, UNHEARD, ended(ContractState.FAILED, Bid, Award)]), max_size=60))
def test_standing_stays_between_nought_and_one(contracts: list[Contract]) -> None:
    record = reputation_after(*contracts).of(1)
    assert 0.0 < record.value <= 1.0
    before = record.reliability
    more = reputation_after(*contracts, DONE)
    assert more.of(1).reliability >= before, "a delivery never harms"


def test_work_is_called_for_again_so_often_and_not_when_it_was_not_wanted() -> None:
    again = RetryBudget(2)
    assert [again.wanted(NOT_DELIVERED, 5) for _ in range(4)] == [True, True, False, True]
    assert not again.wanted(DONE, 6) and not again.wanted(ended(ContractState.REJECTED, Bid), 6)
    assert not again.wanted(ended(ContractState.CANCELLED, Bid, reason="gives way to a lower number"), 6)
    assert again.wanted(UNHEARD, 6)


# -- bids -------------------------------------------------------------------------------------------------------------


def test_utility_is_benefit_a_byte_by_standing_and_nothing_when_late() -> None:
    bid = Bid(cost_bytes=200, ready_ns=5)
    assert utility(0.5, 40.0, bid, deadline_ns=5) == pytest.approx(0.1)
    assert utility(0.5, 40.0, bid, deadline_ns=4) == 0.0
    assert utility(1.0, 40.0, bid, 5) > utility(0.5, 40.0, bid, 5) > utility(0.5, 20.0, bid, 5)


def offer(*rows: tuple[int, int, int], cost: int = 1000) -> Bid:
    return Bid(cost, 0, offers=tuple(Offer(*row) for row in rows))


def newer_than(held: dict[int, int], me: int = 0) -> Callable[[int, Offer], bool]:
    return lambda seller, offer: offer.owner != me and held.get(offer.owner, -1) < offer.version


def test_each_map_is_bought_once_from_its_owner_or_the_newest_from_the_best() -> None:
    bids = {1: offer((1, 9, 10), (3, 4, 5)), 2: offer((2, 3, 10), (3, 6, 6)), 4: offer((3, 6, 6), (0, 8, 8))}
    even = {1: 0.8, 2: 0.8, 3: 0.8, 4: 0.8}
    assert orders(bids, even, newer_than({}), 10) == {1: (1,), 2: (2, 3)}
    poor = {**even, 2: 0.1}
    assert orders(bids, poor, newer_than({}), 10) == {1: (1,), 2: (2,), 4: (3,)}, "a bad name costs the sale"
    assert orders(bids, even, newer_than({1: 9, 2: 3, 3: 6}), 10) == {}, "nothing new, and never the own map"
    owner = {**bids, 3: offer((3, 5, 4))}
    assert orders(owner, even, newer_than({}), 10)[3] == (3,), "the owner, though others have later copies"
    assert 3 not in orders(owner, {**even, 3: 0.0}, newer_than({}), 10), "but not one that never delivers"


def test_bids_state_what_results_take_on_the_air() -> None:
    """Every result's true wire bytes against what its bid had stated."""
    bid_for: dict[tuple[ContractId, int], tuple[int, int]] = {}
    solver: dict[tuple[ContractId, int], int] = {}
    ratios: dict[OperationKind, list[float]] = {o: [] for o in OperationKind}

    def listen(message: Message, wire_bytes: int) -> None:
        assert message.contract is not None or not isinstance(message.body, Bid | Result)
        if isinstance(message.body, Bid) and message.contract is not None:
            bid_for[message.contract, message.sender] = (message.body.cost_bytes, message.body.ready_ns)
        elif isinstance(message.body, SolverBody) and message.contract is not None:
            key = (message.contract, message.sender)
            solver[key] = solver.get(key, 0) + wire_bytes
        elif isinstance(message.body, Result) and message.contract is not None:
            stated, ready_ns = bid_for[message.contract, message.sender]
            kind = {"PlaceAnswer": 0, "VerifyAnswer": 1, "OptimiseAnswer": 2, "MapDelivery": 3}
            operation = OperationKind(kind[type(message.body.outcome).__name__])
            ratios[operation].append(wire_bytes / stated)
            assert ready_ns <= 20 * SECOND

    manifest, sequences = town(3, 24, spacing_m=9.0, drifting=0.03)
    config = talkative()
    solved_anew = config.optimisation.model_copy(update={"updates": False})
    live(manifest, sequences, config.model_copy(update={"optimisation": solved_anew}), listen=listen)
    for operation in (OperationKind.DVPR, OperationKind.RELPOSE):
        assert ratios[operation] and min(ratios[operation]) > 0.7 and max(ratios[operation]) < 1.4
    # A bid offers all that the seller has; the buyer orders what is new.
    assert ratios[OperationKind.MAPMERGE] and max(ratios[OperationKind.MAPMERGE]) < 1.3
    assert max(ratios[OperationKind.MAPMERGE]) > 0.7, "who buys all pays about what was stated"
    # What an optimisation costs depends on how fast it converges: learned from the last one.
    paid: dict[int, list[float]] = {}
    for key, bytes_ in sorted(solver.items()):
        if key in bid_for:
            paid.setdefault(key[1], []).append(bytes_ / bid_for[key][0])
    later = [ratio for ratios_of_one in paid.values() for ratio in ratios_of_one[1:]]
    assert len(later) >= 4 and min(later) > 1 / 3 and max(later) < 3


def test_a_claim_of_ones_own_is_believed_before_one_that_only_the_other_makes() -> None:
    """Three agreeing lies against two agreeing matches that the agent verified itself."""
    from test_map_exchange import agents_in_a_row

    agent = agents_in_a_row()[1]
    state = agent.state
    own = [m for m in state.verified if m.match_agent == state.me and 2 in m.agents]
    assert len(own) == 2 and set(own) <= state.accepted
    true = state.verified[own[0]]
    lies = [lie_about(true, k) for k in range(3)]
    for lie in lies:
        state.add_match(lie)
    assert set(own) <= state.accepted and not state.accepted & {lie.id for lie in lies}
    assert judged(state, 2) == (0, 3)


def lie_about(match, k):  # type: ignore[no-untyped-def]
    """A match that agent 2 reports, to agent 1, as if its track began 15 m beside; all such lies agree."""
    from maslam.backend.geometry import Sim3, se3
    from maslam.mas.protocol.ids import MatchId

    turned = match.turned()
    beside = Sim3.from_se3(se3([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [15.0, 0.0, 0.0]))
    T_T_M = Sim3.from_se3(turned.match.T_T_C)
    wrong = T_T_M.inverse() @ beside @ T_T_M @ turned.T_M_Q
    return replace(turned, id=MatchId(1, turned.id.query, 2, 40 + k), T_M_Q=wrong)


def test_faults_are_none_unless_set() -> None:
    assert not FaultsConfig().any and FaultsConfig(loss=0.1).any
