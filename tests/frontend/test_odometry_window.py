"""Window bundle adjustment against scipy's optimum and against the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from maslam.backend.geometry import se3, se3_exp, so3_exp
from maslam.frontend.estimation.bundle_adjustment import AdjustedWindow, adjust_window, window_residuals
from maslam.frontend.estimation.depth_alignment import DepthAlignment
from maslam.frontend.estimation.schur import Estimate, Observations, Window
from maslam.frontend.estimation.triangulation import triangulate

CAM = np.array([400.0, 400.0, 320.0, 180.0, 400.0 * 0.5])
SIGMA, SIGMA_D = 0.5, 0.3


class Problem:
    """A camera driving past points; exact observations with noise ``noise_px``, a rig with a hidden calibration."""

    def __init__(
        self, noise_px: float, calib: list[float], keyframes: int = 5, count: int = 40, stereo: bool = True
    ) -> None:
        rng = np.random.default_rng(7)
        self.poses = np.stack(
            [se3(so3_exp(rng.normal(0, 0.02, 3)), [0.1 * k, 0.02 * k, -0.8 * k]) for k in range(keyframes)]
        )
        self.points = rng.uniform([-5, -3, 6], [5, 3, 25], (count, 3))
        self.kf = np.tile(np.arange(keyframes), count)
        self.pt = np.repeat(np.arange(count), keyframes)
        self.start = np.arange(0, count * keyframes + 1, keyframes)
        self.calib = np.array(calib)
        blank = np.zeros((len(self.kf), 2))
        no_d = np.full(len(self.kf), np.nan)
        self.uv = window_residuals(self.poses, self.points, self.kf, self.pt, blank, no_d, CAM)[:, :2].copy()
        zero = np.zeros(len(self.kf))
        exact = window_residuals(self.poses, self.points, self.kf, self.pt, self.uv, zero, CAM)[:, 2]
        # Any basis serves: a common shift of the disparities, slopes of them, and one of u that grows with v.
        place = (self.uv - CAM[2:4]) / CAM[:2]
        self.basis = np.zeros((len(self.kf), 3, 3))
        self.basis[:, 2, 0], self.basis[:, 2, 1], self.basis[:, 0, 2] = 1.0, place[:, 1], place[:, 1] ** 2
        self.uv += self.basis[:, :2] @ self.calib
        exact += self.basis[:, 2] @ self.calib
        self.uv += rng.normal(0, noise_px, self.uv.shape) if noise_px else 0.0
        self.disparity = exact + (rng.normal(0, noise_px, len(exact)) if noise_px else 0.0) if stereo else no_d
        self.slot = np.arange(keyframes) - 1
        self.start_poses = np.stack(
            [T if k == 0 else se3_exp(rng.normal(0, 0.01, 6)) @ T for k, T in enumerate(self.poses)]
        )
        self.start_points = self.points + rng.normal(0, 0.1, self.points.shape)

    def solve(self, estimate_calib: bool, iterations: int = 60, prior_px: float = 1.0) -> AdjustedWindow:
        n, c = len(self.kf), 3 if estimate_calib else 0
        sigmas = np.full(n, SIGMA), np.full(n, SIGMA_D)
        seen = Observations(self.start, self.kf, self.pt, self.uv, self.disparity, *sigmas)
        prior = np.zeros(c), np.eye(c) * prior_px**-2.0
        window = Window(self.slot, seen, CAM, self.basis[:, :, :c], *prior)
        begin = Estimate(self.start_poses, self.start_points, np.zeros(c))
        return adjust_window(begin, window, DepthAlignment.none(), iterations)


def test_exact_observations_give_the_truth_and_the_hidden_calibration() -> None:
    problem = Problem(0.0, [0.4, -0.2, 0.1])
    adjusted = problem.solve(True, prior_px=1e4)
    np.testing.assert_allclose(adjusted.estimate.poses, problem.poses, atol=1e-5)
    np.testing.assert_allclose(adjusted.estimate.points, problem.points, atol=1e-4)
    np.testing.assert_allclose(adjusted.estimate.calib, problem.calib, atol=1e-5)
    assert adjusted.cost_after < 1e-6 < adjusted.cost_before


@pytest.mark.parametrize("estimate_calib", [True, False])
def test_noisy_observations_give_the_optimum_that_scipy_finds(estimate_calib: bool) -> None:
    problem = Problem(0.1, [0.1, 0.0, 0.0])
    adjusted = problem.solve(estimate_calib)
    poses, points, calib = adjusted.estimate
    information, after = adjusted.information, adjusted.cost_after
    free, count = len(problem.poses) - 1, len(problem.points)

    def cost(x: np.ndarray) -> np.ndarray:
        moved = np.stack([problem.poses[0], *(se3_exp(x[6 * k : 6 * k + 6]) @ poses[k + 1] for k in range(free))])
        shifted = points + x[6 * free : 6 * free + 3 * count].reshape(-1, 3)
        c = calib + x[6 * free + 3 * count :] if estimate_calib else np.zeros(3)
        uv, disparity = problem.uv - problem.basis[:, :2] @ c, problem.disparity - problem.basis[:, 2] @ c
        r = window_residuals(moved, shifted, problem.kf, problem.pt, uv, disparity, CAM)
        return np.concatenate([(r[:, :2] / SIGMA).ravel(), r[:, 2] / SIGMA_D, c if estimate_calib else np.zeros(0)])

    x0 = np.zeros(6 * free + 3 * count + (3 if estimate_calib else 0))
    np.testing.assert_allclose((cost(x0) ** 2).sum(), after, rtol=1e-9)
    best = least_squares(cost, x0, x_scale="jac", xtol=1e-12, ftol=1e-12)
    assert after <= 2.0 * best.cost * (1 + 1e-5)
    assert np.abs(best.x[: 6 * free]).max() < 2e-4
    # What the calibration is known by is the inverse of its covariance (nearly all weights are 1 here).
    c = information.shape[0]
    if c:
        covariance = np.linalg.inv(best.jac.T @ best.jac)[-c:, -c:]
        np.testing.assert_allclose(information @ covariance, np.eye(c), atol=0.1)


def test_fixed_poses_stay_and_the_cost_never_rises() -> None:
    problem = Problem(0.3, [0.0, 0.0, 0.0])
    problem.slot = np.array([-1, -1, 0, 1, 2])
    adjusted = problem.solve(False, iterations=5)
    np.testing.assert_array_equal(adjusted.estimate.poses[:2], problem.start_poses[:2])
    assert adjusted.estimate.calib.shape == (0,)
    assert adjusted.cost_after <= adjusted.cost_before


def test_wrong_matches_pull_less_than_least_squares_lets_them() -> None:
    problem = Problem(0.1, [0.0, 0.0, 0.0], count=80)
    clean = problem.solve(False).estimate.poses
    problem.uv[::23] += 30.0
    robust = problem.solve(False).estimate.poses
    assert np.abs(robust[:, :3, 3] - clean[:, :3, 3]).max() < 0.05


def test_monocular_window_keeps_its_reprojection() -> None:
    problem = Problem(0.0, [0.0, 0.0, 0.0], stereo=False)
    adjusted = problem.solve(False)
    assert adjusted.cost_after < 1e-4 < adjusted.cost_before


def test_triangulation_meets_the_point_and_refuses_parallel_rays() -> None:
    poses = np.stack([np.eye(4), se3(np.eye(3), [-1.0, 0, 0]), np.eye(4)])
    point = np.array([0.5, -0.2, 8.0])
    rays = np.stack([point / point[2], (point - [1.0, 0, 0]) / point[2], point / point[2], point / point[2]])
    found, parallax = triangulate(poses, np.array([0, 2, 4]), np.array([0, 1, 0, 2]), rays)
    np.testing.assert_allclose(found[0], point, atol=1e-9)
    a, b = rays[0] / np.linalg.norm(rays[0]), rays[1] / np.linalg.norm(rays[1])
    assert parallax[0] == pytest.approx(np.arccos(a @ b), abs=1e-9)
    assert np.isnan(found[1]).all()
