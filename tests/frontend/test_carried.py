"""Something that fills the image and passes while the camera moves, or stops: nobody follows it. Truth: closed forms,
rendered rooms."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import room
from hidden import behind, side

from maslam.backend.geometry import se3, se3_inverse, umeyama
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.odometry import FrameResult, Odometry, OdometryResult
from maslam.frontend.tracking.carried import CARRIED, MotionSoFar, borne_out, hidden_still, proven
from maslam.frontend.tracking.shadow import Shadow
from maslam.frontend.tracking.standing import StandingCamera
from maslam.frontend.vocabulary.vocabulary import Vocabulary


def at(x: float, y: float = 0.0) -> np.ndarray:
    return se3_inverse(se3(np.eye(3), [x, y, 0.0]))


def moved(metric: bool, steps: list[float], dt: float = 0.1) -> MotionSoFar:
    """What is known of a camera after it made these steps along x, the last of which ended at 0."""
    so_far, x = MotionSoFar(metric), -sum(steps)
    for step in steps:
        so_far = so_far.after(at(x), at(x + step), dt)
        x += step
    return so_far


@pytest.mark.parametrize(
    ("x", "dt", "possible"),
    [(0.4, 0.1, True), (0.36, 0.1, True), (0.0, 0.1, False), (-0.4, 0.1, False), (0.8, 0.2, True), (0.0, 0.4, False)],
)
def test_a_step_is_possible_up_to_an_acceleration(x: float, dt: float, possible: bool) -> None:
    """4 m/s: to brake at 6 m/s^2 changes a step of 0.1 s by 6 cm."""
    assert moved(True, [0.4] * 8).step(at(0.0), at(x), dt, 0.1).possible == possible


def test_a_step_beyond_is_measured_in_metres_and_bounded_in_them() -> None:
    step = moved(True, [0.4] * 8).step(at(0.0), at(0.1, 0.4), 0.1, 4.0)
    assert step.beyond == pytest.approx(0.5) and step.bound == pytest.approx(6.0 * 0.1**2 + 0.005 * 4.0)
    assert not step.possible and "0.5 beyond the camera's motion, bound 0.08 m" in step.refusal.text


def test_poses_that_waver_widen_the_bound_of_a_step_but_not_with_time() -> None:
    wavers = moved(True, [0.4, 0.6] * 8)
    assert wavers.step(at(0.0), at(0.9), 0.1, 0.1).possible
    assert not moved(True, [0.4] * 8).step(at(0.0), at(0.9), 0.1, 0.1).possible
    later, sooner = wavers.step(at(0.0), at(5.0), 0.5, 0.1), moved(True, [0.4] * 8).step(at(0.0), at(5.0), 0.5, 0.1)
    assert later.bound == pytest.approx(sooner.bound)


def test_without_metres_the_cameras_own_motion_is_the_measure() -> None:
    assert MotionSoFar(False).step(at(0.0), at(9.0), 0.1, 1.0).possible
    assert moved(False, [1.0, 1.1, 1.0]).step(at(0.0), at(9.0), 0.1, 1.0).possible
    known = moved(False, [1.0, 1.1] * 8)
    assert known.step(at(0.0), at(1.2), 0.1, 1.0).possible and not known.step(at(0.0), at(2.0), 0.1, 1.0).possible


def test_points_are_proven_by_two_views_or_poses_and_bear_out_a_motion_where_most_agree() -> None:
    known = proven(np.array([1, 2, 1, 1]), np.array([0, 0, 1, 2]))
    assert known.tolist() == [False, True, False, True]
    expected = np.arange(100) < 80
    assert borne_out(np.arange(100) < 60, expected) and not borne_out(np.arange(100) < 59, expected)
    assert not borne_out(np.ones(3, dtype=bool), np.zeros(3, dtype=bool))
    assert hidden_still(24, 337).kind and "only 24 of 337 points found again, need 85" in hidden_still(24, 337).text
    assert not hidden_still(90, 337).kind and not hidden_still(100, 2000).kind


def passed(
    kind: RigKind, poses: np.ndarray, comes: int, x: float, step_px: float, width: int = 700, until: int = 1000
) -> tuple[OdometryResult, list[FrameResult], np.ndarray]:
    """A thing 0.7 m away and nearly as high as the image, its left end at ``x`` in frame ``comes``, moves on by so many
    pixels per frame, until frame ``until``. With the error ``(N,)`` of each frame's position, NaN without a pose."""
    scene, texture = room.Room(3), side(width, 228)
    odometry, results = Odometry(room.rig(kind), OdometryConfig(), Vocabulary.load()), []
    for i, pose in enumerate(poses):
        frame = scene.frame(i, pose, kind)
        if comes <= i < until:
            frame = behind(frame, texture, x + step_px * (i - comes), 6.0, 0.7)
        results.append(odometry.process(frame))
    result, error = odometry.finish(), np.full(len(poses), np.nan)
    trajectory = result.trajectories[0]
    index = np.rint(trajectory.stamps_ns / 1e8).astype(int)
    before = index < comes
    fit = umeyama(poses[index[before], :3, 3], trajectory.centres[before], kind is RigKind.MONO)
    error[index] = np.linalg.norm(fit @ trajectory.centres - poses[index, :3, 3], axis=1)
    return result, results, error


def doubtful(result: OdometryResult, frames: int) -> np.ndarray:
    stamps = np.round(np.arange(frames) * 1e8)
    return np.any(
        [(one.first_ns <= stamps) & (stamps <= one.last_ns) for one in result.doubtful] or [stamps < 0], axis=0
    )


@pytest.mark.parametrize("kind", [RigKind.STEREO, RigKind.RGBD])
@pytest.mark.parametrize(("x", "step_px"), [(-680.0, 60.0), (300.0, -50.0)])
def test_a_moving_camera_does_not_go_with_what_passes(kind: RigKind, x: float, step_px: float) -> None:
    """It moves by 1.3 to 1.6 m/s across the whole image, and by 2.3 m and more."""
    poses = room.walk(52)
    result, _, error = passed(kind, poses, 22, x, step_px)
    assert len(result.tracks) == 1
    silent = error[~doubtful(result, len(poses))]
    assert np.nanmax(silent) < 0.1 and np.nanmax(error) < 0.2
    assert np.isfinite(error[-5:]).all()


def test_a_pair_hidden_at_once_begins_no_track_by_what_hides_it() -> None:
    """It waits, six times as long as one that is lost otherwise, and is found where it stands."""
    poses = np.concatenate([room.walk(20), np.tile(room.walk(20)[-1:], (50, 1, 1))])
    result, frames, error = passed(RigKind.STEREO, poses, 20, -1500.0, 20.0, width=2000, until=55)
    assert len(result.tracks) == 1 and np.nanmax(error) < 0.1 and np.isfinite(error[-10:]).all()
    assert not np.isfinite(error[21:55]).any() and any(CARRIED in frame.kind for frame in frames[21:55])


@pytest.mark.slow
def test_a_pair_hidden_for_long_doubts_its_new_track_and_goes_back_to_its_own() -> None:
    """After 60 frames a new track begins by what hides it. It is doubted, and withdrawn when the view is back."""
    poses = np.concatenate([room.walk(20), np.tile(room.walk(20)[-1:], (90, 1, 1))])
    result, frames, error = passed(RigKind.STEREO, poses, 20, -2500.0, 20.0, width=3000, until=95)
    again = [frame for frame in frames[75:95] if frame.T_W_C is not None]
    assert len(again) >= 10 and sum(frame.doubt.startswith(CARRIED) for frame in again) == len(again)
    assert len(result.tracks) == 1 and np.nanmax(error) < 0.1 and np.isfinite(error[-5:]).all()
    assert any(kind == CARRIED for one in result.lost for kind, _ in one.kinds)


@pytest.mark.parametrize(
    ("sudden", "rested", "frames", "doubted"),
    [(True, False, 60, True), (False, True, 60, True), (True, False, 61, False), (False, False, 1, False)],
)
def test_a_track_of_one_camera_is_doubted_for_some_frames_after_a_sudden_loss(
    sudden: bool, rested: bool, frames: int, doubted: bool
) -> None:
    def track(length: int) -> Any:
        ranging = SimpleNamespace(rig=room.rig(RigKind.MONO))
        return SimpleNamespace(
            tracker=SimpleNamespace(ranging=ranging, standing=StandingCamera(rested=rested)), frames=[0] * length
        )

    shadow = Shadow.over(track(9), track(1), sudden)
    assert (shadow is not None and shadow.doubt(track(frames)).kind == CARRIED) == doubted
    assert shadow is None or not shadow.refusal(track(1)).kind
