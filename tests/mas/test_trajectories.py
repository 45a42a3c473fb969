"""From key-frames to every frame: corrections are spread over odometry's steps."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from factory import FRAMES_A_KEYFRAME, circuit, make_sequence, make_world, manifest_of

from maslam.backend.geometry import Array, Sim3, rotation_angle_deg, se3, se3_inverse, so3_exp, so3_log
from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.policies.presets import preset
from maslam.mas.sequence import AgentSequence
from maslam.mas.simulation import make_agents
from maslam.mas.state.agent_state import AgentState
from maslam.mas.state.keyframe import keyframes_of
from maslam.mas.state.trajectories import frame_trajectory, keyframe_trajectory

WORLD = make_world(11, points=6000)
WAY = circuit(0.0, 90.0)


def bent(
    scale: float, unit_drift: float, cuts: tuple[int, ...] = (), drifting: float = 0.02
) -> tuple[AgentState, AgentSequence]:
    """An agent whose key-frames stand in the truth's frame, each with its unit as it is in truth: what a perfect
    optimisation makes of odometry that drifts and changes its unit."""
    sequence = make_sequence(WORLD, WAY, 11, scale=scale, cuts=cuts, unit_drift=unit_drift, drifting=drifting)
    state = make_agents(manifest_of([sequence]), [sequence], preset("maslam"))[0].state
    assert sequence.groundtruth is not None
    for keyframe in keyframes_of(sequence):
        state.observe(keyframe)
        row = int(sequence.groundtruth.nearest(np.array([keyframe.time_ns]), 1000)[0])
        state.poses[keyframe.index] = sequence.groundtruth.poses[row]
        # The step after it, or before it where it is the track's last frame.
        row -= row + 1 in (*cuts, len(WAY))
        own, true = (t.centres[row : row + 2] for t in (sequence.trajectory, sequence.groundtruth))
        state.units[keyframe.index] = float(np.linalg.norm(true[1] - true[0]) / np.linalg.norm(own[1] - own[0]))
    return state, sequence


def steps_of(trajectory: Trajectory) -> Array:
    return np.linalg.norm(np.diff(trajectory.centres, axis=0), axis=1)


def turns_of(poses: Array) -> Array:
    return np.array([float(rotation_angle_deg(a[:3, :3].T @ b[:3, :3])) for a, b in pairwise(poses)])


def test_key_frames_stand_where_they_are_estimated() -> None:
    state, sequence = bent(0.5, 0.004)
    frames, keyframes = frame_trajectory(state, sequence), keyframe_trajectory(state)
    rows = frames.nearest(keyframes.stamps_ns, 1000)
    np.testing.assert_allclose(frames.poses[rows], keyframes.poses, atol=1e-9)
    assert len(frames) == len(WAY)


@pytest.mark.parametrize(("scale", "unit_drift"), [(1.0, 0.0), (0.5, 0.0), (0.5, 0.006)])
def test_steps_are_odometrys_own_also_into_key_frames(scale: float, unit_drift: float) -> None:
    """True steps are all equal: those into a key-frame, and those between."""
    state, sequence = bent(scale, unit_drift)
    trajectory = frame_trajectory(state, sequence)
    assert within_a_tenth(steps_of(trajectory))
    assert np.abs(turns_of(trajectory.poses) - turns_of(WAY)).max() < 0.3


def test_a_correction_leaves_no_jump_at_key_frames() -> None:
    """Each key-frame stands a fifth farther from the one before than odometry says, and is turned by 3 degrees."""
    state, sequence = bent(1.0, 0.0, drifting=0.0)
    odometry = [k.T_T_C for k in state.keyframes]
    for k in range(1, len(odometry)):
        step = se3_inverse(odometry[k - 1]) @ odometry[k]
        longer = se3(step[:3, :3] @ so3_exp([0.0, 0.0, np.radians(3.0)]), 1.2 * step[:3, 3])
        state.poses[k] = state.poses[k - 1] @ longer
    trajectory = frame_trajectory(state, sequence)
    steps, last = steps_of(trajectory), FRAMES_A_KEYFRAME * (len(odometry) - 1)
    assert within_a_tenth(steps[:last])
    assert np.median(steps[:last]) == pytest.approx(1.2 * 0.5, rel=0.01)
    rolls = [so3_log(a[:3, :3].T @ b[:3, :3])[2] for a, b in pairwise(trajectory.poses[: last + 1])]
    np.testing.assert_allclose(np.degrees(rolls), 1.0, atol=0.1)


def within_a_tenth(steps: Array) -> bool:
    """Whether steps into key-frames are as long as the others."""
    ratio = steps[FRAMES_A_KEYFRAME - 1 :: FRAMES_A_KEYFRAME] / np.median(steps)
    low, middle, high = np.quantile(ratio, [0.05, 0.5, 0.95])
    return bool(low > 0.9 and abs(middle - 1.0) < 0.01 and high < 1.1)


def test_frames_between_are_as_right_as_the_key_frames_around() -> None:
    """Closed form: where both neighbours say the same of a frame, it stands there."""
    state, sequence = bent(0.5, 0.0)
    move = Sim3(so3_exp([0.1, 0.8, -0.3]), np.array([3.0, -1.0, 7.0]), 2.5)
    raw = sequence.trajectory
    for keyframe in state.keyframes:
        state.poses[keyframe.index] = move.transform_poses(keyframe.T_T_C)
        state.units[keyframe.index] = 2.5
    np.testing.assert_allclose(frame_trajectory(state, sequence).poses, move.transform_poses(raw.poses), atol=1e-7)


def test_a_correction_grows_with_the_way_and_with_the_time_where_there_is_none() -> None:
    """Two key-frames 3 frames apart, the second moved by 0.3: a frame a tenth of the way on moves by 0.03."""
    state, sequence = bent(1.0, 0.0)
    raw = sequence.trajectory.poses.copy()
    raw[:] = np.eye(4)
    raw[1:3, 2, 3], raw[3:, 2, 3] = [0.1, 0.4], 1.0
    for keyframe in state.keyframes:
        state.poses[keyframe.index] = raw[FRAMES_A_KEYFRAME * keyframe.index]
        if keyframe.index:
            state.poses[keyframe.index] = state.poses[keyframe.index].copy()
            state.poses[keyframe.index][0, 3] = 0.3 * min(keyframe.index, 2)
        state.units[keyframe.index] = 1.0
    moved = type(sequence)(**{**vars(sequence), "trajectory": Trajectory(sequence.trajectory.stamps_ns, raw)})
    x = frame_trajectory(state, moved).centres[:, 0]
    np.testing.assert_allclose(x[:7], [0.0, 0.03, 0.12, 0.3, 0.4, 0.5, 0.6], atol=1e-9)


def test_what_follows_the_last_key_frame_is_carried_by_it() -> None:
    """In its unit; a track does not reach into the next one."""
    state, sequence = bent(0.5, 0.006, cuts=(61,))
    assert [len(t) for t in sequence.tracks] == [21, 40]
    state.pieces = [type(p)(p.track, p.first, state.pieces[0].frame, False) for p in state.pieces]
    frames = frame_trajectory(state, sequence)
    assert len(frames) == len(WAY)
    raw, last = sequence.trajectory, len(WAY) - 1
    leader = FRAMES_A_KEYFRAME * 20
    assert leader == 60, "the last frame of the first track is a key-frame"
    np.testing.assert_allclose(frames.poses[60], state.poses[20], atol=1e-9)
    k = len(state.keyframes) - 1
    step = se3_inverse(raw.poses[61 + FRAMES_A_KEYFRAME * 39]) @ raw.poses[last]
    step[:3, 3] *= state.units[k]
    np.testing.assert_allclose(frames.poses[last], state.poses[k] @ step, atol=1e-9)
