"""One camera in a team: units of length of its own, which drift; and with agents that know the metre."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from factory import circuit, make_sequence, make_world, manifest_of, rescaled, travelled_by

from maslam.backend.geometry import Array, Sim3, se3_inverse, umeyama
from maslam.backend.trajectory_error import path_length
from maslam.frontend.files.trajectory import Trajectory, read_tum
from maslam.mas.evaluation.ground_truth import GroundTruthEvaluator
from maslam.mas.evaluation.summary import Summary
from maslam.mas.policies.presets import preset
from maslam.mas.protocol.ids import MatchId
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import make_agents, run
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.place_match import Match, MatchEnd

OURS = preset("maslam")


def written(folder: Path, sequence: AgentSequence) -> Trajectory:
    """The written trajectory, on the agent's own clock."""
    found = read_tum(folder / sequence.name / "trajectory.tum")
    return Trajectory(found.stamps_ns - sequence.start_ns, found.poses)


def truth_of(sequence: AgentSequence, trajectory: Trajectory) -> Array:
    assert sequence.groundtruth is not None
    rows = sequence.groundtruth.nearest(trajectory.stamps_ns, 1_000_000)
    assert (rows >= 0).all()
    return sequence.groundtruth.centres[rows]


def error_m(found: Array, truth: Array, with_scale: bool = True) -> float:
    aligned = umeyama(truth, found, with_scale) @ found
    return float(np.sqrt(((aligned - truth) ** 2).sum(axis=1).mean()))


def ran(sequences: list[AgentSequence], folder: Path) -> Summary:
    summary = run(manifest_of(sequences), sequences, OURS, folder)
    assert summary.matches.false_accepted == 0
    return summary


def test_an_own_loop_takes_the_drift_out_of_the_unit(tmp_path: Path) -> None:
    """Odometry is exact but for its unit, which grows by a tenth on the way round."""
    way = circuit(0.0, 130.0, side_m=30.0, radius_m=6.0)
    alone = make_sequence(make_world(2), way, 2, scale=0.7, drifting=0.0, unit_drift=0.001)
    summary = ran([alone], tmp_path / "run")
    assert summary.matches.own_loops >= 2
    before = error_m(alone.trajectory.centres, truth_of(alone, alone.trajectory))
    after = written(tmp_path / "run", alone)
    assert before > 0.5
    assert error_m(after.centres, truth_of(alone, after)) < 0.1 * before


def test_tracks_of_one_camera_are_joined_by_its_own_loop(tmp_path: Path) -> None:
    """It is carried back; the second track's unit is another one."""
    way = np.concatenate([circuit(0.0, 30.0), circuit(6.0, 30.0)])
    alone = make_sequence(make_world(3), way, 3, scale=0.4, cuts=(60,))
    summary = ran([alone], tmp_path / "run")
    assert summary.keyframes_placed == [40]
    whole = written(tmp_path / "run", alone)
    assert len(whole) == len(way)
    assert error_m(whole.centres, truth_of(alone, whole)) < 0.3


def test_tracks_of_one_camera_are_joined_by_another_agent(tmp_path: Path) -> None:
    world = make_world(3)
    whole = make_sequence(world, circuit(0.0, 45.0), 3, 0, scale=0.4)
    broken = make_sequence(world, circuit(0.0, 45.0), 3, 1, scale=0.6, cuts=(45,))
    summary = ran([whole, broken], tmp_path / "run")
    assert summary.groups == [[0, 1]] and summary.keyframes_placed == [30, 30]
    found = [written(tmp_path / "run", s) for s in (whole, broken)]
    together = np.concatenate([t.centres for t in found])
    truth = np.concatenate([truth_of(s, t) for s, t in zip((whole, broken), found, strict=True)])
    assert error_m(together, truth) < 0.4


@pytest.mark.parametrize("metric", [0, 1, 2])
def test_a_team_knows_the_metre_where_one_of_it_does(tmp_path: Path, metric: int) -> None:
    """Whatever its number: without any change of scale all three stand where they were, in one frame."""
    world, scales = make_world(4), [0.5, 0.2, 2.0]
    scales[metric] = 1.0
    starts = (0.0, 6.0, 12.0)
    sequences = [
        make_sequence(world, circuit(start, 36.0), 4, a, scale=scale)
        for a, (start, scale) in enumerate(zip(starts, scales, strict=True))
    ]
    summary = ran(sequences, tmp_path / "run")
    assert summary.groups == [[0, 1, 2]]
    found = [written(tmp_path / "run", s) for s in sequences]
    truth = [truth_of(s, t) for s, t in zip(sequences, found, strict=True)]
    assert error_m(np.concatenate([t.centres for t in found]), np.concatenate(truth), with_scale=False) < 0.4
    for trajectory, true in zip(found, truth, strict=True):
        assert path_length(trajectory.centres) == pytest.approx(path_length(true), rel=0.03)


@pytest.mark.parametrize("at", [3, 30, 55])
def test_a_match_is_held_against_the_truth_in_the_unit_of_its_key_frame(at: int) -> None:
    """Right but for 0.3 m, on either track, wherever the unit has drifted to."""
    way = circuit(0.0, 90.0)
    alone = make_sequence(make_world(3, points=6000), way, 3, scale=0.4, cuts=(60,), drifting=0.0, unit_drift=0.002)
    agent = make_agents(manifest_of([alone]), [alone], OURS)[0]
    for keyframe in keyframes_of(alone):
        agent.observe(keyframe)
    first = 3 * at
    scale = 0.4 * (1.0 if at < 20 else 1.5) * np.exp(0.002 * travelled_by(way[0 if at < 20 else 60 : first + 1])[-1])
    T_M_Q = se3_inverse(way[first]) @ way[first + 3]
    T_M_Q[2, 3] += 0.3
    end = MatchEnd(0, np.eye(4), 0.0)
    found = Sim3(T_M_Q[:3, :3], scale * T_M_Q[:3, 3])
    match = Match(MatchId(0, at + 1, 0, at), end, end, found, np.eye(6), 50, 10.0 * scale)
    error = GroundTruthEvaluator([alone]).match_error(match, [agent])
    assert error is not None and error.metres == pytest.approx(0.3, abs=0.04) and error.allowed_m > 2.0


def test_made_up_units_drift_as_they_should() -> None:
    """The factory's own promise: steps of the track over true ones are the scale there."""
    truth = circuit(0.0, 20.0)
    scales = np.exp(0.01 * travelled_by(truth))
    steps = np.linalg.norm(np.diff(rescaled(truth, scales)[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps / np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1), scales[:-1])
