"""Maps as patches on a lattice: exact copies on every way, small errors, few bytes, no crash on damage."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from factory import circuit, make_sequence
from hypothesis import given, settings
from hypothesis import strategies as st
from map_driver import WORLD, driver, same_map, see

from maslam.backend.geometry import Sim3, se3_exp
from maslam.mas.map_exchange.coding.map_delta import encode
from maslam.mas.map_exchange.coding.pose_corrections import Bound, anchors_for, interpolated
from maslam.mas.map_exchange.coding.quantised_map import QuantisedMap, quantised
from maslam.mas.map_exchange.coding.rice import CodingError
from maslam.mas.map_exchange.publisher import Publisher
from maslam.mas.map_exchange.versions import MapVersion, StaleBase, make_patch, version_of
from maslam.mas.protocol.ids import FrameId, MatchId
from maslam.mas.protocol.map_messages import MapPatch
from maslam.mas.protocol.tensors import MessageError
from maslam.mas.state.agent_state import AgentState, Piece
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.place_match import Match, MatchEnd


def bend(state: AgentState, twist: list[float]) -> None:
    """What an optimisation does: each key-frame moves a little more than the one before."""
    count = len(state.poses)
    state.poses = [se3_exp(np.array(twist) * k / count) @ T for k, T in enumerate(state.poses)]
    state.version += 1


# -- corrections ------------------------------------------------------------------------------------------------------


def test_a_straight_correction_needs_its_two_ends_only() -> None:
    moves = np.outer(np.arange(50), [10, 0, -4, 0, 1, 0])
    assert anchors_for(moves, Bound()).tolist() == [0, 49]
    assert np.array_equal(interpolated(moves[[0, 49]], np.array([0, 49]), 50), moves)


@given(st.integers(1, 60), st.integers(0, 10**6))
@settings(max_examples=100, deadline=None)
def test_corrections_stay_within_the_bound(count: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    moves = np.cumsum(rng.integers(-6, 7, (count, 6)), axis=0)
    anchors = anchors_for(moves, Bound())
    off = moves - interpolated(moves[anchors], anchors, count)
    assert np.abs(off).max() <= 4


def test_a_correction_takes_fewer_bytes_than_the_poses_anew() -> None:
    state, keyframes = driver()
    see(state, keyframes, 40)
    publisher = Publisher(state)
    first = publisher.latest(closing=False)
    bend(state, [1.0, 0.0, -2.0, 0.0, 0.05, 0.0])
    second = publisher.latest(closing=True)
    assert first is not None and second is not None
    (patch,) = second.since(first.map.version)
    anew = len(
        encode(
            None,
            replace(second.map, counts=0 * second.map.counts, cells=second.map.cells[:0], depths=second.map.depths[:0]),
            Bound(),
        )[0]
    )
    assert patch.base == first.map.version
    assert len(patch.bits) < 0.5 * anew


def test_what_moved_less_than_the_bound_makes_no_version() -> None:
    state, keyframes = driver()
    see(state, keyframes, 20)
    publisher = Publisher(state)
    first = publisher.latest(closing=True)
    bend(state, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert publisher.latest(closing=True) is first


# -- purchases --------------------------------------------------------------------------------------------------------

STEP = st.sampled_from(["drive", "bend", "move", "match", "withdraw", "buy", "resell"])


@given(st.lists(STEP, min_size=1, max_size=14), st.integers(0, 10**6))
@settings(max_examples=40, deadline=None)
def test_any_sequence_of_purchases_ends_with_what_a_whole_purchase_gives(story: list[str], seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, keyframes = driver(60, descriptors=bool(seed % 2))
    publisher, buyer, second = Publisher(state), None, None
    see(state, keyframes, 3)
    for step in [*story, "buy", "resell"]:
        if step == "drive":
            see(state, keyframes, int(rng.integers(1, 6)))
        elif step == "bend":
            bend(state, list(rng.normal(size=6) * [0.5, 0.1, 0.5, 0.02, 0.05, 0.02]))
        elif step == "move":
            _move_to_other_coordinates(state, rng)
        elif step == "match":
            _match(state, int(rng.integers(len(state.keyframes))), rng)
        elif step == "withdraw" and state.accepted:
            state.accepted.discard(min(state.accepted))
            state.version += 1
        elif step == "buy":
            buyer = _bought(publisher.latest(closing=True), buyer)
        elif step == "resell" and buyer is not None:
            second = _bought(buyer, second)
    newest = publisher.latest(closing=True)
    assert newest is not None and buyer is not None and second is not None
    whole = version_of(0, None, (newest.whole,))
    for copy in (buyer, second, whole):
        assert same_map(copy.map, newest.map)
    assert newest.map.keyframes.tolist() == state.placed()
    moved = quantised(np.array(state.poses), newest.map.steps) - newest.map.poses
    assert np.abs(moved).max() <= 4


def _move_to_other_coordinates(state: AgentState, rng: np.random.Generator) -> None:
    motion = se3_exp(rng.normal(size=6) * [30, 1, 30, 0.1, 1.0, 0.1])
    state.poses = [motion @ T for T in state.poses]
    state.pieces = [Piece(p.track, p.first, FrameId(1, 0), p.metric) for p in state.pieces]
    state.version += 1


def _match(state: AgentState, query: int, rng: np.random.Generator) -> None:
    match = MatchId(0, query, 1, int(rng.integers(100)))
    T = Sim3.from_se3(se3_exp(rng.normal(size=6)))
    end = MatchEnd(0, np.eye(4), 0.0)
    state.verified[match] = Match(match, end, end, T, np.eye(6), 50, 10.0)
    state.accepted.add(match)
    state.version += 1


def _bought(seller: MapVersion | None, known: MapVersion | None) -> MapVersion:
    assert seller is not None
    if known is not None and known.map.version == seller.map.version:
        return known
    return version_of(0, known, seller.since(known.map.version if known else 0))


def two_versions() -> tuple[MapVersion, MapVersion]:
    state, keyframes = driver()
    see(state, keyframes, 12)
    publisher = Publisher(state)
    first = publisher.latest(closing=False)
    see(state, keyframes, 12)
    second = publisher.latest(closing=False)
    assert first is not None and second is not None
    return first, second


def test_when_another_track_becomes_the_main_one_the_map_comes_whole() -> None:
    sequence = make_sequence(WORLD, circuit(0.0, 45.0), 7, cuts=[24])
    state, _ = driver(3)
    frames, publisher = keyframes_of(sequence), Publisher(state)
    see(state, frames, 8)
    buyer = _bought(publisher.latest(closing=False), None)
    assert buyer.map.keyframes.tolist() == list(range(8))
    see(state, frames, 22)
    buyer = _bought(publisher.latest(closing=False), buyer)
    assert buyer.map.keyframes.tolist() == list(range(8, 30)) == state.placed()
    assert publisher.published is not None and same_map(buyer.map, publisher.published.map)


def test_only_what_is_new_comes() -> None:
    first, second = two_versions()
    (patch,) = second.since(first.map.version)
    assert len(patch.bits) < 0.6 * len(second.whole.bits)
    assert second.since(0) == (second.whole,)


def test_a_patch_for_another_version_is_refused_and_an_unknown_one_gets_the_whole() -> None:
    first, second = two_versions()
    with pytest.raises(StaleBase, match="version 1"):
        version_of(0, None, second.since(1))
    assert second.since(77) == (second.whole,)
    spoilt = MapVersion(replace(first.map, poses=first.map.poses + 1))
    with pytest.raises(StaleBase, match="not what its owner made"):
        version_of(0, spoilt, second.since(1))


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_damaged_patches_are_an_error_and_never_a_crash(data: st.DataObject) -> None:
    first, patches = FIRST_AND_PATCHES
    patch = data.draw(st.sampled_from(patches))
    bits = bytearray(patch.bits)
    for _ in range(data.draw(st.integers(1, 4))):
        bits[data.draw(st.integers(0, min(len(bits) - 1, 60)))] = data.draw(st.integers(0, 255))
    damaged = bytes(bits[: data.draw(st.integers(0, len(bits)))])
    with suppress(MessageError):
        copy: QuantisedMap = version_of(0, first, (replace_bits(patch, damaged),)).map
        assert damaged == patch.bits or np.isfinite(copy.points_C()).all()


def test_a_match_of_endless_scale_is_refused() -> None:
    first, _ = two_versions()
    row = np.array([[0, 0, 0, 0, 0, 0, 10**9]])
    wild = replace(first.map, version=9, matches=np.array([[3, 1, 9]]), transforms=row)
    bits, made = encode(None, wild, Bound())
    with pytest.raises(CodingError, match="scale"):
        version_of(0, None, (make_patch(None, made, bits),))


def replace_bits(patch: MapPatch, bits: bytes) -> MapPatch:
    return MapPatch(patch.base, patch.version, patch.frame, patch.unit, patch.check, bits, patch.descriptors)


_FIRST, _SECOND = two_versions()
FIRST_AND_PATCHES = (_FIRST, [_SECOND.whole, *_SECOND.since(1)])
