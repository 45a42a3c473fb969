"""Doubtful poses: weak support, something that moves, jumps. Truth: closed forms, drawn noise, rendered rooms."""

from __future__ import annotations

from dataclasses import replace

import followed
import numpy as np
import pytest
import room
from hidden import behind, side

from maslam.backend.geometry import se3, so3_exp, transform_points, umeyama
from maslam.frontend.cameras.models import Rig, RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.estimation.pose_refinement import SeenPoints, refine_pose
from maslam.frontend.mapping.range_sensor import Ranging
from maslam.frontend.odometry import FrameResult, Odometry, OdometryResult
from maslam.frontend.reason import NO_REASON, Reason
from maslam.frontend.tracking import doubt as rules
from maslam.frontend.tracking.doubt import PointsFound, doubt, jumps, stands, weak_support
from maslam.frontend.tracking.followed_points import TrackedFrame
from maslam.frontend.tracking.pose_log import DoubtfulInterval, MomentLog
from maslam.frontend.vocabulary.vocabulary import Vocabulary

CONFIG = OdometryConfig()
RANGING = Ranging(Rig(RigKind.MONO, followed.CAMERA, None), CONFIG.stereo, CONFIG.flow)


def visible(seed: int, count: int, part: float = 1.0) -> np.ndarray:
    """Points at 4 to 12 m that fill ``part`` of the image's width and height."""
    rng = np.random.default_rng(seed)
    z = rng.uniform(4, 12, count)
    x, y = rng.uniform(-0.6, 0.6, count) * part, rng.uniform(-0.44, 0.44, count) * part
    return np.stack([x * z, y * z, z], axis=1)


@pytest.mark.parametrize(
    ("count", "part", "weak"),
    [(200, 1.0, False), (40, 1.0, False), (20, 1.0, True), (45, 0.3, True), (150, 0.3, False), (70, 0.1, True)],
)
def test_few_points_and_points_in_one_corner_are_weak_support(count: int, part: float, weak: bool) -> None:
    xyz = visible(1, count, part)
    found = weak_support(np.eye(4), xyz, followed.project(xyz, np.eye(4)), RANGING, 0.5)
    assert (found.kind == "few points support the pose") == weak and (found.reached > 1.0) == weak
    assert not weak or f"{count} points" in found.text


def test_the_deviation_of_the_position_is_that_of_drawn_noise() -> None:
    xyz, rng, sigma = visible(2, 30), np.random.default_rng(0), np.full(30, 0.5)
    at = []
    for _ in range(300):
        uv = followed.project(xyz, np.eye(4)) + rng.normal(0, 0.5, (30, 2))
        at.append(refine_pose(np.eye(4), SeenPoints.without_depth(xyz, uv, sigma), RANGING.cam, 99.0, 3)[0][:3, 3])
    drawn = np.sqrt(np.linalg.eigvalsh(np.cov(np.array(at).T))[-1])
    stated = rules._position_deviation(np.eye(4), xyz, followed.project(xyz, np.eye(4)), RANGING, 0.5)
    assert stated == pytest.approx(drawn, rel=0.15)


def agreement(moved: np.ndarray, share: float, still: bool = False) -> PointsFound:
    """200 points: all agree with the camera's step but ``share`` of them, which are on something that turns, or stand
    still in the image."""
    xyz, n = visible(3, 200), int(200 * share)
    step = se3(so3_exp([0, 0.02, 0]), [0.1, 0.0, 0.05])
    uv, before = followed.project(xyz, step), followed.project(xyz, np.eye(4))
    uv[:n] = before[:n] if still else followed.project(transform_points(se3(np.eye(3), moved), xyz[:n]), step)
    error = np.linalg.norm(uv - followed.project(xyz, step), axis=1)
    return PointsFound(xyz, uv, before, error < 1.2)


def test_a_second_motion_that_many_points_share_is_a_doubt() -> None:
    step = se3(so3_exp([0, 0.02, 0]), [0.1, 0.0, 0.05])
    moved = np.array([0.0, 0.6, 0.3])
    found = doubt(step, agreement(moved, 0.4), RANGING, 0.5)
    assert found.kind == "two motions in the image" and "120 points agree with the pose and 80 with" in found.text
    assert doubt(step, agreement(moved, 0.1), RANGING, 0.5) == NO_REASON
    scattered = agreement(moved, 0.4)
    scattered.uv[:80] = np.random.default_rng(0).uniform(0, 480, (80, 2))
    assert doubt(step, scattered, RANGING, 0.5) == NO_REASON


@pytest.mark.parametrize(("share", "divided"), [(0.1, False), (0.4, True), (0.95, False)])
def test_a_part_that_stands_still_divides_the_image(share: float, divided: bool) -> None:
    seen = agreement(np.zeros(3), share, still=True)
    assert seen.divided == divided and seen.still_share == pytest.approx(share, abs=0.02)
    # Only a camera that stood before goes on standing while something moves.
    assert stands(seen, stood=True) == (share > 0.2) and stands(seen, stood=False) == (share > 0.9)


def test_a_step_beyond_its_neighbours_is_a_jump() -> None:
    t = np.arange(40)
    centres = np.stack([0.1 * t, 0.5 * np.sin(t / 8.0), 0.005 * (t % 2)], axis=1)
    stamps, depth = (t * 1e8).astype(np.int64), np.full(40, 4.0)
    assert jumps(stamps, centres, depth) == []
    broken = centres.copy()
    broken[25:] += [0.0, 0.2, 0.0]
    ((frame, found),) = jumps(stamps, broken, depth)
    assert frame == 25 and found.kind == "a jump in the trajectory" and found.reached > 1.0
    assert found.text.endswith(" (unit of the track)")
    assert jumps(stamps, broken, depth, "m")[0][1].text.endswith(" m")
    assert jumps(stamps, broken, np.full(40, 60.0)) == []  # far from everything it is no more than the noise
    stamps[25:] += 4 * 10**8
    waited = centres.copy()
    waited[25:] += 4 * (centres[25] - centres[24])
    assert jumps(stamps, waited, depth) == []  # five times the time for five times the step


@pytest.mark.parametrize("missing", [0, 2, 4, 8])
@pytest.mark.parametrize("where", [1, 2, 20, 38, 39])
@pytest.mark.parametrize("motion", ["even", "turning", "faster"])
def test_frames_missing_in_an_even_motion_are_no_jump_and_hide_none(missing: int, where: int, motion: str) -> None:
    """Also next to a track's ends, where neighbours are on one side only."""
    t = np.arange(40 + missing, dtype=np.float64)
    x, z = 0.03 * t, np.zeros_like(t)
    if motion == "turning":
        x, z = np.sin(0.03 * t), np.cos(0.03 * t)
    elif motion == "faster":
        x = x + 0.0002 * t**2
    kept = np.concatenate([np.arange(where), np.arange(where + missing, len(t))])
    stamps, centres, depth = (kept * 1e8).astype(np.int64), np.stack([x, 0 * t, z], axis=1)[kept], np.ones(40)
    assert jumps(stamps, centres, depth) == []
    broken = centres.copy()
    broken[where:] += [0.0, 0.3, 0.0]
    assert [frame for frame, _ in jumps(stamps, broken, depth)] == [where]


def test_a_camera_found_by_few_points_is_doubted_until_more_confirm_it() -> None:
    odometry, T = Odometry(room.rig(RigKind.STEREO), CONFIG, Vocabulary.load()), np.eye(4)
    kinds = [
        odometry._doubt(TrackedFrame(T, n), again).kind
        for n, again in ((45, True), (50, False), (80, False), (50, False))
    ]
    assert kinds == ["found again by few points"] * 2 + ["", ""]
    assert odometry._doubt(TrackedFrame(T, 90), True) == NO_REASON


def test_doubts_are_joined_over_short_gaps_and_only_of_frames_with_a_pose() -> None:
    log, weak = MomentLog(), Reason("few points", "16 points", 1.5)
    for stamp, reason in enumerate(
        [NO_REASON, weak, NO_REASON, replace(weak, text="12 points", reached=2.0), *[NO_REASON] * 5, weak]
    ):
        log.note(stamp, NO_REASON, reason)
    jump = Reason("a jump", "a step 0.2 beyond", 3.0)
    posed = [np.arange(9)]
    assert log.doubtful(posed, [(7, jump)]) == [
        DoubtfulInterval(1, 3, 3, "12 points (worst of 2 frames)", "few points"),
        DoubtfulInterval(7, 7, 1, "a step 0.2 beyond", "a jump"),
    ]


def passing(
    kind: RigKind,
    width: int,
    stand: int = 24,
    walk: int = 20,
    top: int = 0,
    height: int = 240,
    x: float = 0.0,
    near_m: float = 1.3,
    waits: int = 3,
) -> tuple[OdometryResult, list[FrameResult], np.ndarray]:
    """A walk, then the camera stands while something ``width`` pixels wide at ``near_m`` moves on before it, which
    appears at once at column ``x`` after it has stood for ``waits`` frames, or six where it stands from the
    beginning."""
    scene, poses = room.Room(3), room.walk(walk)
    poses = np.concatenate([poses, np.tile(poses[-1:], (stand, 1, 1))])
    texture = side(width, height)
    odometry, results = Odometry(room.rig(kind), CONFIG, Vocabulary.load()), []
    comes = max(walk + waits, 7)
    for i, pose in enumerate(poses):
        frame = scene.frame(i, pose, kind)
        if i >= comes:
            frame = behind(frame, texture, x + 5.0 * (i - comes), top, near_m)
        results.append(odometry.process(frame))
    return odometry.finish(), results, poses


def test_a_standing_camera_is_not_carried_along_by_half_of_the_image() -> None:
    result, frames, poses = passing(RigKind.STEREO, 160)
    (trajectory,) = result.trajectories
    error = np.linalg.norm(
        umeyama(poses[:20, :3, 3], trajectory.centres[:20], False) @ trajectory.centres - poses[:, :3, 3], axis=1
    )
    # The thing moves by 0.6 m, and so did the camera before.
    assert error[23:].max() < 0.15
    (interval,) = [one for one in result.doubtful if one.kind == "a part of the image stands still"]
    assert interval.frames >= 5 and interval.first_ns >= 23 * 10**8
    # A frame whose pose is held is no view to build the map on.
    held = [frame for frame in frames[23:] if "stand still while" in frame.doubt]
    assert len(held) >= 5 and not any(frame.is_keyframe for frame in held)


def test_a_walk_leaves_no_doubt() -> None:
    odometry, scene = Odometry(room.rig(RigKind.STEREO), CONFIG, Vocabulary.load()), room.Room(3)
    results = [odometry.process(scene.frame(i, pose, RigKind.STEREO)) for i, pose in enumerate(room.walk(40))]
    assert odometry.finish().doubtful == [] and not any(result.doubt for result in results)


@pytest.mark.parametrize("kind", [RigKind.STEREO, RigKind.RGBD, RigKind.MONO])
def test_a_standing_camera_is_not_carried_along_by_what_fills_most_of_the_image(kind: RigKind) -> None:
    result, frames, poses = passing(kind, 540, top=30, height=180, x=-236.0, near_m=0.7)
    assert len(result.trajectories) == 1
    trajectory = result.trajectories[0]
    standing = trajectory.stamps_ns >= 20 * 10**8
    assert standing.sum() == len(poses) - 20
    path_m = np.linalg.norm(poses[19, :3, 3] - poses[0, :3, 3])
    own = np.linalg.norm(trajectory.centres[~standing][-1] - trajectory.centres[0])
    moved = np.linalg.norm(trajectory.centres[standing] - trajectory.centres[standing][0], axis=1) * path_m / own
    # What passes moves by 0.6 m or more.
    assert moved.max() < 0.05
    assert not any(frame.is_keyframe for frame in frames[24:])


@pytest.mark.parametrize(
    ("x", "waits", "height"), [(-400.0, 3, 180), (-480.0, 1, 180), (-330.0, 0, 180), (-400.0, 3, 220)]
)
def test_a_pair_that_stops_in_traffic_does_not_go_with_what_comes_before_it(x: float, waits: int, height: int) -> None:
    """It comes when the last key-frame is some steps old, or in the frame in which the camera stops, and hides all but
    a few points that waver."""
    top = 30 if height == 180 else 10
    result, frames, poses = passing(RigKind.STEREO, 540, 60, top=top, height=height, x=x, near_m=0.7, waits=waits)
    [trajectory] = result.trajectories
    at = np.rint(trajectory.stamps_ns / 1e8).astype(int)
    assert len(at) >= 50
    expected = (poses[at, :3, 3] - poses[0, :3, 3]) @ poses[0, :3, :3]
    moved = np.linalg.norm(trajectory.centres - trajectory.centres[0] - expected, axis=1)
    # What passes moves by 0.75 m or more.
    assert moved.max() < (0.05 if waits else 0.1)
    assert not any(frame.is_keyframe for frame in frames[24:])


def test_a_pair_that_was_hidden_while_it_stood_waits_for_its_own_view() -> None:
    """Six times as long as one that moved: what hides it passes in seconds."""
    result, _, _ = passing(RigKind.STEREO, 540, 60, top=10, height=220, x=-236.0, near_m=0.7)
    assert len(result.tracks) == 1 and sum(one.frames for one in result.lost) >= 45


def test_one_camera_that_stood_does_not_start_by_what_comes_before_it() -> None:
    result, _, _ = passing(RigKind.MONO, 540, walk=1, top=30, height=180, x=-236.0)
    assert not result.tracks
    assert any("a part of the image stands still" in kind for one in result.lost for kind, _ in one.kinds)


def test_a_pair_that_stands_all_the_time_says_so() -> None:
    result, _, _ = passing(RigKind.STEREO, 540, walk=1, top=30, height=180, x=-236.0)
    [lost] = result.lost
    assert not result.tracks and lost.kind == "the camera stands still, the track is too short"


def test_a_camera_that_stood_and_drives_off_is_followed_at_once() -> None:
    scene, poses = room.Room(3), room.walk(16, step_m=0.12)
    poses = np.concatenate([np.tile(poses[:1], (8, 1, 1)), poses])
    odometry = Odometry(room.rig(RigKind.STEREO), CONFIG, Vocabulary.load())
    results = [odometry.process(scene.frame(i, pose, RigKind.STEREO)) for i, pose in enumerate(poses)]
    assert not any(result.doubt for result in results)
    error = np.linalg.norm(np.stack([r.T_W_C for r in results])[:, :3, 3] - poses[:, :3, 3] + poses[0, :3, 3], axis=1)  # type: ignore[misc]
    assert error.max() < 0.05
