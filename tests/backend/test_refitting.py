"""Points moved to where their views see them, against points that are known."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import Array, se3, se3_inverse, so3_exp, transform_points
from maslam.backend.refitting import refit_points

CAMERA = np.array([500.0, 510.0, 320.0, 240.0])


def seen(points: Array, T_C_W: Array) -> Array:
    p = transform_points(T_C_W, points)
    return p[:, :2] / p[:, 2:] * CAMERA[:2] + CAMERA[2:]


def street(count: int, images: int) -> tuple[Array, Array]:
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(-4, 4, count), rng.uniform(-2, 2, count), rng.uniform(8, 20, count)])
    poses = [se3(so3_exp([0.0, 0.02 * k, 0.0]), [0.6 * k, 0.1 * k, 0.2 * k]) for k in range(images)]
    return points, se3_inverse(np.stack(poses))


def test_points_come_back_from_exact_views_and_from_noisy_ones_with_an_outlier() -> None:
    points, poses = street(50, 6)
    rng = np.random.default_rng(4)
    start, image = np.arange(0, 301, 6), np.tile(np.arange(6), 50)
    uv = np.stack([seen(points, T) for T in poses], axis=1).reshape(-1, 2)
    cameras = np.tile(CAMERA, (6, 1))
    off = points + rng.normal(0.0, 0.15, points.shape)
    # The map's own position, trusted to 5 % of the depth, keeps a few hundredths of what it was off.
    found = refit_points(off, start, image, uv, poses, cameras)
    assert np.abs(found - points).max() < 0.05 * np.abs(off - points).max()
    noisy = uv + rng.normal(0.0, 0.3, uv.shape)
    noisy[5::6] += 40.0
    error = np.linalg.norm(refit_points(off, start, image, noisy, poses, cameras) - points, axis=1)
    assert np.median(error) < 0.25 * np.median(np.linalg.norm(off - points, axis=1))


def test_what_one_view_sees_stays_and_so_does_what_the_views_leave_open() -> None:
    points, poses = street(2, 2)
    cameras = np.tile(CAMERA, (2, 1))
    still = np.repeat(poses[:1], 2, axis=0)  # two views from one place say nothing of the depth
    off = points * 1.02
    uv = np.vstack([seen(points[:1], poses[0]) + 5.0, seen(points[1:], poses[0]), seen(points[1:], poses[0])])
    found = refit_points(off, np.array([0, 1, 3]), np.array([0, 0, 1]), uv, still, cameras)
    np.testing.assert_array_equal(found[0], off[0])
    np.testing.assert_allclose(found[1], off[1], rtol=1e-6)


def test_a_point_behind_a_camera_stays() -> None:
    points, poses = street(1, 2)
    uv = np.array([[320.0, 240.0], [320.0, 240.0]])
    behind = -points
    found = refit_points(behind, np.array([0, 2]), np.array([0, 1]), uv, poses, np.tile(CAMERA, (2, 1)))
    np.testing.assert_array_equal(found, behind)
