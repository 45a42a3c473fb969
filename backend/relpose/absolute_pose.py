"""The pose of a camera that sees known points in known directions, its own depths unused: search and least squares.

The points are the match's and bring their own noise: across their
rays as any direction does, along them in inverse depth. Carried into the query camera, the latter shows only along the
epipolar line, and grows with the parallax.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam._pycolmap import RansacLimits, absolute_pose

from ..geometry import Array, Sim3, skew, so3_exp
from .alignment import (
    CORRELATED,
    ITERATIONS,
    MAD_TO_SIGMA,
    MIN_ANGLE_SIGMA,
    MIN_DEPTH_SIGMA,
    START_ANGLE_SIGMA,
    START_DEPTH_SIGMA,
    Alignment,
)

_MIN_AGREE = 4
_MIN_TRIALS, _MAX_TRIALS, _CONFIDENCE = 100, 10_000, 0.9999


def search_bearings(points_M: Array, rays_Q: Array, angle_deg: float, rng: np.random.Generator) -> list[Sim3]:
    """The rigid ``T_M_Q`` that most matches agree on, by P3P and LO-RANSAC; empty where fewer than four do.

    ``points_M`` ``(k, 3)`` in the match's unit, ``rays_Q`` ``(k, 3)`` of any length; rays that point backwards are left
    out. The seed is drawn from ``rng``: same state, same pose.
    """
    seed = int(rng.integers(2**31 - 1))
    ahead = rays_Q[:, 2] > 1e-6 * np.linalg.norm(rays_Q, axis=1)
    # With focal length 1 a pixel is the tangent of an angle.
    limits = RansacLimits(float(np.tan(np.radians(angle_deg))), _MIN_AGREE, _CONFIDENCE, _MIN_TRIALS, _MAX_TRIALS)
    plane = rays_Q[ahead, :2] / rays_Q[ahead, 2:]
    T_Q_M = absolute_pose(points_M[ahead], plane, (1.0, 1.0, 0.0, 0.0), limits, seed, refine=False)
    return [] if T_Q_M is None else [Sim3(T_Q_M[:, :3], T_Q_M[:, 3]).inverse()]


def lend_depths(T_M_Q: Sim3, points_M: Array, rays_Q: Array) -> Array:
    """Points ``(k, 3)`` on the query's rays, as far away as the match's points are under the pose."""
    reach = np.linalg.norm(T_M_Q.inverse() @ points_M, axis=1)
    return np.asarray(rays_Q * (reach / np.maximum(np.linalg.norm(rays_Q, axis=1), 1e-12))[:, None])


def lend_surface(T_M_Q: Sim3, points_M: Array, rays_Q: Array) -> Array:
    """Points ``(n, 3)`` on all rays of the query, each as far away as the match's point ``(m, 3)`` that lies nearest to
    the ray."""
    carried = T_M_Q.inverse() @ points_M
    reach = np.maximum(np.linalg.norm(carried, axis=1), 1e-12)
    nearest = np.argmax(rays_Q @ (carried / reach[:, None]).T, axis=1)
    return np.asarray(rays_Q * (reach[nearest] / np.maximum(np.linalg.norm(rays_Q, axis=1), 1e-12))[:, None])


def refine_bearings(
    points_M: Array, rays_Q: Array, start: Sim3, loss_scale: float, iterations: int = ITERATIONS
) -> Alignment:
    """Refine a rigid ``start`` on matched points and rays ``(k, 3)``, k >= 3: Gauss-Newton with Cauchy weights on the
    directions in the query camera, both noise levels estimated from the residuals."""
    R, t = start.rotation, start.translation
    across = _across(rays_Q)
    unit = 1.0 / float(np.median(np.linalg.norm(points_M, axis=1)))
    angle, depth = START_ANGLE_SIGMA, START_DEPTH_SIGMA * unit
    hessian = np.zeros((6, 6))
    for iteration in range(iterations):
        residual, jacobian, to_ray, along = _linearised(points_M, across, R, t)
        cov = _covariance(points_M, to_ray, along, angle, depth)
        inverse = np.linalg.inv(cov)
        weighed = np.einsum("kab,kb->ka", inverse, residual)
        weight = 1.0 / (1.0 + np.einsum("ka,ka->k", residual, weighed) / loss_scale**2)
        hessian = np.einsum("k,kai,kab,kbj->ij", weight, jacobian, inverse, jacobian, optimize=True)
        gradient = np.einsum("k,kai,ka->i", weight, jacobian, weighed, optimize=True)
        damped = hessian + np.diag(1e-9 * np.diag(hessian) + 1e-12)
        step = -np.linalg.solve(damped, gradient)
        t, R = t + R @ step[:3], R @ so3_exp(step[3:])
        if iteration < ITERATIONS // 2:
            angle, depth = _noise(residual, cov, along, angle, depth, unit)
        elif np.abs(step).max() < 1e-10:
            break
    full = np.zeros((7, 7))
    full[:6, :6] = 0.5 / CORRELATED * (hessian + hessian.T)
    return Alignment(Sim3(R, t), full, angle, depth)


def with_scale(found: Alignment, points_M: Array, points_Q: Array, loss_scale: float) -> Alignment:
    """The same with the query's unit in the match's: the median ratio of distances of matched points ``(k, 3)``."""
    T = found.T_M_Q
    carried = T.inverse() @ points_M
    reach = np.linalg.norm(carried, axis=1)
    logs = np.log(reach / np.linalg.norm(points_Q, axis=1))
    log_scale = float(np.median(logs))
    deviations = np.abs(logs - log_scale)
    sigma = max(MAD_TO_SIGMA * float(np.median(deviations)), MIN_DEPTH_SIGMA)
    near = deviations < loss_scale * sigma
    # A median of Gaussian numbers has pi / 2 times the variance of their mean.
    weight = near.sum() / (0.5 * np.pi * sigma**2 * CORRELATED)
    # The scale follows the pose: nearer to the points, their distances are shorter. Turning changes none.
    slope = np.zeros(7)
    slope[:3] = -(carried[near] / reach[near, None] ** 2).mean(axis=0)
    slope[6] = -1.0
    full = found.full_information + weight * np.outer(slope, slope)
    scaled = Sim3(T.rotation, T.translation, float(np.exp(log_scale)))
    return Alignment(scaled, full, found.angle_sigma, found.depth_sigma)


def _across(rays: Array) -> Array:
    """``(k, 2, 3)``: two unit vectors across each ray."""
    u = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    axis = np.where((np.abs(u[:, :1]) <= np.abs(u[:, 1:2])), [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(u, axis)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(u, first)], axis=1)


def _linearised(points_M: Array, across: Array, R: Array, t: Array) -> tuple[Array, Array, Array, Array]:
    """Residuals ``(k, 2)`` in the query, their derivatives ``(k, 2, 6)`` by ``(rho, phi)`` of ``t + R rho``,
    ``R exp(phi)``; by the point in the query's frame ``(k, 2, 3)``; by its inverse distance from the match ``(k, 2)``.
    """
    x = (points_M - t) @ R
    distance = np.maximum(np.linalg.norm(x, axis=1), 1e-9)
    ray = x / distance[:, None]
    residual = np.einsum("kab,kb->ka", across, ray)
    to_ray = (across - residual[:, :, None] * ray[:, None, :]) / distance[:, None, None]
    jacobian = np.concatenate([-to_ray, to_ray @ skew(x)], axis=2)
    along = np.einsum("kab,kb->ka", to_ray, points_M @ R) * np.linalg.norm(points_M, axis=1)[:, None]
    return residual, jacobian, to_ray, along


def _covariance(points_M: Array, to_ray: Array, along: Array, angle: float, depth: float) -> Array:
    """``(k, 2, 2)``: the query's own noise, and that of the match's point across and along its ray."""
    reach2 = (points_M**2).sum(axis=1)
    outer = along[:, :, None] * along[:, None, :]
    carried = to_ray @ np.swapaxes(to_ray, 1, 2) * reach2[:, None, None] - outer / reach2[:, None, None]
    return np.asarray(angle**2 * (np.eye(2) + carried) + depth**2 * outer)


def _noise(residual: Array, cov: Array, along: Array, angle: float, depth: float, unit: float) -> tuple[float, float]:
    """The noise at which the typical residual is as large as its covariance says: that of directions from what lies
    across the epipolar lines, that of depths from what lies along them where they matter most."""
    size = np.linalg.norm(along, axis=1)
    line = np.where(size[:, None] > 1e-12, along / np.maximum(size, 1e-12)[:, None], [1.0, 0.0])
    beside = np.stack([-line[:, 1], line[:, 0]], axis=1)
    angle_now = angle * _typical(residual, cov, beside)
    informative = size >= np.median(size)
    depth_now = depth
    # Without parallax the depths do not show, and do not matter.
    if depth * np.median(size[informative]) > 0.5 * angle:
        depth_now = depth * _typical(residual[informative], cov[informative], line[informative])
    return max(angle_now, MIN_ANGLE_SIGMA), min(max(depth_now, MIN_DEPTH_SIGMA * unit), unit)


def _typical(residual: Array, cov: Array, direction: NDArray[np.float64]) -> float:
    """Robust ratio of the residuals' components in a ``direction`` ``(k, 2)`` to their standard deviations."""
    own = np.einsum("ka,ka->k", residual, direction)
    sigma = np.sqrt(np.einsum("ka,kab,kb->k", direction, cov, direction))
    return float(MAD_TO_SIGMA * np.median(np.abs(own) / sigma))
