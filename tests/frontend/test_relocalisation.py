"""A camera that is blinded, kidnapped or carried away, in rendered rooms with exact truth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import room

from maslam.backend.geometry import se3, se3_inverse, so3_exp, umeyama
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import LostConfig, OdometryConfig
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.frames import Frame
from maslam.frontend.odometry import FrameResult, Odometry, OdometryResult, TrackingState
from maslam.frontend.tracking.relocalisation import Relocaliser
from maslam.frontend.tracking.track import Segment
from maslam.frontend.vocabulary.vocabulary import Vocabulary

WALK = room.walk(60)
HOME, ELSEWHERE = 3, 77  # seeds of two rooms
Shot = tuple[int, np.ndarray]
"""Seed of a room and ``T_W_C`` in it."""


@cache
def scene_of(seed: int) -> room.Room:
    return room.Room(seed)


@cache
def vocabulary() -> Vocabulary:
    return Vocabulary.load()


@cache
def rendered(kind: RigKind, seed: int, pose: bytes, index: int) -> Frame:
    return scene_of(seed).frame(index, np.frombuffer(pose).reshape(4, 4), kind)


def film(
    kind: RigKind, shots: Sequence[Shot | None], change: Callable[[int, Frame], Frame] = lambda _, frame: frame
) -> tuple[OdometryResult, list[FrameResult], Odometry]:
    """Drive through the shots; None is a frame that never came."""
    odometry = Odometry(room.rig(kind), OdometryConfig(), vocabulary())
    results = []
    for i, shot in enumerate(shots):
        if shot is not None:
            results.append(odometry.process(change(i, rendered(kind, shot[0], shot[1].tobytes(), i))))
    return odometry.finish(), results, odometry


def home(first: int = 0, last: int = 60) -> list[Shot]:
    return [(HOME, T) for T in WALK[first:last]]


def error_m(trajectory: Trajectory, shots: Sequence[Shot], with_scale: bool = False) -> float:
    """RMSE of position after alignment."""
    truth = np.array([shots[i][1][:3, 3] for i in np.rint(trajectory.stamps_ns / 1e8).astype(int)])
    aligned = umeyama(truth, trajectory.centres, with_scale) @ trajectory.centres
    return float(np.sqrt(((aligned - truth) ** 2).sum(axis=1).mean()))


def black(image: np.ndarray) -> np.ndarray:
    return np.zeros_like(image)


def blurred(image: np.ndarray) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), 8.0)


def between(first: int, last: int, spoil: Callable[[np.ndarray], np.ndarray]) -> Callable[[int, Frame], Frame]:
    def change(index: int, frame: Frame) -> Frame:
        if not first <= index < last:
            return frame
        return replace(frame, image=spoil(frame.image), right=None if frame.right is None else spoil(frame.right))

    return change


@pytest.mark.parametrize(
    ("kind", "spoil", "count"),
    [
        (RigKind.STEREO, black, 1),
        (RigKind.STEREO, black, 15),
        (RigKind.MONO, black, 5),
        (RigKind.RGBD, blurred, 15),
    ],
)
def test_a_blinded_camera_is_found_again_in_its_own_track(
    kind: RigKind, spoil: Callable[[np.ndarray], np.ndarray], count: int
) -> None:
    result, frames, _ = film(kind, home(), between(25, 25 + count, spoil))
    assert frames[25].state is TrackingState.LOST and "need" in frames[25].reason
    assert len(result.tracks) == 1 and frames[25 + count].T_W_C is not None
    interval = result.lost[-1]
    assert (interval.first_ns, interval.frames) == (2_500_000_000, count)
    assert interval.last_ns == (24 + count) * 100_000_000
    assert error_m(result.trajectories[0], home(), kind is RigKind.MONO) < 0.03


@pytest.mark.parametrize("kind", [RigKind.MONO, RigKind.STEREO])
def test_frames_that_never_came_leave_no_mark(kind: RigKind) -> None:
    shots: list[Shot | None] = [*home(0, 25), *[None] * 15, *home(40, 60)]
    result, frames, _ = film(kind, shots)
    assert len(result.tracks) == 1 and all(f.T_W_C is not None for f in frames[25:])
    assert error_m(result.trajectories[0], home(), kind is RigKind.MONO) < 0.03


@pytest.mark.parametrize("kind", list(RigKind))
def test_a_camera_carried_back_to_the_start_is_found_by_the_words_of_its_image(kind: RigKind) -> None:
    # It ends up looking at a wall that the walk did not show.
    turned = [(HOME, WALK[25] @ se3(so3_exp([0.0, 0.07 * i, 0.0]), [0.02 * i, 0.0, 0.0])) for i in range(1, 26)]
    aside = se3(so3_exp([0.0, 0.05, 0.02]), [0.08, 0.03, 0.05])
    shots = [*home(0, 26), *turned, *((HOME, T @ aside) for T in WALK[16:24])]
    result, frames, _ = film(kind, shots)
    assert len(result.tracks) == 1 and result.stats["relocalised"] == 1
    assert all(f.T_W_C is not None for f in frames[-8:])
    assert error_m(result.trajectories[0], shots, kind is RigKind.MONO) < 0.04


@pytest.mark.parametrize("kind", [RigKind.STEREO, RigKind.RGBD])
def test_a_camera_that_wakes_up_elsewhere_begins_another_track(kind: RigKind) -> None:
    shots = [*home(0, 30), *((ELSEWHERE, T) for T in WALK[30:])]
    result, frames, _ = film(kind, shots)
    wait = LostConfig().relocalise_frames
    assert len(result.tracks) == 2
    assert [f.state for f in frames[30 : 30 + wait]] == [TrackingState.LOST] * wait
    interval = result.lost[-1]
    assert (interval.first_ns, interval.frames) == (3_000_000_000, wait)
    assert "agree on a pose" in interval.reason
    assert frames[30 + wait].is_keyframe and frames[30 + wait].state is TrackingState.TRACKING
    assert len(result.trajectories[1]) == 30 - wait
    for trajectory, vo in zip(result.trajectories, result.tracks, strict=True):
        assert error_m(trajectory, shots) < 0.02
        np.testing.assert_allclose(vo.poses[0], np.eye(4), atol=1e-12)


@pytest.mark.parametrize("away", [8, 18])
def test_a_short_trip_elsewhere_does_not_end_the_track(away: int) -> None:
    # After the longer one a map of the other room had begun, but is too young to be a track.
    shots = [*home(0, 30), *((ELSEWHERE, T) for T in WALK[30 : 30 + away]), *home(30 + away, 60)]
    result, frames, _ = film(RigKind.STEREO, shots)
    assert len(result.tracks) == 1 and result.lost[-1].frames == away
    assert frames[30 + away].T_W_C is not None
    assert error_m(result.trajectories[0], shots) < 0.02


def test_a_long_trip_elsewhere_makes_three_tracks_in_order_of_time() -> None:
    shots = [*home(0, 20), *((ELSEWHERE, T) for T in WALK[:32]), *home(20, 46)]
    result, _, _ = film(RigKind.STEREO, shots)
    assert len(result.tracks) == 3
    stamps = np.concatenate([t.stamps_ns for t in result.trajectories])
    assert (np.diff(stamps) > 0).all()
    assert all(error_m(t, shots) < 0.02 for t in result.trajectories)
    assert len(stamps) + sum(lost.frames for lost in result.lost) == len(shots)


@cache
def mapped() -> tuple[Segment, Odometry]:
    odometry = Odometry(room.rig(RigKind.STEREO), OdometryConfig(), vocabulary())
    for i, (seed, T) in enumerate(home(0, 50)):
        odometry.process(scene_of(seed).frame(i, T, RigKind.STEREO))
    assert odometry._segment is not None
    return odometry._segment, odometry


def search(shot: Shot) -> tuple[np.ndarray | None, str, list[int]]:
    """Pose relative to the walk's first, the reason where there is none, and the key-frames tried."""
    segment, odometry = mapped()
    relocaliser = Relocaliser(segment, odometry.ranging, odometry.config, vocabulary())
    frame = scene_of(shot[0]).frame(0, shot[1], RigKind.STEREO)
    before = segment.tracker
    segment.tracker = type(before)(odometry.ranging, odometry.config)
    try:
        found = relocaliser.search(frame)
        tried = relocaliser.candidates(relocaliser._describe(frame))
    finally:
        segment.tracker = before
    return found.T_C_W, found.reason, tried


@pytest.mark.parametrize("index", [2, 15, 31, 48])
@pytest.mark.parametrize("aside", [(0.0, 0.0), (0.15, 0.1)])
def test_poses_found_are_the_cameras(index: int, aside: tuple[float, float]) -> None:
    T_W_C = WALK[index] @ se3(so3_exp([0.0, aside[1], 0.0]), [aside[0], 0.0, 0.0])
    T_C_W, reason, tried = search((HOME, T_W_C))
    assert T_C_W is not None, reason
    expected = se3_inverse(WALK[0]) @ T_W_C
    assert np.linalg.norm(se3_inverse(T_C_W)[:3, 3] - expected[:3, 3]) < 0.03
    # The latest key-frame is tried first, then those that look alike: near the camera.
    keyframes = mapped()[0].map.keyframes
    apart = [np.linalg.norm(keyframes[n].T_W_C[:3, 3] - expected[:3, 3]) for n in tried]
    nearest = min(np.linalg.norm(k.T_W_C[:3, 3] - expected[:3, 3]) for k in keyframes.values() if k.stays)
    assert min(apart) < nearest + 0.8


def test_no_other_room_and_no_other_wall_is_taken_for_the_map() -> None:
    back = WALK[25] @ se3(so3_exp([0.0, np.pi, 0.0]), np.zeros(3))
    for shot in [(HOME, back), *((seed, WALK[i]) for seed in (ELSEWHERE, 78) for i in (0, 30))]:
        T_C_W, reason, _ = search(shot)
        assert T_C_W is None and "need" in reason
