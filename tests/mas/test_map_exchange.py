"""Map merging: who ends with which map, where it stands, and that it ends."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from by_hand import begun, handled, logged, ticked
from factory import circuit, make_sequence, make_world, manifest_of
from map_driver import same_map
from scipy.spatial import cKDTree

from maslam.backend.geometry import Sim3, se3_exp, transform_points
from maslam.mas.agent import Agent
from maslam.mas.contracts.operation import WorkError
from maslam.mas.map_exchange.versions import MapVersion
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.accounting import Traffic
from maslam.mas.protocol.ids import FrameId, MatchId, OperationKind
from maslam.mas.protocol.map_messages import MapOrder, MapPatch, Parcel
from maslam.mas.simulation import make_agents
from maslam.mas.state.agent_state import stretched
from maslam.mas.state.keyframe import KeyFrame, keyframes_of
from maslam.mas.state.place_match import Match, MatchEnd
from maslam.mas.state.pose_graph import Adoption
from maslam.mas.transport.transport import InProcessTransport

FORMS = pytest.mark.parametrize("form", ["full", "compact"])


def agents_in_a_row(count: int = 3, keyframes: int = 6, **merge: object) -> list[Agent]:
    """Agents with exact odometry, each matched twice with the next; none of them has optimised or asked for places."""
    config = preset("default")
    config = config.model_copy(update={"merge": config.merge.model_copy(update=merge)})
    world = make_world(7, points=20_000)
    paths = [circuit(6.0 * a, keyframes * 1.5) for a in range(count)]
    sequences = [make_sequence(world, path, 7, a, drifting=0.0) for a, path in enumerate(paths)]
    agents = make_agents(manifest_of(sequences), sequences, config)
    frames = [keyframes_of(s) for s in sequences]
    for agent, mine in zip(agents, frames, strict=True):
        for keyframe in mine:
            agent.observe(keyframe)
        agent._new.clear()
    for a, b in pairwise(agents):
        for k in (0, 1):
            for side in (a, b):
                side.state.add_match(_true_match(paths, frames, a.state.me, b.state.me, k))
    return agents


def agents_with_more_to_see(**merge: object) -> tuple[list[Agent], list[list[KeyFrame]]]:
    """As :func:`agents_in_a_row`, and the key-frames of ten for each."""
    paths = [circuit(6.0 * a, 15.0) for a in range(3)]
    frames = [
        keyframes_of(make_sequence(make_world(7, points=20_000), p, 7, a, drifting=0.0)) for a, p in enumerate(paths)
    ]
    return agents_in_a_row(**merge), frames  # type: ignore[arg-type]


def _true_match(paths: list, frames: list, a: int, b: int, k: int) -> Match:  # type: ignore[type-arg]
    match, query = frames[a][k + 4], frames[b][k]
    T_M_Q = Sim3.from_se3(np.linalg.inv(paths[a][3 * (k + 4)]) @ paths[b][3 * k])
    ends = MatchEnd(0, query.T_T_C, 1.5 * k), MatchEnd(0, match.T_T_C, 1.5 * (k + 4))
    return Match(MatchId(b, k, a, k + 4), *ends, T_M_Q, 1e4 * np.eye(6), 80, 10.0)


def trade(agents: list[Agent], buyer: int, sellers: list[int]) -> InProcessTransport:
    """One purchase, with all messages until none is on the way."""
    transport = InProcessTransport(2**24)
    for message in begun(agents[buyer], agents[buyer].maps.buy(sellers)):
        transport.send(message, 0)
    while (message := transport.receive()) is not None:
        for answer in handled(agents, message):
            transport.send(answer, 0)
    assert not any(a.context.ledger.running() for a in agents)
    return transport


# A compact map is exact to a thousandth of the median depth, which is some 15 m here.
EXACT = {"full": 1e-6, "compact": 0.015}


@FORMS
def test_a_map_stands_where_the_match_says(form: str) -> None:
    agents = agents_in_a_row(form=form)
    trade(agents, 0, [1])
    held = agents[0].maps.copies[1]
    start = circuit(0.0, 1.0)[0]
    truth = np.linalg.inv(start) @ circuit(6.0, 9.0)[::3]
    np.testing.assert_allclose(held.poses, truth, atol=EXACT[form])
    assert len(held.points()) > 200
    assert (held.descriptors is None) == (form == "compact")


@FORMS
def test_the_points_are_the_owners(form: str) -> None:
    agents = agents_in_a_row(form=form)
    trade(agents, 0, [1])
    owner, held = agents[1].state, agents[0].maps.copies[1]
    T_0_1 = np.linalg.inv(circuit(0.0, 1.0)[0]) @ circuit(6.0, 1.0)[0]
    theirs = np.concatenate(
        [transform_points(T_0_1 @ T, k.points_C) for T, k in zip(owner.poses, owner.keyframes, strict=True)]
    )
    off = cKDTree(theirs).query(held.points())[0]
    assert np.median(off) < (1e-5 if form == "full" else 0.1)


@FORMS
def test_sub_maps_come_along_and_are_placed_through_the_seller(form: str) -> None:
    agents = agents_in_a_row(form=form)
    trade(agents, 1, [2])
    trade(agents, 0, [1])
    assert sorted(agents[0].maps.copies) == [1, 2]
    truth = np.linalg.inv(circuit(0.0, 1.0)[0]) @ circuit(12.0, 9.0)[::3]
    np.testing.assert_allclose(agents[0].maps.copies[2].poses, truth, atol=EXACT[form])
    assert {o: h.route for o, h in agents[0].maps.copies.items()} == {1: (1,), 2: (2, 1)}


@FORMS
def test_agents_that_hold_each_others_maps_come_to_an_end(form: str) -> None:
    """Algorithm 1 as printed would walk from sub-map to sub-map for ever."""
    agents = agents_in_a_row(form=form)
    for _ in range(3):
        for buyer, sellers in ((0, [1]), (1, [0, 2]), (2, [1])):
            trade(agents, buyer, sellers)
    assert [sorted(a.maps.copies) for a in agents] == [[1, 2], [0, 2], [0, 1]]
    again = trade(agents, 1, [0, 2])
    assert again.by_operation[Traffic.MAPMERGE].messages == 0, "nothing new: nothing ordered, nothing sent"


@FORMS
def test_a_map_that_two_sell_is_ordered_once_and_from_its_owner(form: str) -> None:
    agents = agents_in_a_row(form=form)
    trade(agents, 1, [2])
    sent = trade(agents, 0, [1, 2])
    assert sent.by_operation[Traffic.MAPMERGE].messages == 4, "an order and a delivery from each"
    assert agents[0].maps.copies[1].seller == 1
    refused = [e["seller"] for e in logged(agents[0], "map_refused")]
    assert refused == [2], "agent 2 sold its own, which agent 0 cannot place without a match"


def test_a_seller_that_does_not_answer_keeps_nobody_waiting() -> None:
    agents = agents_in_a_row()
    transport = InProcessTransport(2**24)
    out = begun(agents[0], agents[0].maps.buy([1, 2]))
    for seconds in (1.0, 2.5):
        for message in out:
            transport.send(message, 0)
        while (message := transport.receive()) is not None:
            if message.recipient != 2:
                for answer in handled(agents, message):
                    transport.send(answer, 0)
        assert not agents[0].maps.copies
        out = ticked(agents[0], round(seconds * 1e9))
    for message in out:
        transport.send(message, 0)
    while (message := transport.receive()) is not None:
        if message.recipient != 2:
            for answer in handled(agents, message):
                transport.send(answer, 0)
    assert sorted(agents[0].maps.copies) == [1]
    ends = {e["contractor"]: e["reason"] for e in logged(agents[0], "contract")}
    assert ends[2] == "no answer"


def test_a_second_purchase_brings_only_what_is_new() -> None:
    agents, frames = agents_with_more_to_see(form="compact", version_keyframes=1)
    first = trade(agents, 0, [1]).by_operation[Traffic.MAPMERGE].wire_bytes
    for keyframe in frames[1][6:8]:
        agents[1].state.observe(keyframe)
    second = trade(agents, 0, [1]).by_operation[Traffic.MAPMERGE].wire_bytes
    assert second < 0.6 * first
    copy = agents[0].maps.copies[1].map_version
    publisher = agents[1].maps.seller._publisher
    assert copy is not None and publisher.published is not None
    assert same_map(copy.map, publisher.published.map)
    assert copy.map.keyframes.tolist() == list(range(8))


def test_a_copy_that_went_bad_is_bought_whole_again() -> None:
    agents, frames = agents_with_more_to_see(form="compact", version_keyframes=1)
    trade(agents, 0, [1])
    held = agents[0].maps.copies[1]
    assert held.map_version is not None
    bad = MapVersion(replace(held.map_version.map, poses=held.map_version.map.poses + 7))
    agents[0].maps.copies[1] = replace(held, map_version=bad)
    agents[1].state.observe(frames[1][6])
    trade(agents, 0, [1])
    refused = [e["reason"] for e in logged(agents[0], "map_refused")]
    assert refused == ["version 2 of agent 1's map is not what its owner made"]
    trade(agents, 0, [1])
    stock, publisher = agents[0].maps.copies[1].map_version, agents[1].maps.seller._publisher
    assert stock is not None and publisher.published is not None and same_map(stock.map, publisher.published.map)


def test_a_whole_map_that_is_none_is_not_bought_again() -> None:
    agents = agents_in_a_row(form="compact")
    own = agents[1].maps.seller._own

    def noise(version: int, closing: bool) -> Parcel:
        good = own(version, closing)
        assert isinstance(good, Parcel)
        patch = good.patches[0]
        damaged = MapPatch(patch.base, patch.version, patch.frame, patch.unit, patch.check, patch.bits[::-1])
        return Parcel(good.owner, good.placement, good.route, (damaged,))

    agents[1].maps.seller._own = noise  # type: ignore[method-assign]
    assert trade(agents, 0, [1]).by_operation[Traffic.MAPMERGE].messages == 2
    assert agents[0].maps.copies == {}
    assert [e["owner"] for e in logged(agents[0], "map_refused")] == [1]
    assert trade(agents, 0, [1]).by_operation[Traffic.MAPMERGE].messages == 0


@FORMS
def test_a_wrong_map_is_rejected_with_a_reason_and_not_bought_again(form: str) -> None:
    agents = agents_in_a_row(form=form, accuracy_m=5.0)
    liar = agents[1].state
    liar.poses = [T if k == 0 else stretched(T, 9.0) for k, T in enumerate(liar.poses)]
    liar.version += 1
    trade(agents, 0, [1])
    assert agents[0].maps.copies == {}
    (refusal,) = logged(agents[0], "map_refused")
    assert refusal["seller"] == refusal["owner"] == 1
    assert refusal["reason"].startswith("no place match agrees: 1 of them")
    assert trade(agents, 0, [1]).by_operation[Traffic.MAPMERGE].messages == 0


def test_in_common_coordinates_a_sellers_misplacement_is_not_inherited() -> None:
    agents = agents_in_a_row(form="compact")
    for agent in agents:  # as after an optimisation of all: in the coordinates of agent 0
        T_0_own = np.linalg.inv(circuit(0.0, 1.0)[0]) @ circuit(6.0 * agent.state.me, 1.0)[0]
        agent.state.poses = [T_0_own @ T for T in agent.state.poses]
        agent.state.pieces = [replace(p, frame=FrameId(0, 0)) for p in agent.state.pieces]
        agent.state.version += 1
    trade(agents, 1, [2])
    agents[1].maps.copies[2] = agents[1].maps.copies[2].moved(Sim3(np.eye(3), np.array([9.0, 0.0, 0.0])))
    trade(agents, 0, [1])
    truth = np.linalg.inv(circuit(0.0, 1.0)[0]) @ circuit(12.0, 9.0)[::3]
    np.testing.assert_allclose(agents[0].maps.copies[2].poses, truth, atol=EXACT["compact"])


def test_a_copy_newer_than_its_owners_own_map_is_given_up() -> None:
    agents = agents_in_a_row(form="compact")
    trade(agents, 0, [1])
    held = agents[0].maps.copies[1]
    agents[0].maps.copies[1] = replace(
        held, sold=replace(held.sold, version=1000), placement=held.placement @ Sim3(np.eye(3), np.ones(3))
    )
    trade(agents, 0, [1])
    assert agents[0].maps.copies[1].version == 1
    np.testing.assert_allclose(agents[0].maps.copies[1].poses, held.poses, atol=1e-9)


def test_an_order_for_what_is_not_there_fails() -> None:
    agents = agents_in_a_row()
    with pytest.raises(WorkError, match="no map of agent 2 here"):
        agents[1].maps.seller.delivery(0, MapOrder((2,)), {}, False)


@FORMS
def test_the_newest_version_wins(form: str) -> None:
    agents = agents_in_a_row(form=form)
    trade(agents, 1, [2])
    trade(agents, 0, [1])
    old = agents[0].maps.copies[2].version
    agents[2].state.accepted.discard(min(agents[2].state.accepted))
    agents[2].state.version += 1
    agents[2].context.closing = True
    trade(agents, 1, [2])
    trade(agents, 0, [1])
    assert agents[0].maps.copies[2].version == old + 1
    trade(agents, 2, [1])
    assert 2 not in agents[2].maps.copies, "nobody buys back its own map"


def test_a_stranger_without_a_match_is_not_placed() -> None:
    agents = agents_in_a_row()
    trade(agents, 0, [2])
    assert agents[0].maps.copies == {}
    assert len(logged(agents[0], "map_refused")) == 1


def test_held_maps_move_along_with_the_agents_own_correction() -> None:
    agents = agents_in_a_row()
    trade(agents, 0, [1])
    state, held = agents[0].state, agents[0].maps.copies[1]
    before = {i: state.pose(i) for i in range(len(state.keyframes))}
    motion = se3_exp([0.3, -0.1, 0.2, 0.0, 0.1, 0.0])
    state.poses = [motion @ T for T in state.poses]
    agents[0].maps.realign(Adoption(before, frozenset()))
    np.testing.assert_allclose(agents[0].maps.copies[1].poses, motion @ held.poses, atol=1e-9)


def test_a_purchase_is_one_contract_that_ends() -> None:
    agents = agents_in_a_row()
    trade(agents, 0, [1])
    ends = logged(agents[0], "contract")
    assert [(e["operation"], e["end"]) for e in ends] == [(OperationKind.MAPMERGE.name.lower(), "done")]
