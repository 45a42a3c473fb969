"""Alignment of whole depth images, against rooms of planes whose depth is known in closed form."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import se3_exp
from maslam.frontend.estimation.depth_alignment import align_surfaces, surface

CAM = np.array([260.0, 260.0, 160.0, 120.0, 20.0])
CORNER = [([0.0, 0.0, 1.0], 3.0), ([0.8, 0.0, 0.6], 2.3), ([0.0, 0.8, 0.6], 2.2)]
WALL = CORNER[:1]


def depth_image(planes: list[tuple[list[float], float]], T_C_W: np.ndarray) -> np.ndarray:
    """Depth of the nearest of the planes ``n . x = d`` (world) along each pixel's ray."""
    v, u = np.mgrid[0:240, 0:320]
    rays = np.stack([(u - CAM[2]) / CAM[0], (v - CAM[3]) / CAM[1], np.ones_like(u, dtype=float)], axis=2)
    best = np.full(u.shape, np.inf)
    for normal, d in planes:
        n = T_C_W[:3, :3] @ np.array(normal)
        with np.errstate(divide="ignore"):
            z = (d + n @ T_C_W[:3, 3]) / (rays @ n)
        best = np.where(z > 0, np.minimum(best, z), best)
    return np.where(np.isfinite(best), best, 0.0).astype(np.float32)


def pair(planes: list[tuple[list[float], float]], T_B_W: np.ndarray) -> list:
    return [surface(depth_image(planes, T), CAM, 8.0, 80) for T in (np.eye(4), T_B_W)]


def test_three_planes_bring_a_wrong_pose_back() -> None:
    truth = se3_exp(np.array([0.05, -0.03, 0.04, 0.01, -0.03, 0.02]))
    surfaces, T = pair(CORNER, truth), se3_exp(np.array([0.02, 0.01, -0.015, 0.008, -0.006, 0.005])) @ truth
    for _ in range(8):
        found = align_surfaces(surfaces, np.stack([np.eye(4), T]), [(0, 1)], CAM, 0.0015, 1.0)
        T = np.linalg.inv(se3_exp(-np.linalg.solve(found.information[0], found.gradient[0])) @ found.T_A_B[0])
    np.testing.assert_allclose(T, truth, atol=3e-4)


def test_a_lone_wall_says_nothing_along_itself() -> None:
    found = align_surfaces(pair(WALL, np.eye(4)), np.stack([np.eye(4)] * 2), [(0, 1)], CAM, 0.0015, 1.0)
    H = found.information[0]
    for free in (0, 1, 5):  # both ways along the wall, and about the way it faces
        assert H[free, free] < 1e-6 * H[2, 2]
    assert np.linalg.matrix_rank(H, tol=1e-4 * H[2, 2]) == 3


def test_surfaces_that_show_different_places_are_not_aligned() -> None:
    away = se3_exp(np.array([0.0, 0.0, 0.0, 0.0, 1.5, 0.0]))
    found = align_surfaces(pair(CORNER, away), np.stack([np.eye(4), away]), [(0, 1)], CAM, 0.0015, 1.0)
    assert not len(found.pairs)


def test_the_normal_equations_are_the_derivatives_of_the_cost() -> None:
    rng = np.random.default_rng(3)
    truth = se3_exp(np.array([0.05, -0.03, 0.04, 0.01, -0.03, 0.02]))
    base = np.stack([se3_exp(rng.normal(0, 0.3, 6)) @ T for T in (np.eye(4), np.eye(4))])
    base[1] = truth @ base[0]
    off = np.stack([base[0], se3_exp(rng.normal(0, 1e-2, 6)) @ base[1]])
    found = align_surfaces(pair(CORNER, truth), off, [(0, 1)], CAM, 0.0015, 1.0)
    U, b = np.zeros((12, 12)), np.zeros(12)
    found.add_to(U, b, off, np.array([0, 1]))
    step = 1e-5
    for k in range(12):
        ends = []
        for sign in (-step, step):
            x = np.zeros((2, 6))
            x.flat[k] = sign
            ends.append(found.cost_at(np.stack([se3_exp(x[i]) @ off[i] for i in range(2)])))
        np.testing.assert_allclose((ends[1] - ends[0]) / (2 * step), 2.0 * b[k], rtol=1e-3, atol=1e-4 * np.abs(b).max())
    np.testing.assert_allclose(U, U.T, rtol=1e-12, atol=1e-9 * np.abs(U).max())
