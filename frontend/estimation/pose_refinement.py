"""Robust pose of one frame from map points: compiled kernels.

``cam`` is ``[fx, fy, cx, cy, bf]`` (``bf = fx * baseline_m``). ``T`` is always ``T_C_W``.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .linear_algebra import solve_symmetric, times3, times3_transposed

Array = NDArray[np.float64]
HUBER_UV = 2.0
HUBER_D = 1.5


class SeenPoints(NamedTuple):
    """n map points and where one frame sees them.

    ``points`` ``(n, 3)`` in the track's frame and unit; in pixels: ``uv`` ``(n, 2)``, ``disparity`` ``(n,)``, NaN where
    unknown, and their standard deviations ``sigma``, ``sigma_d`` ``(n,)``.
    """

    points: Array
    uv: Array
    disparity: Array
    sigma: Array
    sigma_d: Array

    @classmethod
    def without_depth(cls, points: Array, uv: Array, sigma: Array) -> SeenPoints:
        """Points of which no disparity was measured."""
        return cls(points, uv, np.full(len(uv), np.nan), sigma, np.ones(len(uv)))


@kernel
def exp_update(delta: Array, T: Array) -> Array:
    """``exp(delta) @ T`` for a tangent vector ``(6,)``, translation first."""
    p0, p1, p2 = delta[3], delta[4], delta[5]
    angle2 = p0 * p0 + p1 * p1 + p2 * p2
    angle = np.sqrt(angle2)
    if angle < 1e-6:
        a, b, c = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0, 1.0 / 6.0
    else:
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
        c = (1.0 - a) / angle2
    K, R, V, out = np.zeros((3, 3)), np.empty((3, 3)), np.empty((3, 3)), np.zeros((4, 4))
    K[0, 1], K[0, 2], K[1, 2] = -p2, p1, -p0
    K[1, 0], K[2, 0], K[2, 1] = p2, -p1, p0
    K2 = times3(K, K)
    for i in range(3):
        for k in range(3):
            one = 1.0 if i == k else 0.0
            R[i, k] = one + a * K[i, k] + b * K2[i, k]
            V[i, k] = one + b * K[i, k] + c * K2[i, k]
    # One Newton step to the nearest rotation: velocities are made with transposes for inverses, and there rounding
    # errors would grow sixfold from frame to frame.
    turned = times3(R, T)
    cubed = times3(times3_transposed(turned, turned), turned)
    out[3, 3] = 1.0
    for i in range(3):
        for k in range(3):
            out[i, k] = 1.5 * turned[i, k] - 0.5 * cubed[i, k]
    for i in range(3):
        for k in range(3):
            out[i, 3] += R[i, k] * T[k, 3] + V[i, k] * delta[k]
    return out


@kernel
def residuals(T: Array, seen: SeenPoints, cam: Array) -> Array:
    """``(n, 3)`` pixels: predicted minus measured u, v, disparity; disparity 0 where unknown; NaN behind the camera."""
    points, uv, disparity, _, _ = seen
    out = np.empty((len(points), 3))
    for i in range(len(points)):
        X = T[0, 0] * points[i, 0] + T[0, 1] * points[i, 1] + T[0, 2] * points[i, 2] + T[0, 3]
        Y = T[1, 0] * points[i, 0] + T[1, 1] * points[i, 1] + T[1, 2] * points[i, 2] + T[1, 3]
        Z = T[2, 0] * points[i, 0] + T[2, 1] * points[i, 1] + T[2, 2] * points[i, 2] + T[2, 3]
        if Z < 1e-6:
            out[i] = np.nan
            continue
        out[i, 0] = cam[0] * X / Z + cam[2] - uv[i, 0]
        out[i, 1] = cam[1] * Y / Z + cam[3] - uv[i, 1]
        out[i, 2] = 0.0 if np.isnan(disparity[i]) else cam[4] / Z - disparity[i]
    return out


@kernel
def refine_pose(
    T: Array, seen: SeenPoints, cam: Array, outlier_sigmas: float, rounds: int
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Gauss-Newton on robust reprojection and disparity errors, outliers removed between rounds (ORB-SLAM's scheme).

    Returns the pose ``(4, 4)``, the inlier mask ``(n,)``, and the ``(6, 6)`` normal matrix of the inliers (its inverse
    is the pose's covariance).
    """
    sigma, sigma_d = seen.sigma, seen.sigma_d
    n = len(sigma)
    inlier = np.ones(n, dtype=np.bool_)
    pose = T.copy()
    H = np.zeros((6, 6))
    for turn in range(rounds):
        # Coarse to fine: the first round must not lose the right matches of a bad prediction.
        scale = 4.0 if turn == 0 else (2.0 if turn == 1 else 1.0)
        for _ in range(8 if turn == 0 else 4):
            H, b = _normal_equations(pose, seen, cam, inlier, scale)
            for k in range(6):
                H[k, k] += 1e-6 * H[k, k] + 1e-9
            delta = solve_symmetric(H, -b.reshape(6, 1)).reshape(6)
            pose = exp_update(delta, pose)
            settled = True
            for k in range(6):
                settled &= abs(delta[k]) < 1e-7
            if settled:
                break
        r = residuals(pose, seen, cam)
        for i in range(n):
            e_uv = np.sqrt(r[i, 0] ** 2 + r[i, 1] ** 2) / sigma[i]
            e_d = np.abs(r[i, 2]) / sigma_d[i]
            inlier[i] = e_uv < outlier_sigmas * scale and e_d < 1.5 * outlier_sigmas * scale
    return pose, inlier, H


@kernel
def _normal_equations(
    T: Array, seen: SeenPoints, cam: Array, use: NDArray[np.bool_], scale: float
) -> tuple[Array, Array]:
    points, uv, disparity, sigma, sigma_d = seen
    H = np.zeros((6, 6))
    b = np.zeros(6)
    J = np.zeros((3, 6))
    e = np.zeros(3)
    w = np.zeros(3)
    for i in range(len(points)):
        if not use[i]:
            continue
        X = T[0, 0] * points[i, 0] + T[0, 1] * points[i, 1] + T[0, 2] * points[i, 2] + T[0, 3]
        Y = T[1, 0] * points[i, 0] + T[1, 1] * points[i, 1] + T[1, 2] * points[i, 2] + T[1, 3]
        Z = T[2, 0] * points[i, 0] + T[2, 1] * points[i, 1] + T[2, 2] * points[i, 2] + T[2, 3]
        if Z < 1e-6:
            continue
        iz = 1.0 / Z
        x, y = X * iz, Y * iz
        e[0] = cam[0] * x + cam[2] - uv[i, 0]
        e[1] = cam[1] * y + cam[3] - uv[i, 1]
        a0, a1, a2 = cam[0] * iz, cam[1] * iz, cam[4] * iz * iz
        J[0, 0], J[0, 2], J[0, 3], J[0, 4], J[0, 5] = a0, -a0 * x, -cam[0] * x * y, cam[0] * (1 + x * x), -cam[0] * y
        J[1, 1], J[1, 2], J[1, 3], J[1, 4], J[1, 5] = a1, -a1 * y, -cam[1] * (1 + y * y), cam[1] * x * y, cam[1] * x
        norm = np.sqrt(e[0] ** 2 + e[1] ** 2) / (sigma[i] * scale)
        w[0] = 1.0 / sigma[i] ** 2
        if norm > HUBER_UV:
            w[0] *= HUBER_UV / norm
        w[1] = w[0]
        rows = 2
        if not np.isnan(disparity[i]):
            rows = 3
            e[2] = cam[4] * iz - disparity[i]
            J[2, 2], J[2, 3], J[2, 4] = -a2, -a2 * Y, a2 * X
            norm = np.abs(e[2]) / (sigma_d[i] * scale)
            w[2] = 1.0 / sigma_d[i] ** 2
            if norm > HUBER_D:
                w[2] *= HUBER_D / norm
        for r in range(rows):
            for k in range(6):
                b[k] += w[r] * J[r, k] * e[r]
                for m in range(k, 6):
                    H[k, m] += w[r] * J[r, k] * J[r, m]
    for k in range(6):
        for m in range(k):
            H[k, m] = H[m, k]
    return H, b
