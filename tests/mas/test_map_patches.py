"""Maps as patches on a lattice: exact copies on every way, small errors, few bytes, no crash on damage."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of
from hypothesis import given, settings
from hypothesis import strategies as st

from backend.geometry import Sim3, rotation_angle_deg, se3_exp, se3_inverse
from mas.environment import make_agents
from mas.identities import FrameId, MatchId
from mas.keyframe import KeyFrame, keyframes_of
from mas.maps.bits import BitReader, BitsError, BitWriter
from mas.maps.lattice import LatticeMap, Steps, match_on_lattice, on_lattice, poses_of, size
from mas.maps.patches import Bound, anchors_for, encode, interpolated
from mas.maps.points import well_spread
from mas.maps.publisher import Publisher
from mas.maps.stock import StaleBase, Stock, stock_of
from mas.maps.wire import MapPatch
from mas.matches import Match
from mas.policy.presets import preset
from mas.sequence import AgentSequence
from mas.state import AgentState, Piece

WORLD = make_world(7, points=90_000)


def driver(keyframes: int = 40, **merge: object) -> tuple[AgentState, list[KeyFrame]]:
    """An agent that has seen nothing yet, and the key-frames that it will see."""
    sequence, frames = _drive(keyframes)
    config = preset("maslam")
    config = config.model_copy(update={"merge": config.merge.model_copy(update={"edition_keyframes": 1, **merge})})
    agent = make_agents(manifest_of([sequence]), [sequence], config)[0]
    return agent.state, frames


@cache
def _drive(keyframes: int) -> tuple[AgentSequence, list[KeyFrame]]:
    sequence = make_sequence(WORLD, circuit(0.0, keyframes * 1.5), 7)
    return sequence, keyframes_of(sequence)


def see(state: AgentState, keyframes: list[KeyFrame], count: int) -> None:
    for keyframe in keyframes[len(state.keyframes) : len(state.keyframes) + count]:
        state.observe(keyframe)


def bend(state: AgentState, twist: list[float]) -> None:
    """What an optimisation does: each key-frame moves a little more than the one before."""
    count = len(state.poses)
    state.poses = [se3_exp(np.array(twist) * k / count) @ T for k, T in enumerate(state.poses)]
    state.version += 1


# -- numbers in bits --------------------------------------------------------------------------------------------------


@given(st.lists(st.tuples(st.integers(0, 2**32 - 1), st.integers(0, 31)), max_size=60))
@settings(max_examples=100, deadline=None)
def test_numbers_come_back(pairs: list[tuple[int, int]]) -> None:
    writer = BitWriter()
    writer.put([v for v, _ in pairs], [c for _, c in pairs])
    reader = BitReader(writer.data)
    assert reader.get([c for _, c in pairs]).tolist() == [v for v, _ in pairs]
    reader.end()


def test_bits_that_end_too_early_are_an_error() -> None:
    writer = BitWriter()
    writer.put_signed([-5, 1000, 3], 0)
    with pytest.raises(BitsError):
        BitReader(writer.data[:-1]).get_signed(0, 3)
    with pytest.raises(BitsError):
        BitReader(writer.data).get(0, 10**9)


def test_numbers_of_a_geometric_law_take_little_more_than_their_entropy() -> None:
    p = 1 / 230
    values = np.random.default_rng(0).geometric(p, 5000) - 1
    entropy = -(p * np.log2(p) + (1 - p) * np.log2(1 - p)) / p
    writer = BitWriter()
    writer.put(values, 0)
    assert entropy < 8 * len(writer.data) / len(values) < entropy + 0.5


# -- what the lattice loses -------------------------------------------------------------------------------------------


def test_points_and_poses_are_as_exact_as_the_settings_say() -> None:
    state, keyframes = driver(20)
    see(state, keyframes, 20)
    stock = Publisher(state).edition(closing=False)
    assert stock is not None
    copy, config = stock.map, state.config.merge
    apart, away = [], []
    for row, keyframe in enumerate(keyframes):
        for point in copy.points_C()[copy.references == row]:
            nearest = np.linalg.norm(keyframe.points_C - point, axis=1).min()
            apart.append(nearest / np.linalg.norm(point))
            away.append(np.linalg.norm(point))
    assert len(apart) >= 30 * 20
    assert np.median(apart) <= config.point_error
    assert np.max(apart) <= 2.0 * config.point_error, "half the diagonal of a cell, sqrt(3) of half its step"
    off = se3_inverse(np.array(state.poses)) @ copy.poses_F()
    depth = np.median([k.depth for k in keyframes])
    assert np.linalg.norm(off[:, :3, 3], axis=1).max() <= config.pose_error * depth
    assert np.radians(rotation_angle_deg(off[:, :3, :3]).max()) <= config.pose_error


def test_a_key_frame_with_thirty_points_takes_less_than_a_hundred_bytes() -> None:
    state, keyframes = driver()
    see(state, keyframes, 40)
    stock = Publisher(state).edition(closing=False)
    assert stock is not None
    assert stock.map.counts.min() >= 30
    assert len(stock.whole.bits) < 100 * 40


def test_poses_and_matches_survive_any_rotation() -> None:
    rng = np.random.default_rng(1)
    steps = Steps.of(0.005, 0.001, 10.0)
    poses = se3_exp(np.concatenate([rng.normal(0, 50, (50, 3)), rng.normal(0, 2, (50, 3))], axis=1))
    back = poses_of(on_lattice(poses, steps), steps)
    assert np.abs(back[:, :3, 3] - poses[:, :3, 3]).max() <= 0.5 * size(steps.position) + 1e-9
    assert np.radians(rotation_angle_deg(np.swapaxes(back[:, :3, :3], 1, 2) @ poses[:, :3, :3]).max()) < 0.001
    T = Sim3(poses[0, :3, :3], poses[0, :3, 3], 1.7)
    ids, rows = np.array([[3, 1, 9]]), match_on_lattice(T, steps)[None]
    state, keyframes = driver(3)
    see(state, keyframes, 3)
    stock = Publisher(state).edition(closing=False)
    assert stock is not None
    match, found = replace(stock.map, steps=steps, matches=ids, transforms=rows).match_list()[0]
    assert match == MatchId(0, 3, 1, 9)
    np.testing.assert_allclose(found.matrix(), T.matrix(), rtol=2e-3, atol=0.02)


def test_the_points_sold_are_near_ones_from_all_over_the_image() -> None:
    rng = np.random.default_rng(2)
    z = rng.uniform(2.0, 40.0, 500)
    points = np.column_stack([rng.uniform(-1, 1, 500) * z, rng.uniform(-0.5, 0.5, 500) * z, z])
    chosen = well_spread(points, np.arange(500), 36)
    assert len(np.unique(chosen)) == 36
    assert np.median(z[chosen]) < 0.5 * np.median(z)
    direction = points[chosen, :2] / points[chosen, 2:]
    for side in (direction[:, 0] > 0, direction[:, 1] > 0):
        assert 12 <= side.sum() <= 24
    assert well_spread(points, np.array([5, 3]), 36).tolist() == [3, 5]


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
    first = publisher.edition(closing=False)
    bend(state, [1.0, 0.0, -2.0, 0.0, 0.05, 0.0])
    second = publisher.edition(closing=True)
    assert first is not None and second is not None
    (patch,) = second.since(first.map.edition)
    anew = len(encode(None, replace(second.map, counts=0 * second.map.counts, cells=second.map.cells[:0],
                                    depths=second.map.depths[:0]), Bound())[0])  # fmt: skip
    assert patch.base == first.map.edition
    assert len(patch.bits) < 0.5 * anew


def test_what_moved_less_than_the_bound_makes_no_edition() -> None:
    state, keyframes = driver()
    see(state, keyframes, 20)
    publisher = Publisher(state)
    first = publisher.edition(closing=True)
    bend(state, [0.001, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert publisher.edition(closing=True) is first


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
            buyer = _bought(publisher.edition(closing=True), buyer)
        elif step == "resell" and buyer is not None:
            second = _bought(buyer, second)
    newest = publisher.edition(closing=True)
    assert newest is not None and buyer is not None and second is not None
    whole = stock_of(0, None, (newest.whole,))
    for copy in (buyer, second, whole):
        assert copy.map.same_as(newest.map)
    assert newest.map.keyframes.tolist() == state.placed()
    moved = on_lattice(np.array(state.poses), newest.map.steps) - newest.map.poses
    assert np.abs(moved).max() <= 4


def _move_to_other_coordinates(state: AgentState, rng: np.random.Generator) -> None:
    motion = se3_exp(rng.normal(size=6) * [30, 1, 30, 0.1, 1.0, 0.1])
    state.poses = [motion @ T for T in state.poses]
    state.pieces = [Piece(p.track, p.first, FrameId(1, 0), p.unit) for p in state.pieces]
    state.version += 1


def _match(state: AgentState, query: int, rng: np.random.Generator) -> None:
    match = MatchId(0, query, 1, int(rng.integers(100)))
    T = Sim3.from_se3(se3_exp(rng.normal(size=6)))
    state.verified[match] = Match(match, 0, 0, T, np.eye(6), 50, np.eye(4), np.eye(4), 0.0, 0.0, 10.0)
    state.accepted.add(match)
    state.version += 1


def _bought(seller: Stock | None, known: Stock | None) -> Stock:
    assert seller is not None
    if known is not None and known.map.edition == seller.map.edition:
        return known
    return stock_of(0, known, seller.since(known.map.edition if known else 0))


def two_editions() -> tuple[Stock, Stock]:
    state, keyframes = driver()
    see(state, keyframes, 12)
    publisher = Publisher(state)
    first = publisher.edition(closing=False)
    see(state, keyframes, 12)
    second = publisher.edition(closing=False)
    assert first is not None and second is not None
    return first, second


def test_only_what_is_new_comes() -> None:
    first, second = two_editions()
    (patch,) = second.since(first.map.edition)
    assert len(patch.bits) < 0.6 * len(second.whole.bits)
    assert second.since(0) == (second.whole,)


def test_a_patch_for_another_edition_is_refused_and_an_unknown_one_gets_the_whole() -> None:
    first, second = two_editions()
    with pytest.raises(StaleBase, match="edition 1"):
        stock_of(0, None, second.since(1))
    assert second.since(77) == (second.whole,)
    spoilt = Stock(replace(first.map, poses=first.map.poses + 1))
    with pytest.raises(StaleBase, match="not what its owner made"):
        stock_of(0, spoilt, second.since(1))


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_damaged_patches_are_an_error_and_never_a_crash(data: st.DataObject) -> None:
    first, patches = FIRST_AND_PATCHES
    patch = data.draw(st.sampled_from(patches))
    bits = bytearray(patch.bits)
    for _ in range(data.draw(st.integers(1, 4))):
        bits[data.draw(st.integers(0, min(len(bits) - 1, 60)))] = data.draw(st.integers(0, 255))
    damaged = bytes(bits[: data.draw(st.integers(0, len(bits)))])
    with suppress(ValueError):
        copy: LatticeMap = stock_of(0, first, (replace_bits(patch, damaged),)).map
        assert damaged == patch.bits or np.isfinite(copy.points_C()).all()


def replace_bits(patch: MapPatch, bits: bytes) -> MapPatch:
    return MapPatch(patch.base, patch.edition, patch.frame, patch.unit, patch.check, bits, patch.descriptors)


_FIRST, _SECOND = two_editions()
FIRST_AND_PATCHES = (_FIRST, [_SECOND.whole, *_SECOND.since(1)])
