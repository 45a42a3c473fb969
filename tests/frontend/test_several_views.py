"""Starting with one camera from more than two views: sure where the geometry is, refused where it is not. The truth is
the poses that the points were projected with."""

from __future__ import annotations

import followed
import numpy as np
import pytest
from followed import cloud, drive, motion_error_deg, path, plane

from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.frontend.estimation.several_views import Needs, ViewTracks, adjust_all, decide
from maslam.frontend.estimation.two_view import PointPairs, solve_two_views

NOISES = [0.1, 0.3, 0.5]
"""Pixels; followed corners have 0.1 to 0.3, the settings say 0.5."""


@pytest.mark.parametrize("noise_px", [*NOISES, 0.8])
def test_pure_rotation_never_starts(noise_px: float) -> None:
    for seed in range(3):
        _, motion = drive([cloud(seed)] * 12, path(12, [0.002, 0.02, 0.003], [0, 0, 0]), noise_px, seed)
        assert motion.T_2_1 is None and motion.refusal.kind == "turned without moving"


@pytest.mark.parametrize("noise_px", NOISES)
@pytest.mark.parametrize("share", [0.5, 0.6])
def test_a_standing_camera_does_not_start_on_what_moves(noise_px: float, share: float) -> None:
    """A rigid object that fills half of the image moves as the world would before a moving camera."""
    for seed in range(3):
        rng, count = np.random.default_rng(seed), int(200 * share)
        thing = rng.uniform([-2, -1, 4], [0, 1, 6], (count, 3))
        points = [
            np.concatenate([cloud(seed, 200 - count), thing + np.array([0.06, 0.0, 0.01]) * k]) for k in range(12)
        ]
        _, motion = drive(points, [np.eye(4)] * 12, noise_px, seed)
        assert motion.T_2_1 is None and motion.refusal.kind == "a part of the image stands still"
        # The same motion of everything is the camera's.
        everything = [cloud(seed) + np.array([0.06, 0.0, 0.01]) * k for k in range(12)]
        _, motion = drive(everything, [np.eye(4)] * 12, noise_px, seed)
        assert motion.T_2_1 is not None and motion.T_2_1[:3, 3] @ [0.06, 0, 0.01] > 0.06 * 0.98


@pytest.mark.parametrize("noise_px", [0.1, 0.3])
def test_a_plane_before_a_straight_path_stays_ambiguous(noise_px: float) -> None:
    for seed in range(3):
        _, motion = drive([plane(seed)] * 9, path(9, [0, 0.005, 0], [0.06, 0, 0.03]), noise_px, seed)
        assert motion.T_2_1 is None and motion.refusal.kind == "two motions fit the points"


@pytest.mark.parametrize("noise_px", NOISES)
def test_a_plane_is_decided_by_views_that_turn_and_swerve(noise_px: float) -> None:
    at = [([0, 0.02 * np.sin(k / 2), 0], [0.06 * k, 0.3 * np.sin(k / 3), 0.03 * k]) for k in range(12)]
    poses = [se3_inverse(se3(so3_exp(turn), step)) for turn, step in at]
    for seed in range(3):
        k, motion = drive([plane(seed)] * 12, poses, noise_px, seed)
        turn_deg, heading_deg = motion_error_deg(motion, poses[k])
        assert turn_deg < 0.6 and heading_deg < 10.0


def test_two_views_of_a_plane_have_two_motions_and_a_third_view_has_one() -> None:
    """The second motion is the one that Faugeras' decomposition gives; it explains both views as well."""
    points, poses = plane(1), path(3, [0, 0.01, 0], [0.12, 0.0, 0.06])
    poses[1] = se3_inverse(se3(so3_exp([0.01, -0.02, 0.0]), [0.05, 0.2, 0.0]))
    uv = np.stack([followed.project(points, T) for T in poses])
    uv = uv[:, ((uv > 0) & (uv < [640, 480])).all(axis=(0, 2))]  # what one of the views does not show decides, too
    uv += np.random.default_rng(1).normal(0, 0.05, uv.shape)
    two = solve_two_views(PointPairs(uv[0], uv[2], followed.CAMERA.K, 0.5), followed.CONFIG.mono)
    assert two.T_2_1 is None and len(two.hypotheses) >= 2
    cam, needs = np.array([500.0, 500.0, 319.5, 239.5, 0.0]), Needs(30, 0.75, 0.4)
    pair = ViewTracks(uv[[0, 2]], cam, 0.5)
    assert decide(pair, adjust_all(pair, two.hypotheses), needs).refusal.kind == "two motions fit the points"
    three = ViewTracks(uv, cam, 0.5)
    turn_deg, heading_deg = motion_error_deg(decide(three, adjust_all(three, two.hypotheses), needs), poses[2])
    assert turn_deg < 0.05 and heading_deg < 1.0


def test_half_the_parallax_is_enough_where_several_views_agree() -> None:
    poses = path(24, [0, 0.01, 0], [0.03, 0.005, 0.01])
    for seed in range(3):
        points = np.random.default_rng(seed).uniform([-0.6, -0.4, 3], [0.6, 0.4, 40], (200, 3))
        points[:, :2] *= points[:, 2:]
        k, motion = drive([points] * 24, poses, 0.2, seed)
        rays = [points, points + poses[k][:3, :3].T @ poses[k][:3, 3]]
        cosine = (rays[0] * rays[1]).sum(axis=1) / np.linalg.norm(rays[0], axis=1) / np.linalg.norm(rays[1], axis=1)
        assert np.degrees(np.median(np.arccos(cosine))) < followed.CONFIG.mono.min_parallax_deg
        turn_deg, heading_deg = motion_error_deg(motion, poses[k])
        assert turn_deg < 0.4 and heading_deg < 10.0


def test_a_flat_and_narrow_scene_is_refused_as_what_it_is() -> None:
    """A turn and a step move its points alike, so it could start with any motion between."""
    points = np.random.default_rng(0).uniform([-0.6, -0.45, 9.8], [0.6, 0.45, 10.2], (200, 3))
    _, motion = drive([points] * 12, path(12, [0, 0.0, 0.01], [0.06, 0.0, 0.0]), 0.2, 0)
    assert motion.T_2_1 is None
    kinds = ("turn and step cannot be distinguished", "two motions fit the points", "turned without moving")
    assert motion.refusal.kind in kinds


@pytest.mark.parametrize("count", [50, 75])
def test_few_corners_start_a_map_that_several_views_confirm(count: int) -> None:
    """Two views alone ask for 80."""
    poses = path(10, [0, 0.005, 0], [0.08, 0.0, 0.03])
    points = np.random.default_rng(5).uniform([-1.5, -1.5, 3], [2.5, 1.5, 18], (count, 3))
    k, motion = drive([points] * 10, poses, 0.2, 1)
    turn_deg, heading_deg = motion_error_deg(motion, poses[k])
    assert k >= 2 and turn_deg < 0.2 and heading_deg < 3.0
    _, motion = drive([points[:35]] * 10, poses, 0.2, 1)
    assert motion.refusal.kind == "too few points followed"


CAM, NEEDS = np.array([500.0, 500.0, 319.5, 239.5, 0.0]), Needs(30, 0.75, 0.4)


def tracks(points: np.ndarray, poses: list[np.ndarray], noise_px: float) -> ViewTracks:
    uv = np.stack([followed.project(points, T) for T in poses])
    return ViewTracks(uv + np.random.default_rng(3).normal(0, noise_px, uv.shape), CAM, 0.5)


def unit(T: np.ndarray) -> np.ndarray:
    return se3(T[:3, :3], T[:3, 3] / np.linalg.norm(T[:3, 3]))


def test_a_flat_and_narrow_scene_cannot_tell_a_turn_from_a_step() -> None:
    poses = path(5, [0, 0.01, 0], [0.1, 0.0, 0.02])
    flat = np.random.default_rng(0).uniform([-0.6, -0.45, 9.8], [0.6, 0.45, 10.2], (200, 3))
    narrow = tracks(flat, poses, 0.2)
    refusal = decide(narrow, adjust_all(narrow, (unit(poses[-1]),)), NEEDS).refusal
    assert refusal.kind == "turn and step cannot be distinguished" and 0.0 < refusal.reached < 1.0
    deep = tracks(cloud(0), poses, 0.2)
    assert decide(deep, adjust_all(deep, (unit(poses[-1]),)), NEEDS).T_2_1 is not None


def test_noise_is_no_parallax() -> None:
    """Noise on a pure rotation: triangulated, it has parallax, but no more than the fit leaves."""
    turning = path(5, [0, 0.02, 0], [0, 0, 0])
    noisy = tracks(cloud(0), turning, 0.5)
    hypothesis = se3(turning[-1][:3, :3], np.array([1.0, 0.0, 0.0]))
    refusal = decide(noisy, adjust_all(noisy, (hypothesis,)), Needs(30, 0.0, 0.0)).refusal
    assert refusal.kind == "parallax too small" and refusal.reached < 1.0


def test_points_that_slide_do_not_bend_the_motion() -> None:
    poses = path(4, [0, 0.02, 0], [0.06, 0.0, 0.0])
    points = np.random.default_rng(0).uniform([-3, -2, 6], [3, 2, 7.5], (200, 3))
    seen = tracks(points, poses, 0.05)
    seen.uv[:, :6, 0] += np.linspace(0.0, 1.4, 4)[:, None]
    seen.uv[:, :6, 1] -= np.linspace(0.0, 1.4, 4)[:, None]
    turn_deg, heading_deg = motion_error_deg(decide(seen, adjust_all(seen, (unit(poses[-1]),)), NEEDS), poses[-1])
    assert turn_deg < 0.1 and heading_deg < 2.0


def test_points_that_disagree_are_counted() -> None:
    poses = path(4, [0, 0.02, 0], [0.1, 0.0, 0.0])
    seen = tracks(cloud(0), poses, 0.1)
    seen.uv[:, :60] += np.random.default_rng(1).normal(0, 10.0, (4, 60, 2))
    found = decide(seen, adjust_all(seen, (unit(poses[-1]),)), NEEDS)
    assert found.refusal.kind == "too few points agree in several views" and "140 of 200" in found.refusal.text
    assert decide(seen, adjust_all(seen, (unit(poses[-1]),)), Needs(30, 0.65, 0.4)).T_2_1 is not None
