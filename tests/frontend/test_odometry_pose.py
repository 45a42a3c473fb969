"""The pose kernel against scipy and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from maslam.backend.geometry import se3, se3_exp, so3_exp
from maslam.frontend.estimation.pose_refinement import SeenPoints, exp_update, refine_pose, residuals

CAM = np.array([400.0, 410.0, 320.0, 180.0, 400.0 * 0.3])


def project(T: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    p = points @ T[:3, :3].T + T[:3, 3]
    uv = np.stack([CAM[0] * p[:, 0] / p[:, 2] + CAM[2], CAM[1] * p[:, 1] / p[:, 2] + CAM[3]], axis=1)
    return uv, CAM[4] / p[:, 2]


def scene(rng: np.random.Generator, count: int = 120) -> tuple[np.ndarray, np.ndarray]:
    points = rng.uniform([-8, -3, 4], [8, 3, 40], (count, 3))
    return points, se3(so3_exp(rng.normal(0, 0.03, 3)), rng.normal(0, 0.3, 3))


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-3, 0.7])
def test_exp_update_is_the_exponential_from_the_left(scale: float) -> None:
    rng = np.random.default_rng(1)
    xi, T = scale * rng.standard_normal(6), se3(so3_exp([0.3, -0.2, 0.1]), [1.0, 2.0, 3.0])
    np.testing.assert_allclose(exp_update(xi, T), se3_exp(xi) @ T, atol=1e-12)


def test_exact_measurements_give_the_exact_pose() -> None:
    points, T = scene(np.random.default_rng(2))
    uv, disparity = project(T, points)
    ones = np.ones(len(points))
    seen = SeenPoints(points, uv, disparity, ones, ones)
    found, inlier, _ = refine_pose(np.eye(4), seen, CAM, 2.45, 4)
    np.testing.assert_allclose(found, T, atol=1e-6)
    assert inlier.all()
    assert np.abs(residuals(found, seen, CAM)).max() < 1e-4


def test_noisy_measurements_give_the_optimum_that_scipy_finds() -> None:
    rng = np.random.default_rng(3)
    points, T = scene(rng)
    uv, disparity = project(T, points)
    # Small against the standard deviation stated: every residual is in the quadratic part of the loss.
    uv, disparity = uv + rng.normal(0, 0.2, uv.shape), disparity + rng.normal(0, 0.1, len(uv))
    disparity[::3] = np.nan
    seen = SeenPoints(points, uv, disparity, np.full(len(uv), 1.0), np.full(len(uv), 0.5))
    found, _, _ = refine_pose(np.eye(4), seen, CAM, 2.45, 4)

    def cost(xi: np.ndarray) -> np.ndarray:
        uv_hat, d_hat = project(se3_exp(xi) @ T, points)
        d = np.where(np.isnan(disparity), 0.0, (d_hat - np.nan_to_num(disparity)) / 0.5)
        return np.concatenate([(uv_hat - uv).ravel(), d])

    best = least_squares(cost, np.zeros(6), x_scale="jac", xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(found, se3_exp(best.x) @ T, atol=1e-6)


def test_a_third_of_wrong_matches_is_found_out() -> None:
    rng = np.random.default_rng(4)
    points, T = scene(rng, 200)
    uv, _ = project(T, points)
    uv += rng.normal(0, 0.3, uv.shape)
    wrong = rng.random(len(uv)) < 0.33
    uv[wrong] += rng.uniform(15, 60, (wrong.sum(), 2))
    start = se3_exp([0.05, 0.0, 0.1, 0.002, 0.002, 0.0]) @ T
    found, inlier, H = refine_pose(start, SeenPoints.without_depth(points, uv, np.full(len(uv), 0.5)), CAM, 2.45, 4)
    assert not inlier[wrong].any()
    assert inlier[~wrong].mean() > 0.95
    assert np.linalg.norm((found @ np.linalg.inv(T))[:3, 3]) < 0.03
    assert (np.linalg.eigvalsh(H) > 0).all()


def test_points_behind_the_camera_are_nan_and_never_inliers() -> None:
    points, T = scene(np.random.default_rng(5))
    uv, _ = project(T, points)
    points[:10, 2] = -5.0
    seen = SeenPoints.without_depth(points, uv, np.ones(len(uv)))
    assert np.isnan(residuals(T, seen, CAM)[:10]).all()
    _, inlier, _ = refine_pose(T, seen, CAM, 2.45, 4)
    assert not inlier[:10].any() and inlier[10:].all()
