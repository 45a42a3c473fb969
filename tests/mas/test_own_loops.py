"""Own loops: which key-frames are compared, and what odometry's drift allows a loop to say."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of

from maslam.backend.geometry import Sim3, se3_inverse
from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.config import MasConfig
from maslam.mas.place_recognition.own_loops import candidates_below, implausible
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import make_agents, run
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import KeyFrame, keyframes_of
from maslam.mas.state.place_match import Match, MatchEnd

DEFAULT = preset("default")
PAUSE_S = 100.0
LAP = circuit(0.0, 130.0, side_m=30.0, radius_m=6.0)


def paused(sequence: AgentSequence, frame: int) -> AgentSequence:
    """The same drive with a pause of a hundred seconds before a frame."""
    after_ns, pause_ns = int(sequence.trajectory.stamps_ns[frame]), round(PAUSE_S * 1e9)

    def later(stamps_ns: np.ndarray) -> np.ndarray:
        return stamps_ns + pause_ns * (stamps_ns >= after_ns)

    def moved(trajectory: Trajectory) -> Trajectory:
        return Trajectory(later(trajectory.stamps_ns), trajectory.poses)

    truth = sequence.groundtruth
    return replace(
        sequence,
        tracks=tuple(replace(t, stamps_s=later(np.rint(t.stamps_s * 1e9).astype(np.int64)) / 1e9)
                     for t in sequence.tracks),
        places=replace(sequence.places, stamps_ns=later(np.asarray(sequence.places.stamps_ns))),
        trajectory=moved(sequence.trajectory),
        groundtruth=None if truth is None else moved(truth),
    )  # fmt: skip


def by_age_alone(config: MasConfig) -> MasConfig:
    return config.model_copy(update={"places": config.places.model_copy(update={"own_apart_keyframes": None})})


def own_pairs(folder: Path) -> list[tuple[int, int]]:
    with open(folder / "matches.csv", newline="", encoding="utf-8") as file:
        rows = [r for r in csv.DictReader(file) if r["query_agent"] == r["match_agent"]]
    return [(int(r["query_keyframe"]), int(r["match_keyframe"])) for r in rows]


def test_neighbours_on_both_sides_of_a_pause_are_no_loop(tmp_path: Path) -> None:
    alone = paused(make_sequence(make_world(3), circuit(0.0, 40.0), 3, 0), 45)
    assert np.diff(alone.trajectory.stamps_ns).max() == pytest.approx((PAUSE_S + 0.1) * 1e9)
    summary = run(manifest_of([alone]), [alone], DEFAULT, tmp_path / "run")
    assert summary.matches.own_loops == 0 and own_pairs(tmp_path / "run") == []
    # Age alone, as the predecessor has it, takes neighbours for loops.
    old = run(manifest_of([alone]), [alone], by_age_alone(DEFAULT), tmp_path / "old")
    assert old.matches.own_loops > 0 and min(q - m for q, m in own_pairs(tmp_path / "old")) < 5


def test_a_camera_that_comes_back_closes_its_loop_with_a_pause_or_without(tmp_path: Path) -> None:
    whole = make_sequence(make_world(2), LAP, 2, 0)
    quick = DEFAULT.model_copy(update={"places": DEFAULT.places.model_copy(update={"own_age_keyframes": None,
                                                                                   "own_age_s": 20.0})})  # fmt: skip
    for name, alone in (("whole", whole), ("paused", paused(whole, 120))):
        summary = run(manifest_of([alone]), [alone], quick, tmp_path / name)
        assert summary.matches.own_loops >= 2 and summary.matches.false_accepted == 0
        assert min(q - m for q, m in own_pairs(tmp_path / name)) >= 15


def state_of(keyframes: list[KeyFrame], config: MasConfig, sequence: AgentSequence) -> AgentState:
    state = make_agents(manifest_of([sequence]), [sequence], config)[0].state
    for keyframe in keyframes:
        state.observe(keyframe)
    return state


def test_candidates_are_those_that_the_rule_says() -> None:
    """Key-frames at random times, of random depth, in two tracks: each pair is judged here by itself."""
    rng, sequence = np.random.default_rng(1), make_sequence(make_world(3), circuit(0.0, 90.0), 3, 0, cuts=(60,))
    made = keyframes_of(sequence)
    times = np.cumsum(rng.choice([0.3, 0.5, 12.0], len(made), p=[0.6, 0.3, 0.1]))
    keyframes = [
        replace(k, time_ns=round(t * 1e9), depth=float(rng.uniform(0.5, 8.0))) for k, t in zip(made, times, strict=True)
    ]
    state = state_of(keyframes, DEFAULT, sequence)
    config, by_path = state.config.places, 0
    for one in keyframes:
        candidates = []
        for other in keyframes[: one.index]:
            gap, age_s = one.index - other.index, (one.time_ns - other.time_ns) / 1e9
            way = sum(
                float(np.linalg.norm(b.T_T_C[:3, 3] - a.T_T_C[:3, 3]))
                for a, b in zip(keyframes[other.index :], keyframes[other.index + 1 : one.index + 1], strict=False)
                if a.track == b.track
            )
            left = gap >= 15 or way >= 4.0 * one.depth - 1e-9
            by_path += one.track == other.track and age_s >= config.own_age_s and left and gap < 15
            if one.track != other.track or gap >= 40 or (age_s >= config.own_age_s and left):
                candidates.append(other.index)
        assert candidates == list(range(candidates_below(state, one)))
    assert by_path > 10


# -- what one camera's loop says of its unit ---------------------------------------------------------------------------


def loop(state: AgentState, log_scale: float, sigma: float | None, steps: int = 60) -> Match:
    """A loop that says where odometry is, with another unit."""
    query, match = state.keyframes[70], state.keyframes[70 - steps]
    T = se3_inverse(match.T_T_C) @ query.T_T_C
    ends = [MatchEnd(k.track, k.T_T_C, state.travelled[k.index]) for k in (query, match)]
    transform = Sim3(T[:3, :3], T[:3, 3], float(np.exp(log_scale)))
    return Match(MatchId(0, query.index, 0, match.index), *ends, transform, np.eye(6), 60, match.depth, sigma)


@pytest.mark.parametrize(("log_scale", "sigma", "steps", "possible"), [
    (0.0, 0.01, 60, True),
    (0.06, 0.01, 60, True),  # a walk of 0.5 % a step: 0.039 in sixty
    (-0.12, 0.01, 60, True),
    (0.20, 0.01, 60, False),
    (-0.20, 0.01, 60, False),
    (0.12, 0.01, 16, False),  # 0.02 in sixteen
    (0.20, 0.2, 60, True),  # a match that hardly tells
])  # fmt: skip
def test_a_loop_may_say_of_the_unit_what_its_drift_allows(
    log_scale: float, sigma: float, steps: int, possible: bool
) -> None:
    sequence = make_sequence(make_world(2), LAP, 2, 0, scale=0.7)
    state = state_of(keyframes_of(sequence), DEFAULT, sequence)
    objection = implausible(state, loop(state, log_scale, sigma, steps))
    assert (objection == "") == possible, objection
    assert possible or objection.startswith("beyond the unit's drift: ")


def test_metres_do_not_drift_and_tracks_have_units_of_their_own() -> None:
    metric = make_sequence(make_world(2), LAP, 2, 0)
    state = state_of(keyframes_of(metric), DEFAULT, metric)
    assert implausible(state, loop(state, 0.0, None)) == ""
    cut = make_sequence(make_world(2), LAP, 2, 0, scale=0.7, cuts=(120,))
    state = state_of(keyframes_of(cut), DEFAULT, cut)
    assert implausible(state, loop(state, np.log(1.5), 0.01)) == ""


@pytest.mark.parametrize(("size", "right"), [(1.0, True), (1.6, False)])
def test_a_place_of_another_size_is_no_loop(size: float, right: bool) -> None:
    """The camera comes back to where everything is as it was, or 1.6 times as large, as in a model of the place."""
    sequence = make_sequence(make_world(2), LAP, 2, 0, scale=0.7, drifting=0.0)
    agent = make_agents(manifest_of([sequence]), [sequence], preset("maslam"))[0]
    for keyframe in keyframes_of(sequence):
        later = keyframe.index >= 70
        points = (keyframe.points_C * size).astype(np.float32) if later else keyframe.points_C
        agent.observe(replace(keyframe, points_C=points, depth=keyframe.depth * (size if later else 1.0)))
        agent.tick(keyframe.time_ns)
    own = [c for c in agent.candidates.by_id.values() if c.check.inliers >= 20]
    assert len(own) >= 2
    assert all(c.check.verified == right for c in own)
    assert right or {c.check.reason for c in own} == {"beyond the unit's drift"}
