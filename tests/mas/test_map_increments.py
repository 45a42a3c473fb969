"""Whole maps, bought piece by piece: the same copies as bought at once, and no point twice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from by_hand import happened, logged
from factory import circuit, make_sequence, talkative, town
from hypothesis import given, settings
from hypothesis import strategies as st
from map_driver import WORLD, driver, see
from saboteurs import live
from test_map_delta import _match, bend
from test_map_exchange import agents_with_more_to_see, trade

from maslam.backend.geometry import Sim3, se3_exp
from maslam.mas.config import FaultsConfig
from maslam.mas.map_exchange.full_map import own_submap
from maslam.mas.map_exchange.full_map_increments import completed, runs_of, without
from maslam.mas.map_exchange.map_copy import MapCopy, copy_of_submap, submap_of
from maslam.mas.map_exchange.versions import StaleBase
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.accounting import Traffic
from maslam.mas.protocol.ids import ContractId, FrameId
from maslam.mas.protocol.map_messages import MapDelivery, Runs, SubMap, indices_of
from maslam.mas.protocol.messages import Bid, Message, Result, decode, encode
from maslam.mas.protocol.tensors import MessageError, pack_sim3s
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import KeyFrame, keyframes_of

POINTS = 40


@given(st.sets(st.integers(0, 300)))
def test_runs_are_the_indices_and_shorter(indices: set[int]) -> None:
    ascending = sorted(indices)
    runs = runs_of(ascending)
    assert indices_of(runs).tolist() == ascending
    assert runs_of(range(7, 1000)) == (7, 993)
    assert len(runs) <= 2 * len(ascending)


@pytest.mark.parametrize("runs", [(1,), (1, 0), (5, 2, 7, 1), (5, 2, 3, 1), (0, 2**31)])
def test_runs_that_make_no_sense_are_refused(runs: Runs) -> None:
    with pytest.raises(MessageError, match="runs of key-frames"):
        indices_of(runs)


# -- any story --------------------------------------------------------------------------------------------------------


class Buyer:
    """Buys an owner's map from whomever, noting which key-frames' points came how often since it lost its copy."""

    def __init__(self, me: int) -> None:
        self.me = me
        self.held: MapCopy | None = None
        self.got: set[int] = set()

    def buy(self, whole: SubMap) -> None:
        known = () if self.held is None else runs_of(self.held.keyframes)
        message = Message(
            0, 1, ContractId(1, 0), Result(MapDelivery(FrameId(0, 0), (), pack_sim3s([]), (without(whole, known),)))
        )
        heard = decode(encode(message), 2**24)
        assert isinstance(heard.body, Result) and isinstance(heard.body.outcome, MapDelivery)
        (submap,) = heard.body.outcome.maps
        came = set(submap.keyframes.array()[submap.references.array()].tolist())
        assert not came & self.got, "points that are here came again"
        made = completed(submap, self.held)
        assert made == whole, "put together from pieces it is not the map that was for sale"
        self.held = copy_of_submap(made, FrameId(0, 0), Sim3.identity(), 0)
        self.got = set(self.held.keyframes[self.held.references].tolist())

    def lose(self) -> None:
        self.held, self.got = None, set()


STEP = st.sampled_from(["drive", "bend", "match", "buy", "other buys", "resell", "resell back", "lose", "realign"])


@given(st.lists(STEP, min_size=1, max_size=16), st.integers(0, 10**6), st.booleans())
@settings(max_examples=60, deadline=None)
def test_any_sequence_of_purchases_ends_with_what_a_whole_purchase_gives(
    story: list[str], seed: int, cut: bool
) -> None:
    """Two buyers of one map, from its owner and from each other; with a cut the map's key-frames are others after a
    while, those of the longer track."""
    rng = np.random.default_rng(seed)
    state, keyframes = driver(30, form="full", max_points=POINTS)
    if cut:
        keyframes = keyframes_of(make_sequence(WORLD, circuit(0.0, 45.0), 7, cuts=[24]))
    one, other = Buyer(1), Buyer(2)
    see(state, keyframes, 3)
    for step in [*story, "buy", "resell"]:
        act(step, state, keyframes, one, other, rng)
    newest = own_submap(state, POINTS)
    for buyer in (one, other):
        assert buyer.held is not None
        copy = submap_of(buyer.held)
        for part in ("keyframes", "stamps_ns", "references", "points", "descriptors", "matches"):
            assert getattr(copy, part) == getattr(newest, part), part
        np.testing.assert_allclose(buyer.held.poses[:, :3, 3], newest.poses.array()[:, :3], atol=1e-9)


def act(
    step: str, state: AgentState, keyframes: list[KeyFrame], one: Buyer, other: Buyer, rng: np.random.Generator
) -> None:
    if step == "drive":
        see(state, keyframes, int(rng.integers(1, 6)))
    elif step == "bend":
        bend(state, list(rng.normal(size=6) * [0.5, 0.1, 0.5, 0.02, 0.05, 0.02]))
    elif step == "match":
        _match(state, int(rng.integers(len(state.keyframes))), rng)
    elif step == "buy":
        one.buy(own_submap(state, POINTS))
    elif step == "other buys":
        other.buy(own_submap(state, POINTS))
    elif step == "resell" and one.held is not None:
        other.buy(submap_of(one.held))
    elif step == "resell back" and other.held is not None:
        one.buy(submap_of(other.held))
    elif step == "lose":
        other.lose()
    elif step == "realign" and one.held is not None:
        one.held = one.held.moved(Sim3.from_se3(se3_exp(rng.normal(size=6))))


# -- what can go wrong between an order and its delivery --------------------------------------------------------------


def two_purchases() -> tuple[MapCopy, SubMap]:
    """A copy of eight key-frames, and the map when it has twelve."""
    state, keyframes = driver(30, form="full", max_points=POINTS)
    see(state, keyframes, 8)
    copy = copy_of_submap(own_submap(state, POINTS), FrameId(0, 0), Sim3.identity(), 0)
    see(state, keyframes, 4)
    bend(state, [0.5, 0.0, 0.5, 0.0, 0.05, 0.0])
    return copy, own_submap(state, POINTS)


def test_only_points_of_new_key_frames_come_and_all_poses() -> None:
    copy, whole = two_purchases()
    part = without(whole, runs_of(copy.keyframes))
    assert part.poses == whole.poses and part.stamps_ns == whole.stamps_ns
    assert set(part.references.array()) == {8, 9, 10, 11} and part.known == (0, 8)
    assert part.payload_bytes < 0.5 * whole.payload_bytes
    assert completed(part, copy) == whole
    assert without(whole, ()) is whole and without(whole, (50, 9)) is whole


def test_a_copy_that_was_renewed_meanwhile_serves_as_well() -> None:
    copy, whole = two_purchases()
    newer = copy_of_submap(whole, FrameId(0, 0), Sim3.identity(), 0)
    assert completed(without(whole, runs_of(copy.keyframes)), newer) == whole


def test_a_copy_that_is_gone_or_another_is_noticed() -> None:
    copy, whole = two_purchases()
    part = without(whole, runs_of(copy.keyframes))
    with pytest.raises(StaleBase, match="left out that are not here"):
        completed(part, None)
    fewer = replace(copy, keyframes=copy.keyframes[:-1], references=np.minimum(copy.references, 6))
    with pytest.raises(StaleBase, match="left out that are not here"):
        completed(part, fewer)
    for bad in ({"points_C": copy.points_C + 0.01}, {"descriptors": 255 - copy.descriptors}):  # type: ignore[operator]
        with pytest.raises(StaleBase, match="other points than the seller's"):
            completed(part, replace(copy, **bad))


@pytest.mark.parametrize("known", [(9, 5), (0, 1), (20, 1)])
def test_key_frames_left_out_must_be_in_the_map_and_without_points(known: Runs) -> None:
    _, whole = two_purchases()
    changes = {f: getattr(whole, f) for f in whole.__struct_fields__}
    with pytest.raises(MessageError, match="known: a key-frame"):
        SubMap(**{**changes, "known": known})


# -- among agents -----------------------------------------------------------------------------------------------------


def test_a_second_purchase_brings_only_what_is_new_from_the_owner_and_from_a_holder() -> None:
    agents, frames = agents_with_more_to_see()
    trade(agents, 1, [2])
    first = trade(agents, 0, [1]).by_operation[Traffic.MAPMERGE].wire_bytes
    for owner in (1, 2):
        for keyframe in frames[owner][6:8]:
            agents[owner].state.observe(keyframe)
    trade(agents, 1, [2])
    second = trade(agents, 0, [1]).by_operation[Traffic.MAPMERGE].wire_bytes
    assert second < 0.45 * first, "two key-frames in eight are new"
    for owner, copy in agents[0].maps.copies.items():
        same(copy, own_submap(agents[owner].state, agents[owner].state.config.merge.max_points))
    assert [len(c.keyframes) for c in agents[0].maps.copies.values()] == [8, 8]


def same(copy: MapCopy, whole: SubMap) -> None:
    """A copy has the key-frames and points of a map."""
    assert copy.keyframes.tolist() == whole.keyframes.array().tolist()
    assert copy.references.tolist() == whole.references.array().tolist()
    assert np.array_equal(copy.points_C.astype(np.float32), whole.points.array())
    assert np.array_equal(copy.descriptors, whole.descriptors.array())  # type: ignore[arg-type]


def test_a_copy_that_went_bad_is_bought_whole_again() -> None:
    agents, frames = agents_with_more_to_see()
    trade(agents, 0, [1])
    held = agents[0].maps.copies[1]
    agents[0].maps.copies[1] = replace(held, points_C=held.points_C + 1.0)
    agents[1].state.observe(frames[1][6])
    trade(agents, 0, [1])
    refused = [e["reason"] for e in logged(agents[0], "map_refused")]
    assert refused == ["the copy of agent 1's map has other points than the seller's"]
    trade(agents, 0, [1])
    same(agents[0].maps.copies[1], own_submap(agents[1].state, 2000))


def test_where_messages_are_lost_copies_are_whole() -> None:
    config = talkative()
    merge = {"form": "full", "max_points": POINTS, "period_keyframes": 4}
    config = config.model_copy(
        update={"faults": FaultsConfig(loss=0.2, duplicate=0.1), "merge": config.merge.model_copy(update=merge)}
    )
    manifest, sequences = town(3, 20, spacing_m=9.0)
    environment, _ = live(manifest, sequences, config)
    bought = 0
    for agent in environment.agents:
        assert sorted(agent.maps.copies) == sorted({0, 1, 2} - {agent.state.me})
        for owner, copy in agent.maps.copies.items():
            whole = own_submap(environment.agents[owner].state, POINTS)
            keep = np.isin(whole.keyframes.array()[whole.references.array()], copy.keyframes)
            assert np.array_equal(copy.points_C.astype(np.float32), whole.points.array()[keep])
            bought += len(copy.keyframes) >= 18
    assert not happened(environment, "map_refused")
    assert bought == 6


def test_bids_state_what_a_whole_map_takes_on_the_air() -> None:
    """What a buyer has is not known to a bid: who has nothing pays what was stated, others less."""
    config = preset("default")
    config = config.model_copy(update={"merge": config.merge.model_copy(update={"period_keyframes": 4})})
    stated: dict[tuple[ContractId, int], int] = {}
    sold: dict[tuple[ContractId, int], int] = {}
    first: list[float] = []
    later: list[float] = []

    def listen(message: Message, wire_bytes: int) -> None:
        if message.contract is None:
            return
        if isinstance(message.body, Bid):
            stated[message.contract, message.sender] = message.body.cost_bytes
            sold[message.contract, message.sender] = len(message.body.offers)
        elif isinstance(message.body, Result) and isinstance(message.body.outcome, MapDelivery):
            key = (message.contract, message.sender)
            all_of_it = len(message.body.outcome.maps) == sold[key]
            new = not any(m.known for m in message.body.outcome.maps)
            (first if new and all_of_it else later).append(wire_bytes / stated[key])

    manifest, sequences = town(3, 24, spacing_m=9.0, drifting=0.03)
    live(manifest, sequences, config, listen=listen)
    assert len(first) >= 3 and min(first) > 0.7 and max(first) < 1.3
    assert later and max(later) < 1.3 and min(later) < 0.7
