"""Maps of one camera: each key-frame has its own unit, in every form and at every holder."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from map_driver import SEEN, drift_apart, same_map, seen
from test_matches import random_sim3

from maslam.backend.geometry import Array, Sim3, so3_exp
from maslam.mas.map_exchange.coding.map_delta import decode
from maslam.mas.map_exchange.coding.rice import CodingError
from maslam.mas.map_exchange.evidence_checks import witnesses
from maslam.mas.map_exchange.full_map import own_submap
from maslam.mas.map_exchange.map_copy import MapCopy, copy_of_submap, copy_of_version, submap_of, with_new_keyframes
from maslam.mas.map_exchange.publisher import Publisher
from maslam.mas.map_exchange.versions import MapVersion, version_of
from maslam.mas.protocol.ids import FrameId, MatchId
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.place_match import Match, MatchEnd


def bought(version: MapVersion | None, known: MapVersion | None = None) -> MapVersion:
    assert version is not None
    return version_of(0, known, version.since(0 if known is None else known.map.version))


def held(version: MapVersion, placement: Sim3 | None = None) -> MapCopy:
    return copy_of_version(version, placement or Sim3(np.eye(3), np.zeros(3), version.map.unit), (0,))


def apart(copy: MapCopy, state: AgentState) -> Array:
    """Key-frame by key-frame: how far the copy's camera and what it sees are off the owner's."""
    out = []
    for row, index in enumerate(copy.keyframes.tolist()):
        mine, theirs = state.pose(index), copy.pose(row)
        probe = np.array([[0.0, 0.0, 0.0], [3.0, 1.0, 8.0]]) * state.keyframes[index].depth / 8.0
        out.append(np.linalg.norm(mine @ probe - theirs @ probe, axis=1).max() / state.depth(index))
    return np.array(out)


def test_a_copy_has_the_unit_of_each_key_frame() -> None:
    state, keyframes = seen(6)
    publisher = Publisher(state)
    first = bought(publisher.latest(closing=False))
    assert not first.map.drifting, "before any optimisation all have one"
    drift_apart(state)
    second = bought(publisher.latest(closing=True), first)
    assert second.map.drifting and second.map.unit == 2.0
    assert apart(held(second), state).max() < 0.01
    for keyframe in keyframes[6:]:
        state.observe(keyframe)
    third = bought(publisher.latest(closing=True), second)
    assert apart(held(third), state).max() < 0.01
    whole = bought(publisher.latest(closing=True))
    assert same_map(whole.map, third.map)
    np.testing.assert_allclose(held(third).points(), own_points(state, third), rtol=0.05, atol=0.05)


def own_points(state: AgentState, version: MapVersion) -> Array:
    """The version's points where the owner has its key-frames."""
    points, rows = version.map.points_C(), version.map.references
    return np.array([state.pose(int(version.map.keyframes[r])) @ p for p, r in zip(points, rows, strict=True)])


def test_units_that_change_cost_no_points_again() -> None:
    state, _ = seen()
    publisher = Publisher(state)
    drift_apart(state)
    first = publisher.latest(closing=True)
    assert first is not None
    size = len(first.whole.bits)
    drift_apart(state, 0.01)
    second = publisher.latest(closing=True)
    assert second is not None and len(second.since(first.map.version)[0].bits) < 0.1 * size
    assert apart(held(bought(second, first)), state).max() < 0.01


def test_a_unit_out_of_range_is_refused() -> None:
    state, _ = seen(3)
    drift_apart(state)
    version = Publisher(state).latest(closing=True)
    assert version is not None
    (patch,) = version.since(0)
    assert decode(0, 1, patch.frame, patch.unit, None, patch.bits).drifting
    with pytest.raises(CodingError):
        decode(0, 1, patch.frame, None, None, patch.bits)
    with pytest.raises(CodingError, match="units"):
        decode(0, 2, patch.frame, None, version.map, patch.bits)
    state.units[1] = 1e300
    big = Publisher(state).latest(closing=True)
    assert big is not None
    with pytest.raises(CodingError, match="unit"):
        decode(0, 1, patch.frame, 2.0, None, big.whole.bits)


def test_the_thesis_form_carries_units_too_and_is_sold_on() -> None:
    state, _ = seen()
    drift_apart(state)
    T_mine_owner = random_sim3(np.random.default_rng(2), 0.7)
    copy = copy_of_submap(own_submap(state, 100), FrameId(0, 0), T_mine_owner, 0)
    again = copy_of_submap(submap_of(copy), FrameId(0, 0), T_mine_owner.inverse(), 1)
    for k in range(SEEN):
        np.testing.assert_allclose(copy.pose(k).matrix(), (T_mine_owner @ state.pose(k)).matrix(), atol=1e-6)
        np.testing.assert_allclose(again.pose(k).matrix(), state.pose(k).matrix(), atol=1e-6)
    expected = [state.pose(int(r)) @ p for p, r in zip(copy.points_C, copy.references, strict=True)]
    np.testing.assert_allclose(again.points(), expected, atol=1e-4)


def test_a_metric_map_travels_as_it_did() -> None:
    state, _ = seen(scale=1.0)
    assert own_submap(state, 10).poses.shape == (SEEN, 7)
    version = Publisher(state).latest(closing=True)
    assert version is not None and version.whole.unit is None and version.map.poses.shape == (SEEN, 6)


@pytest.mark.parametrize("asked", [False, True])
def test_a_match_witnesses_in_the_unit_of_its_key_frame(asked: bool) -> None:
    """Holder 1 matched key-frame 7 of the map; the map stands in its place, and the match says so."""
    owner, _ = seen()
    drift_apart(owner)
    T_mine_owner = random_sim3(np.random.default_rng(4), 0.7)
    copy = copy_of_submap(own_submap(owner, 5), FrameId(0, 0), T_mine_owner, 0)
    state, _ = seen(scale=0.3)
    drift_apart(state, -0.02)
    state.profile = replace(state.profile, me=1, others=(0,))
    T_own_other = state.pose(5).inverse() @ T_mine_owner @ owner.pose(7)
    match = MatchId(1, 5, 0, 7) if asked else MatchId(0, 7, 1, 5)
    end = MatchEnd(0, np.eye(4), 0.0)
    T_M_Q = T_own_other.inverse() if asked else T_own_other
    state.verified[match] = Match(match, end, end, T_M_Q, np.eye(6), 50, 5.0)
    state.accepted.add(match)
    (witness,) = witnesses(copy, state, {})
    assert witness.metres < 1e-5 and witness.motion.scale == pytest.approx(1.0, rel=1e-6)


def test_new_key_frames_of_a_copy_follow_in_its_own_unit() -> None:
    """The old copy stands twice as large elsewhere: what is new goes on from there."""
    state, keyframes = seen(6)
    drift_apart(state)
    old = copy_of_submap(own_submap(state, 5), FrameId(0, 0), Sim3(so3_exp([0, 1, 0]), np.ones(3), 2.0), 0)
    for keyframe in keyframes[6:]:
        state.observe(keyframe)
    new = copy_of_submap(own_submap(state, 5), FrameId(0, 0), Sim3.identity(), 0)
    joint = with_new_keyframes(old, new)
    for k in range(SEEN):
        expected = Sim3(so3_exp([0, 1, 0]), np.ones(3), 2.0) @ state.pose(k)
        np.testing.assert_allclose(joint.pose(k).matrix(), expected.matrix(), atol=1e-6)
