"""Where a map stands to place matches, on made-up maps whose answers follow from geometry (equations 3.1 to 3.6)."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from factory import circuit, heading, make_sequence, make_world, manifest_of

from maslam.backend.geometry import Array, Sim3, se3_exp, se3_inverse
from maslam.mas.map_exchange.admission import Admission, admit, aligned, recheck
from maslam.mas.map_exchange.evidence_checks import best_motion, evidence_of, tolerance, witnesses
from maslam.mas.map_exchange.map_copy import MapCopy, SoldVersion, with_new_keyframes
from maslam.mas.map_exchange.purchase import ArrivedMap
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import FrameId, MatchId
from maslam.mas.simulation import make_agents
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.place_match import Match, MatchEnd, ReportedMatch

WORLD = make_world(3, points=10_000)
MOTION = Sim3.from_se3(se3_exp([3.0, 0.5, -2.0, 0.02, 0.3, -0.05]))
ROAD = np.array([heading(0.5 * k, 2.0 * k, 0.1 * k) for k in range(8)])


def holder(scale: float = 1.0, **merge: object) -> AgentState:
    """Agent 0 of three with eight key-frames, where it believes they are: the circuit itself."""
    sequences = [make_sequence(WORLD, circuit(0.0, 12.0), 3, a, scale, drifting=0.0) for a in range(3)]
    config = preset("default")
    config = config.model_copy(update={"merge": config.merge.model_copy(update=merge)})
    agent = make_agents(manifest_of(sequences), sequences, config)[0]
    for keyframe in keyframes_of(sequences[0]):
        agent.state.observe(keyframe)
    return agent.state


def held(
    owner: int,
    poses: Array,
    first: int = 0,
    placement: Sim3 | None = None,
    matches: tuple[ReportedMatch, ...] = (),
    version: int = 1,
) -> MapCopy:
    """A copy with these poses in its own coordinates and no points."""
    count = len(poses)
    return MapCopy(
        SoldVersion(owner, owner, version),
        (owner,),
        FrameId(owner, 0),
        placement or Sim3.identity(),
        np.arange(first, first + count),
        np.arange(count),
        poses,
        np.ones(count),
        np.zeros(0, dtype=np.int64),
        np.zeros((0, 3)),
        None,
        matches,
    )


def judged(
    copy: MapCopy, old: MapCopy | None, state: AgentState, others: dict[int, MapCopy], placed_by: MatchId | None = None
) -> Admission:
    """The verdict on a copy that comes in."""
    return admit(ArrivedMap(copy, placed_by), old, state, others)


def matched(state: AgentState, own: int, other: int, index: int, T_O_other: Array, asked: bool) -> MatchId:
    """A true match of an own key-frame with another agent's, which stands at ``T_O_other``; from either side."""
    T_own_other = Sim3.from_se3(se3_inverse(state.poses[own]) @ T_O_other)
    identity = MatchId(0, own, other, index) if asked else MatchId(other, index, 0, own)
    T_M_Q = T_own_other.inverse() if asked else T_own_other
    ends = MatchEnd(0, np.eye(4), 0.0), MatchEnd(0, np.eye(4), 0.0)
    state.verified[identity] = Match(identity, *ends, T_M_Q, np.eye(6), 50, 10.0)
    state.accepted.add(identity)
    return identity


@pytest.mark.parametrize("asked", [False, True])
def test_a_map_in_its_place_agrees_with_matches_although_the_cameras_stand_apart(asked: bool) -> None:
    state = holder()
    matched(state, 2, 1, 5, ROAD[5], asked)
    how = evidence_of(witnesses(held(1, ROAD), state, {}))
    assert how is not None and how.matches == 1
    assert how.worst_m < 1e-9 and how.worst_deg < 1e-5
    assert np.linalg.norm(state.poses[2][:3, 3] - ROAD[5][:3, 3]) > 3.0, "the thesis's 3.3 would see this distance"


@pytest.mark.parametrize("asked", [False, True])
def test_a_map_out_of_place_is_off_by_as_much_as_it_was_moved(asked: bool) -> None:
    state = holder()
    matched(state, 2, 1, 5, ROAD[5], asked)
    (witness,) = witnesses(held(1, ROAD, placement=MOTION), state, {})
    moved = MOTION @ ROAD[5][:3, 3]
    assert witness.metres == pytest.approx(np.linalg.norm(moved - ROAD[5][:3, 3]))
    angle = np.degrees(np.arccos((np.trace(MOTION.rotation) - 1) / 2))
    assert witness.degrees == pytest.approx(angle, abs=1e-6)


@pytest.mark.parametrize("asked", [False, True])
def test_alignment_is_equation_3_4_and_the_rest_follows_by_relative_poses(asked: bool) -> None:
    state = holder(consistency_m=0.5)
    identity = matched(state, 2, 1, 4, ROAD[4], asked)
    wrong = held(1, ROAD, placement=MOTION)
    laid = aligned(wrong, witnesses(wrong, state, {}), state)
    right = laid.copy
    assert laid.aligned_by == identity and laid.witnesses[0].metres < 1e-9
    T_M_Q = state.verified[identity].T_M_Q.se3()
    chain = {4: state.poses[2] @ (se3_inverse(T_M_Q) if asked else T_M_Q)}
    relative = [se3_inverse(a) @ b for a, b in pairwise(wrong.poses)]
    for k in range(5, 8):
        chain[k] = chain[k - 1] @ relative[k - 1]  # equation 3.5
    for k in range(3, -1, -1):
        chain[k] = chain[k + 1] @ se3_inverse(relative[k])  # equation 3.6
    np.testing.assert_allclose(right.poses, [chain[k] for k in range(8)], atol=1e-9)
    np.testing.assert_allclose(right.poses, ROAD, atol=1e-9)


def test_a_map_within_the_threshold_is_left_alone() -> None:
    state = holder(consistency_m=100.0)
    matched(state, 2, 1, 4, ROAD[4], True)
    wrong = held(1, ROAD, placement=MOTION)
    assert aligned(wrong, witnesses(wrong, state, {}), state).copy is wrong


def test_of_several_matches_the_one_that_the_others_agree_with_lays_the_map() -> None:
    state = holder()
    matched(state, 0, 1, 1, MOTION.transform_poses(ROAD[1]), True)  # a false one, and the first
    good = [matched(state, own, 1, 4 + own, ROAD[4 + own], True) for own in (1, 2, 3)]
    motion, by = best_motion(witnesses(held(1, ROAD, placement=MOTION), state, {}))
    assert by == good[0]
    np.testing.assert_allclose((motion @ MOTION).matrix(), np.eye(4), atol=1e-9)


def test_a_map_is_checked_against_other_maps_by_matches_that_came_with_either() -> None:
    state = holder()
    further = np.array([heading(10.0 + k, 3.0 * k, 0.2) for k in range(5)])
    T_M_Q = Sim3.from_se3(se3_inverse(ROAD[6]) @ further[2])
    match = ReportedMatch(MatchId(2, 2, 1, 6), T_M_Q)
    for first, second in (((match,), ()), ((), (match,))):
        one, two = held(1, ROAD, matches=first), held(2, further, matches=second)
        how = evidence_of(witnesses(two, state, {1: one, 2: two}))
        assert how is not None and how.worst_m < 1e-9
        how = evidence_of(witnesses(two.moved(MOTION), state, {1: one}))
        assert how is not None and how.worst_m == pytest.approx(
            np.linalg.norm(MOTION @ further[2][:3, 3] - further[2][:3, 3])
        )


def test_a_map_in_common_coordinates_is_not_laid_on_another_copy() -> None:
    """The other copy may be older; once moved to it, each would be moved to the next."""
    state = holder(consistency_m=2.0)
    match = ReportedMatch(MatchId(2, 3, 1, 3), Sim3.identity())
    older = held(2, ROAD, placement=Sim3(np.eye(3), np.array([7.0, 0, 0])))
    strange = held(1, ROAD, matches=(match,))
    common = replace(strange, frame=state.frame)
    for one, moved in ((strange, True), (common, False)):
        verdict = judged(one, None, state, {2: older})
        assert verdict.copy is not None and (verdict.aligned_by is not None) == moved
    matched(state, 2, 1, 4, ROAD[4], True)
    assert judged(common.moved(MOTION), None, state, {2: older}).aligned_by is not None, "an own match counts"


def test_a_wrong_map_is_rejected_with_a_reason_and_a_right_one_is_not() -> None:
    state = holder(accuracy_m=5.0)
    for own, index in ((1, 2), (3, 6)):
        matched(state, own, 1, index, ROAD[index], True)
    verdict = judged(held(1, 3.0 * ROAD - 2.0 * np.eye(4)), None, state, {})
    assert verdict.copy is None
    assert verdict.reason.startswith("no place match agrees: 2 of them")
    assert judged(held(1, ROAD), None, state, {}).copy is not None


def test_the_match_that_placed_a_map_cannot_judge_it() -> None:
    """A map bent to a wrong shape agrees with the one match it was laid on; another tells."""
    state = holder(accuracy_m=5.0)
    bent = ROAD.copy()
    bent[4:, :3, 3] += [0.0, 0.0, 40.0]
    first = matched(state, 1, 1, 2, ROAD[2], True)
    assert judged(held(1, bent), None, state, {}, placed_by=first).copy is not None
    matched(state, 3, 1, 6, ROAD[6], True)
    assert judged(held(1, bent), None, state, {}, placed_by=first).copy is None


def test_a_match_of_the_key_frame_that_a_map_was_laid_on_does_not_judge_the_rest() -> None:
    """Both stand where the map begins; what is nine times too large is right there, and nowhere else."""
    wrong = ROAD.copy()
    wrong[:, :3, 3] = ROAD[2][:3, 3] + 9.0 * (ROAD[:, :3, 3] - ROAD[2][:3, 3])
    for share, kept in ((0.0, True), (0.5, False)):
        state = holder(accuracy_m=5.0, accuracy_share=share)
        first = matched(state, 1, 1, 2, ROAD[2], True)
        matched(state, 2, 1, 2, ROAD[2], True)
        matched(state, 3, 1, 6, ROAD[6], True)
        assert (judged(held(1, wrong), None, state, {}, placed_by=first).copy is not None) == kept
        assert judged(held(1, ROAD), None, state, {}, placed_by=first).copy is not None
    state = holder(accuracy_m=5.0, accuracy_share=0.5)
    first = matched(state, 1, 1, 2, ROAD[2], True)
    matched(state, 2, 1, 2, ROAD[2], True)
    assert judged(held(1, wrong), None, state, {}, placed_by=first).copy is not None, "nothing else is known"


def test_half_of_the_places_must_agree() -> None:
    bent = ROAD.copy()
    bent[4:, :3, 3] += [0.0, 0.0, 40.0]
    for others, kept in (((3,), True), ((3, 6), True), ((3, 6, 7), False)):
        state = holder(accuracy_m=5.0, accuracy_share=0.5)
        first = matched(state, 1, 1, 2, ROAD[2], True)
        for own, index in enumerate(others, start=2):
            matched(state, own, 1, index, ROAD[index], True)
        verdict = judged(held(1, bent), None, state, {}, placed_by=first)
        assert (verdict.copy is not None) == kept
    assert verdict.reason.startswith("few place matches agree: 1 of 3 of them")


def test_verified_matches_that_contradict_each_other_reject_a_map_without_accepted_ones() -> None:
    state = holder(accuracy_m=5.0, accuracy_share=0.5)
    for own, index, apart_m in ((1, 2, 0.0), (2, 4, 20.0), (3, 6, -30.0)):
        place = ROAD[index].copy()
        place[2, 3] += apart_m
        matched(state, own, 1, index, place, True)
    state.accepted.clear()
    assert judged(held(1, ROAD), None, state, {}).copy is None
    del state.verified[MatchId(0, 3, 1, 6)]
    assert judged(held(1, ROAD), None, state, {}).copy is not None, "two are too few to tell who is wrong"


def test_a_held_map_is_given_up_when_a_later_match_contradicts_it() -> None:
    state = holder(accuracy_m=5.0)
    bent = ROAD.copy()
    bent[4:, :3, 3] += [0.0, 0.0, 40.0]
    matched(state, 1, 1, 2, ROAD[2], True)
    assert recheck(held(1, bent), state, {}).copy is not None
    matched(state, 3, 1, 6, ROAD[6], True)
    assert recheck(held(1, bent), state, {}).copy is None
    assert recheck(held(1, ROAD), state, {}).copy is not None


def test_another_map_does_not_outvote_own_matches() -> None:
    state = holder(accuracy_m=5.0)
    matched(state, 1, 1, 2, ROAD[2], True)
    astray = held(2, ROAD, placement=Sim3(np.eye(3), np.array([500.0, 0, 0])))
    match = ReportedMatch(MatchId(2, 3, 1, 3), Sim3.identity())
    assert judged(held(1, ROAD, matches=(match,)), None, state, {2: astray}).copy is not None


def test_of_a_map_that_is_the_same_only_new_key_frames_are_taken() -> None:
    state = holder(redundancy_m=5.0)
    matched(state, 1, 1, 2, ROAD[2], True)
    slip = Sim3.from_se3(se3_exp([0.3, 0.0, 0.2, 0.0, 0.02, 0.0]))
    old = held(1, ROAD[1:5], first=1, placement=slip)
    verdict = judged(held(1, ROAD, version=2), old, state, {1: old})
    assert verdict.redundant and verdict.copy is not None
    np.testing.assert_allclose(verdict.copy.poses[1:5], old.poses, atol=1e-9)
    np.testing.assert_allclose(verdict.copy.poses, slip.transform_poses(ROAD), atol=1e-9)
    assert verdict.copy.version == 2
    far = held(1, ROAD[1:5], first=1, placement=Sim3(np.eye(3), np.array([20.0, 0, 0])))
    replaced = judged(held(1, ROAD, version=2), far, state, {1: far})
    assert not replaced.redundant and replaced.copy is not None
    np.testing.assert_allclose(replaced.copy.poses, ROAD, atol=1e-9)


def test_new_key_frames_of_a_map_with_nothing_in_common_replace_it() -> None:
    new = held(1, ROAD[5:], first=5)
    assert with_new_keyframes(held(1, ROAD[:5]), new) is new


def test_a_monocular_agent_measures_in_tenths_of_its_depth() -> None:
    for scale in (1.0, 0.02):
        state = holder(scale)
        depth = float(np.median([k.depth for k in state.keyframes]))
        expected = 5.0 if scale == 1.0 else 0.5 * depth
        assert tolerance(5.0, state) == pytest.approx(expected)
    assert tolerance(None, state) is None
