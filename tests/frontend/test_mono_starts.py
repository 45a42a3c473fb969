"""Starting with one camera in rendered rooms with exact truth: soon where it is sure, else the true reason."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import room
from followed import motion_error_deg

from maslam.backend.geometry import se3_inverse
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.estimation.several_views import SeveralViews
from maslam.frontend.frames import Frame
from maslam.frontend.mapping.range_sensor import Ranging
from maslam.frontend.odometry import Odometry
from maslam.frontend.tracking.first_view import FirstView
from maslam.frontend.tracking.initialisation import MonoStarter, Start
from maslam.frontend.vocabulary.vocabulary import Vocabulary

CONFIG = OdometryConfig()


def starter() -> MonoStarter:
    return MonoStarter(Ranging(room.rig(RigKind.MONO), CONFIG.stereo, CONFIG.flow), CONFIG)


def faded(frame: Frame, gain: float) -> Frame:
    return replace(frame, image=np.rint(128 + gain * (frame.image.astype(np.float64) - 128)).astype(np.uint8))


def started(poses: np.ndarray, gain: float = 1.0) -> tuple[int, tuple[float, float]]:
    """Number of the frame that starts, and the errors of turn and direction between the first two key-frames."""
    start, scene = starter(), room.Room(3)
    for i, pose in enumerate(poses):
        outcome = start.offer(faded(scene.frame(i, pose, RigKind.MONO), gain))
        if outcome.segment is not None:
            first, second = (outcome.segment.map.keyframes[k] for k in (0, 1))
            found = second.T_C_W @ se3_inverse(first.T_C_W)
            found[:3, 3] /= np.linalg.norm(found[:3, 3])
            truth = se3_inverse(pose) @ poses[first.frame_index]
            nothing = np.zeros((0, 3)), np.zeros(0, dtype=bool)
            return i, motion_error_deg(SeveralViews(found, *nothing), truth)
        assert outcome.reason and outcome.refusal.kind
    raise AssertionError(outcome.reason)


@pytest.mark.parametrize("gain", [1.0, 0.2, 0.07])
def test_a_slow_walk_starts_early_however_faint_its_walls(gain: float) -> None:
    """With the last gain an image has 60 to 80 corners."""
    frame, (turn_deg, heading_deg) = started(room.walk(30), gain)
    assert frame <= 5 and turn_deg < 0.2 and heading_deg < 5.0


@pytest.mark.parametrize("step_m", [0.35, 0.5, 0.7])
@pytest.mark.parametrize("backwards", [False, True])
def test_a_fast_drive_starts_although_near_points_leave(step_m: float, backwards: bool) -> None:
    poses = room.walk(14, step_m=step_m)
    frame, (turn_deg, heading_deg) = started(poses[::-1] if backwards else poses)
    assert frame <= 6 and turn_deg < 1.2 and heading_deg < 6.0


def offered(start: MonoStarter, seed: int, first: int, count: int) -> list[Start]:
    scene, pose = room.Room(seed), room.walk(1)[0]
    return [start.offer(scene.frame(first + i, pose, RigKind.MONO)) for i in range(count)]


def test_a_first_view_taken_anew_is_not_the_reason() -> None:
    start = starter()
    before, after = offered(start, 3, 0, 3), offered(start, 77, 3, 3)
    assert [s.refusal.kind for s in before] == ["first view of a start"] + ["the camera stands still"] * 2
    # Another room: the points are lost, which is why this frame does not start; then the new first view counts.
    assert [s.refusal.kind for s in after] == ["too few points followed"] + ["the camera stands still"] * 2
    assert "need 40" in after[0].reason


def test_a_stretch_without_a_pose_is_one_interval_with_its_best_figure() -> None:
    odometry = Odometry(room.rig(RigKind.MONO), CONFIG, Vocabulary.load())
    scene, poses = room.Room(3), room.walk(12, step_m=0.002, turn_deg=0.0)
    results = [odometry.process(scene.frame(i, pose, RigKind.MONO)) for i, pose in enumerate(poses)]
    (interval,) = odometry.finish().lost
    assert interval.kind == "moved too little to start" == results[-1].kind and interval.frames == 12
    frames = [r.kind for r in results].count(interval.kind)
    moved = max(float(r.reason.split(" by ")[1].split(" px")[0]) for r in results if " by " in r.reason)
    assert f"moved by {moved:.2f} px" in interval.reason and f"nearest of {frames} frames" in interval.reason
    assert moved > 2.0


def moved_by(px: float, share: float) -> str:
    """Kind of the refusal where a ``share`` of the points has moved by so many pixels, the others not at all."""
    ranging = Ranging(room.rig(RigKind.MONO), CONFIG.stereo, CONFIG.flow)
    rng = np.random.default_rng(2)
    first = rng.uniform((20.0, 20.0), (300.0, 220.0), (200, 2))
    view = FirstView(room.Room(3).frame(0, room.walk(1)[0], RigKind.MONO), first, ranging, CONFIG)
    step = np.where(np.arange(200)[:, None] < 200 * share, (px, 0.0), (0.0, 0.0))
    view.follow(first + step + rng.normal(0.0, 0.1, (200, 2)), np.ones(200, dtype=bool))
    return view.motion().refusal.kind


def test_only_points_that_stand_within_their_noise_are_said_to_stand() -> None:
    """A start needs 3 px of an image of 320 pixels a row; a point's noise is half a pixel."""
    assert moved_by(0.0, 1.0) == moved_by(0.5, 1.0) == moved_by(60.0, 0.05) == "the camera stands still"
    assert moved_by(2.6, 1.0) == moved_by(2.6, 0.6) == moved_by(60.0, 0.2) == "moved too little to start"


def test_a_first_view_goes_on_while_the_camera_has_moved_too_little() -> None:
    """Its parallax so far would be thrown away otherwise: the next view would begin with points that stand."""
    config = CONFIG.model_copy(update={"mono": CONFIG.mono.model_copy(update={"max_frames": 5})})
    start = MonoStarter(Ranging(room.rig(RigKind.MONO), config.stereo, config.flow), config)
    scene, poses = room.Room(3), room.walk(10, step_m=0.002, turn_deg=0.0)
    kinds = [start.offer(scene.frame(i, pose, RigKind.MONO)).refusal.kind for i, pose in enumerate(poses)]
    assert kinds[1] == "the camera stands still" and kinds[4:] == ["moved too little to start"] * 6


def test_each_frame_before_a_start_is_counted_once() -> None:
    """Four black images, five from one spot, then a walk: the start's first view gets a pose later, and the frames
    before and after it are two intervals. Each is counted anew here by what was said of each frame."""
    odometry = Odometry(room.rig(RigKind.MONO), CONFIG, Vocabulary.load())
    scene, poses = room.Room(3), room.walk(30)
    stands = [poses[0]] * 5
    frames = [scene.frame(i, pose, RigKind.MONO) for i, pose in enumerate([*[poses[0]] * 4, *stands, *poses])]
    frames[:4] = [replace(f, image=np.zeros_like(f.image)) for f in frames[:4]]
    kinds = {f.stamp_ns: odometry.process(f).kind for f in frames}
    lost = odometry.finish().lost
    assert len(lost) >= 2 and lost[0].frames == 4
    for one in lost:
        inside = Counter(kind for stamp, kind in kinds.items() if one.first_ns <= stamp <= one.last_ns)
        counts = Counter[str]()
        for kind, n in one.kinds:
            counts[kind] += n
        assert counts == inside and sum(counts.values()) == one.frames
        numbers = [int(n) for n in re.findall(r"(?:of |\()(\d+) frames?\)", one.reason)]
        assert sum(numbers) == one.frames
