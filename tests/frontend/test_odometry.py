"""The whole odometry on rendered rooms with exact truth: accuracy, losses, refusals, the five files' content,
determinism."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
import room

from maslam.backend.geometry import se3, se3_inverse, so3_exp, umeyama
from maslam.frontend.cameras.models import Rig, RigKind
from maslam.frontend.config import KeyframeConfig, OdometryConfig
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.frames import Frame, PutOff
from maslam.frontend.odometry import FrameResult, Odometry, OdometryResult, TrackingState
from maslam.frontend.stopwatch import TimedStage
from maslam.frontend.vocabulary.vocabulary import BagOfWords, Vocabulary

Change = Callable[[int, Frame], Frame | None]
WALK = room.walk(60)


class Words:
    """A vocabulary that is easy to check: words are the first two bytes; to find a lost camera, the shipped one."""

    def words(self, descriptors: np.ndarray) -> np.ndarray:
        return descriptors[:, :2].astype(np.int32)

    def bag(self, descriptors: np.ndarray) -> BagOfWords:
        return Vocabulary.load().bag(descriptors)


def as_is(index: int, frame: Frame) -> Frame:
    return frame


@cache
def scene_of(seed: int) -> room.Room:
    return room.Room(seed)


@cache
def rendered(kind: RigKind, offset_px: float, seed: int, index: int) -> Frame:
    return scene_of(seed).frame(index, WALK[index], kind, disparity_offset_px=offset_px)


@cache
def walked(kind: RigKind) -> tuple[OdometryResult, list[FrameResult]]:
    return track(kind)[:2]


def track(
    kind: RigKind,
    poses: np.ndarray = WALK,
    change: Change = as_is,
    config: OdometryConfig | None = None,
    offset_px: float = 0.0,
    count: int = 60,
    seed: int = 3,
) -> tuple[OdometryResult, list[FrameResult], Odometry]:
    odometry = Odometry(room.rig(kind), config or OdometryConfig(), Words())
    results = []
    for i in range(min(count, len(poses))):
        frame = change(
            i, rendered(kind, offset_px, seed, i) if poses is WALK else scene_of(seed).frame(i, poses[i], kind)
        )
        if frame is not None:
            results.append(odometry.process(frame))
    return odometry.finish(), results, odometry


def error_m(trajectory: Trajectory, poses: np.ndarray, with_scale: bool) -> float:
    truth = poses[np.rint(trajectory.stamps_ns / 1e8).astype(int)][:, :3, 3]
    aligned = umeyama(truth, trajectory.centres, with_scale) @ trajectory.centres
    return float(np.sqrt(((aligned - truth) ** 2).sum(axis=1).mean()))


def blank(first: int, last: int) -> Change:
    def change(index: int, frame: Frame) -> Frame:
        if not first <= index < last:
            return frame
        black = np.zeros_like(frame.image)
        depth = None if frame.depth_m is None else np.zeros_like(frame.depth_m)
        return replace(frame, image=black, right=None if frame.right is None else black, depth_m=depth)

    return change


@pytest.mark.parametrize("kind", list(RigKind))
def test_a_walk_through_a_room_is_tracked_to_half_a_percent(kind: RigKind) -> None:
    result, frames = walked(kind)
    length = np.linalg.norm(np.diff(WALK[:, :3, 3], axis=0), axis=1).sum()
    assert len(result.tracks) == 1 and len(result.trajectories[0]) >= 50
    assert error_m(result.trajectories[0], WALK, kind is RigKind.MONO) < 0.005 * length
    assert all(f.T_W_C is not None or f.reason for f in frames)
    waiting = [f for f in frames if f.T_W_C is None]
    assert sum(lost.frames for lost in result.lost) == 60 - len(result.trajectories[0])
    assert all(f.state is TrackingState.STARTING for f in waiting)


@pytest.mark.parametrize("kind", list(RigKind))
def test_the_five_files_fit_together_and_the_points_lie_where_they_were_seen(kind: RigKind) -> None:
    result, _ = walked(kind)
    vo, indices = result.tracks[0], result.keyframe_indices[0]
    assert len(vo) == len(indices) >= 5
    np.testing.assert_allclose(vo.stamps_s, indices / 10.0, atol=1e-9)
    np.testing.assert_allclose(vo.poses[0], np.eye(4), atol=1e-12)
    kf, pt = vo.observations.T
    assert np.lexsort((pt, kf)).tolist() == list(range(len(kf)))
    assert len(np.unique(vo.observations, axis=0)) == len(vo.observations)
    assert set(pt.tolist()) == set(range(len(vo.points)))
    assert vo.descriptors.shape == (len(kf), 32) and vo.descriptors.any(axis=1).all()
    np.testing.assert_array_equal(vo.words, vo.descriptors[:, :2])
    assert np.median(np.bincount(kf)) > 80
    # In the room's own frame every point must lie on a wall.
    at = result.trajectories[0]
    truth = WALK[np.rint(at.stamps_ns / 1e8).astype(int)]
    S = umeyama(truth[:, :3, 3], at.centres, kind is RigKind.MONO)
    off_wall = np.abs(np.abs(S @ vo.points) - room.HALF_SIZE_M).min(axis=1)
    assert np.median(off_wall) < 0.03


def test_key_frames_keep_their_distance() -> None:
    result, _ = walked(RigKind.STEREO)
    steps = np.linalg.norm(np.diff(result.tracks[0].poses[:, :3, 3], axis=0), axis=1)
    assert np.median(steps) > 0.15


def test_a_hidden_disparity_offset_is_estimated_and_can_be_left_alone() -> None:
    result, _, _ = track(RigKind.STEREO, offset_px=1.2)
    assert result.stats["disparity_offset_px"] == pytest.approx(1.2, abs=0.1)
    assert error_m(result.trajectories[0], WALK, False) < 0.02
    fixed = OdometryConfig.model_validate({"stereo": {"estimate_calibration": False}})
    without, _, _ = track(RigKind.STEREO, offset_px=1.2, config=fixed)
    assert without.stats["disparity_offset_px"] == 0.0
    assert not without.tracks or error_m(without.trajectories[0], WALK, False) > 2 * error_m(
        result.trajectories[0], WALK, False
    )


def test_a_hidden_lens_is_estimated_by_one_camera() -> None:
    lens, K = np.array([0.04, 0.0, 0.0, 0.0]), room.CAMERA.K
    u, v = np.meshgrid(np.arange(room.CAMERA.width, dtype=np.float32), np.arange(room.CAMERA.height, dtype=np.float32))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    place = cv2.undistortPoints(pixels, K, lens, P=K).reshape(*u.shape, 2).astype(np.float32)

    def bent(index: int, frame: Frame) -> Frame:
        image = cv2.remap(frame.image, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return replace(frame, image=image.astype(np.uint8))

    result, _, _ = track(RigKind.MONO, change=bent)
    assert result.stats["lens_k1"] == pytest.approx(0.04, abs=0.012)
    without = OdometryConfig.model_validate({"stereo": {"estimate_calibration": False}})
    left_alone, _, _ = track(RigKind.MONO, change=bent, config=without)
    assert left_alone.stats["lens_k1"] == 0.0
    assert error_m(result.trajectories[0], WALK, True) < 0.7 * error_m(left_alone.trajectories[0], WALK, True)


@pytest.mark.parametrize("kind", list(RigKind))
def test_after_a_few_blank_frames_the_camera_is_found_again_in_its_map(kind: RigKind) -> None:
    result, frames, _ = track(kind, change=blank(30, 35))
    assert [f.state for f in frames[30:35]] == [TrackingState.LOST] * 5
    assert len(result.tracks) == 1
    interval = result.lost[-1]
    assert (interval.first_ns, interval.last_ns, interval.frames) == (3_000_000_000, 3_400_000_000, 5)
    assert "need" in interval.reason
    assert error_m(result.trajectories[0], WALK, kind is RigKind.MONO) < 0.03


def test_missing_frames_and_a_missing_right_image_are_bridged() -> None:
    def gaps(index: int, frame: Frame) -> Frame | None:
        if 25 <= index < 30:
            return None
        return replace(frame, right=None) if index in (12, 13, 40) else frame

    result, frames, _ = track(RigKind.STEREO, change=gaps)
    assert len(result.tracks) == 1 and all(f.T_W_C is not None for f in frames)
    assert error_m(result.trajectories[0], WALK, False) < 0.02


def test_a_second_image_that_cannot_be_read_costs_no_frame_and_is_said() -> None:
    asked: list[int] = []

    def put_off(index: int, frame: Frame) -> Frame:
        def read() -> np.ndarray:
            asked.append(index)
            if index in (0, 3) or 15 <= index < 35:
                raise FrontendError(f"{index:06d}.png: the image is cut off")
            assert frame.right is not None
            return frame.right

        return replace(frame, right=PutOff(read))

    result, frames, _ = track(RigKind.STEREO, change=put_off)
    # The first map needs its second image; later key-frames do without.
    assert "000000.png" in frames[0].reason and frames[0].state is TrackingState.STARTING
    assert all(f.T_W_C is not None for f in frames[1:])
    assert len(result.tracks) == 1 and len(result.trajectories[0]) == 59
    assert error_m(result.trajectories[0], WALK, False) < 0.02
    assert asked == [i for i, f in enumerate(frames) if f.is_keyframe or i == 0]
    said = [i for i, f in enumerate(frames) if f.problem]
    assert said == [i for i in asked if i in (0, 3) or 15 <= i < 35] and len(said) >= 3
    assert all(f"{i:06d}.png" in frames[i].problem for i in said)


def test_a_camera_that_stands_still_has_a_pose_but_no_track_to_write() -> None:
    still = np.tile(WALK[:1], (12, 1, 1))
    result, frames, _ = track(RigKind.STEREO, poses=still)
    assert result.tracks == [] and len(result.lost) == 1 and result.lost[0].reason
    assert max(np.linalg.norm(f.T_W_C[:3, 3]) for f in frames if f.T_W_C is not None) < 1e-3
    result, frames, _ = track(RigKind.MONO, poses=still)
    assert result.tracks == [] and all("the camera stands still" in f.reason for f in frames[1:])


def test_turning_on_the_spot_is_tracked_by_stereo_and_refused_by_mono() -> None:
    turn = np.stack([WALK[0] @ se3(so3_exp([0, 0.025 * i, 0]), [0, 0, 0]) for i in range(24)])
    result, _, _ = track(RigKind.STEREO, poses=turn)
    assert len(result.trajectories[0]) == 24
    relative = se3_inverse(turn[0]) @ turn
    assert np.abs(result.trajectories[0].poses[:, :3, :3] - relative[:, :3, :3]).max() < 0.01
    result, frames, _ = track(RigKind.MONO, poses=turn)
    assert result.tracks == [] and any("turned without moving" in f.reason for f in frames)


@pytest.mark.parametrize("value", [0, 128])
@pytest.mark.parametrize("kind", list(RigKind))
def test_images_without_any_texture_never_start_and_never_raise(kind: RigKind, value: int) -> None:
    def flat(index: int, frame: Frame) -> Frame:
        empty = np.full_like(frame.image, value)
        return replace(frame, image=empty, right=None if frame.right is None else empty)

    result, frames, _ = track(kind, count=6, change=flat)
    assert result.tracks == [] and all(f.T_W_C is None and "need" in f.reason for f in frames)
    assert [lost.frames for lost in result.lost] == [6]


def test_a_large_moving_object_does_not_carry_the_camera_along() -> None:
    poster = np.random.default_rng(1).integers(0, 255, (15, 12)).astype(np.uint8).repeat(8, axis=0).repeat(8, axis=1)

    def passing(index: int, frame: Frame) -> Frame:
        image, right = frame.image.copy(), np.asarray(frame.right).copy()
        x, disparity = 10 + 5 * index, 30
        for picture, at in ((image, x), (right, x - disparity)):
            left, end = max(at, 0), min(at + 96, picture.shape[1])
            if left < end:
                picture[60:180, left:end] = poster[:, left - at : end - at]
        return replace(frame, image=image, right=right)

    result, _, _ = track(RigKind.STEREO, change=passing)
    assert len(result.tracks) == 1
    assert error_m(result.trajectories[0], WALK, False) < 0.05


def test_time_that_goes_back_is_refused_and_tracking_goes_on() -> None:
    def back(index: int, frame: Frame) -> Frame:
        return replace(frame, stamp_ns=500_000_000) if index == 20 else frame

    result, frames, _ = track(RigKind.STEREO, count=40, change=back)
    assert frames[20].T_W_C is None and "time stamp" in frames[20].reason and "ms" in frames[20].reason
    assert len(result.tracks) == 1 and (np.diff(result.trajectories[0].stamps_ns) > 0).all()


def test_broken_configuration_is_an_error_in_one_line() -> None:
    with pytest.raises(FrontendError, match="baseline"):
        Odometry(Rig(RigKind.STEREO, room.CAMERA, None), OdometryConfig(), Words())
    odometry = Odometry(room.rig(RigKind.MONO), OdometryConfig(), Words())
    with pytest.raises(FrontendError, match="100x50 pixels, the camera 320x240"):
        odometry.process(Frame(0, 0, np.zeros((50, 100), dtype=np.uint8), name="a.png"))


def test_no_frames_at_all_give_an_empty_result() -> None:
    result = Odometry(room.rig(RigKind.STEREO), OdometryConfig(), Words()).finish()
    assert result.tracks == [] and result.lost == [] and result.stats["frames"] == 0


def test_the_thesis_key_frame_policy_makes_fewer_key_frames_and_still_tracks() -> None:
    config = OdometryConfig(keyframes=KeyframeConfig(policy="thesis"), min_track_keyframes=1)
    result, frames, _ = track(RigKind.STEREO, config=config)
    gaps = np.diff([i for i, f in enumerate(frames) if f.is_keyframe])
    assert (gaps >= 20).all()
    assert error_m(result.trajectories[0], WALK, False) < 0.05


@pytest.mark.parametrize("kind", list(RigKind))
def test_two_runs_give_the_same_bytes(kind: RigKind) -> None:
    runs = [track(kind, count=35, change=blank(22, 25))[0] for _ in range(2)]
    for a, b in zip(runs[0].tracks, runs[1].tracks, strict=True):
        for name in ("stamps_s", "poses", "points", "observations", "descriptors", "words"):
            assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    assert runs[0].trajectories[0].poses.tobytes() == runs[1].trajectories[0].poses.tobytes()
    assert runs[0].stats == runs[1].stats


def test_the_stopwatch_knows_every_stage() -> None:
    _, frames, odometry = track(RigKind.STEREO, count=20)
    times = odometry.stopwatch.times
    made = sum(frame.is_keyframe for frame in frames)
    assert (
        times[TimedStage.TRACK].count == 19
        and times[TimedStage.START].count == 1
        and times[TimedStage.EXPORT].count == 1
    )
    for stage in (TimedStage.DETECT, TimedStage.STEREO, TimedStage.TRIANGULATE, TimedStage.ADJUST, TimedStage.CULL):
        assert times[stage].count == made
    assert all(time.wall_s > 0.0 for time in times.values())
    assert TimedStage.DECODE not in times
