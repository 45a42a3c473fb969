"""Window bundle adjustment: key-frame poses, points and the stereo rig's residual calibration, by a Schur complement.

Compiled kernels, arrays in, arrays out. ``cam`` is ``[fx, fy, cx, cy, bf]``; poses are ``T_C_W``. A measured ``(u, v,
disparity)`` is modelled as the ideal one plus ``basis @ calib``: what the rig's residual calibration
(:mod:`maslam.frontend.estimation.self_calibration`) does at that place of the image.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from .depth_alignment import add_alignment, alignment_cost
from .linear_algebra import solve_symmetric, weighted_gram
from .pose_refinement import exp_update
from .schur import Array, Ints, assemble, back_substitute, reduce_points, robust_weights

_SETTLED = 2e-4
"""A step that lowers the cost by less than this share is the last: the window is adjusted again at the next
key-frame."""


@njit(cache=True, nogil=True)
def window_residuals(poses: Array, points: Array, kf: Ints, pt: Ints, uv: Array, disparity: Array, cam: Array) -> Array:
    """``(N, 3)`` pixels, predicted minus measured u, v, disparity (0 where unknown); NaN for points behind a camera.

    What was measured comes with the residual calibration taken out."""
    out = np.empty((len(kf), 3))
    for i in range(len(kf)):
        T = poses[kf[i]]
        p = points[pt[i]]
        X = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        Y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        Z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if Z < 1e-4:
            out[i] = np.nan
            continue
        out[i, 0] = cam[0] * X / Z + cam[2] - uv[i, 0]
        out[i, 1] = cam[1] * Y / Z + cam[3] - uv[i, 1]
        out[i, 2] = 0.0
        if not np.isnan(disparity[i]):
            out[i, 2] = cam[4] / Z - disparity[i]
    return out


@njit(cache=True, nogil=True)
def _cost(r: Array, sigma: Array, sigma_d: Array, calib: Array, mean: Array, info: Array) -> float:
    total = 0.0
    for i in range(len(r)):
        if np.isnan(r[i, 0]):
            total += 1e4
            continue
        total += robust_weights(r[i, 0] ** 2 + r[i, 1] ** 2, r[i, 2], sigma[i], sigma_d[i])[2]
    for a in range(len(calib)):
        for c in range(len(calib)):
            total += info[a, c] * (calib[a] - mean[a]) * (calib[c] - mean[c])
    return total


@njit(cache=True, nogil=True)
def _take_out(uv: Array, disparity: Array, basis: Array, calib: Array) -> tuple[Array, Array]:
    """Positions and disparities without what the calibration adds to them."""
    uv, disparity = uv.copy(), disparity.copy()
    for i in range(len(uv)):
        for k in range(len(calib)):
            uv[i, 0] -= basis[i, 0, k] * calib[k]
            uv[i, 1] -= basis[i, 1, k] * calib[k]
            disparity[i] -= basis[i, 2, k] * calib[k]
    return uv, disparity


@njit(cache=True, nogil=True)
def adjust_window(
    poses: Array,
    slot: Ints,
    points: Array,
    start: Ints,
    kf: Ints,
    pt: Ints,
    uv: Array,
    disparity: Array,
    sigma: Array,
    sigma_d: Array,
    cam: Array,
    basis: Array,
    calib: Array,
    calib_mean: Array,
    calib_info: Array,
    pairs: Ints,
    T_A_B: Array,
    pair_info: Array,
    pair_gradient: Array,
    pair_cost: Array,
    iterations: int,
) -> tuple[Array, Array, Array, Array, float, float]:
    """Levenberg-Marquardt on robust reprojection and disparity errors.

    ``poses`` ``(K, 4, 4)``; ``slot`` ``(K,)``: number of a free pose, -1 = fixed; ``points`` ``(P, 3)``; the N
    observations are sorted by point, those of point j are ``start[j]:start[j + 1]``; ``kf``, ``pt`` ``(N,)`` indices,
    ``uv`` ``(N, 2)``, ``disparity`` ``(N,)`` NaN where unknown, ``sigma``, ``sigma_d`` ``(N,)`` pixels. Calibration:
    ``basis`` ``(N, 3, C)``, start and prior mean ``(C,)``, prior information ``(C, C)``; C = 0 keeps it out. Pairs of
    poses: the arrays of a :class:`maslam.frontend.estimation.depth_alignment.DepthAlignment`. Returns poses, points,
    calibration, the calibration's information, cost before and after; the cost never rises.
    """
    poses, points, calib = poses.copy(), points.copy(), calib.copy()
    free = slot.max() + 1
    n_c = basis.shape[2]
    m = 6 * free + n_c
    n_points, n = len(points), len(kf)
    r = window_residuals(poses, points, kf, pt, *_take_out(uv, disparity, basis, calib), cam)
    cost = _cost(r, sigma, sigma_d, calib, calib_mean, calib_info)
    cost += alignment_cost(poses, pairs, T_A_B, pair_info, pair_gradient, pair_cost)
    first = cost
    damping = 1e-4
    W = np.zeros((n, 6, 3))
    Wc = np.zeros((n_points, n_c, 3))
    V, b_p, V_inv = np.zeros((n_points, 3, 3)), np.zeros((n_points, 3)), np.zeros((n_points, 3, 3))
    relinearise = True
    S = np.zeros((m, m))
    U, b_c = np.zeros((m, m)), np.zeros(m)
    for _ in range(iterations):
        if relinearise:
            assemble(
                poses,
                slot,
                points,
                start,
                kf,
                disparity,
                sigma,
                sigma_d,
                cam,
                r,
                basis,
                free,
                U,
                b_c,
                V,
                b_p,
                W,
                Wc,
            )
            for a in range(n_c):
                for c in range(n_c):
                    U[6 * free + a, 6 * free + c] += calib_info[a, c]
                    b_c[6 * free + a] += calib_info[a, c] * (calib[c] - calib_mean[c])
            add_alignment(poses, slot, pairs, T_A_B, pair_info, pair_gradient, U, b_c)
        S, rhs = reduce_points(slot, start, kf, n_c, free, U, b_c, V, b_p, W, Wc, V_inv, damping)
        delta = solve_symmetric(S, -rhs.reshape(m, 1))[:, 0]
        new_poses, new_points, new_calib = poses.copy(), points.copy(), calib.copy()
        for k in range(len(poses)):
            if slot[k] >= 0:
                new_poses[k] = exp_update(delta[6 * slot[k] : 6 * slot[k] + 6], poses[k])
        for k in range(n_c):
            new_calib[k] += delta[6 * free + k]
        back_substitute(slot, start, kf, n_c, free, delta, b_p, W, Wc, V_inv, new_points)
        new_r = window_residuals(new_poses, new_points, kf, pt, *_take_out(uv, disparity, basis, new_calib), cam)
        new_cost = _cost(new_r, sigma, sigma_d, new_calib, calib_mean, calib_info)
        new_cost += alignment_cost(new_poses, pairs, T_A_B, pair_info, pair_gradient, pair_cost)
        if new_cost < cost:
            gain = (cost - new_cost) / cost
            poses, points, calib, r, cost = new_poses, new_points, new_calib, new_r, new_cost
            damping = max(damping * 0.2, 1e-8)
            relinearise = True
            if gain < _SETTLED:
                break
        else:
            damping *= 10.0
            relinearise = False
            if damping > 1e6:
                break
    return poses, points, calib, _marginal(S, 6 * free), first, cost


@njit(cache=True, nogil=True)
def _marginal(S: Array, first: int) -> Array:
    """Information of the unknowns from ``first`` on when all others are left free."""
    if first == 0 or first == len(S):
        return S[first:, first:].copy()
    across = S[:first, first:].copy()
    solved = solve_symmetric(S[:first, :first].copy(), across)
    return S[first:, first:] - weighted_gram(across, np.ones(first), solved)
