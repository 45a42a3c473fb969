"""Window bundle adjustment: key-frame poses, points and the stereo rig's residual calibration, by a Schur complement.

Arrays in, arrays out. ``cam`` is ``[fx, fy, cx, cy, bf]``; poses are ``T_C_W``. A measured ``(u, v,
disparity)`` is modelled as the ideal one plus ``basis @ calib``: what the rig's residual calibration
(:mod:`maslam.frontend.estimation.self_calibration`) does at that place of the image.
"""

from __future__ import annotations

import numpy as np

from maslam._kernels import kernel

from .depth_alignment import DepthAlignment
from .linear_algebra import solve_symmetric, weighted_gram
from .pose_refinement import exp_update
from .schur import Array, Ints, assemble, back_substitute, reduce_points, robust_weights

_SETTLED = 2e-4
"""A step that lowers the cost by less than this share is the last: the window is adjusted again at the next
key-frame."""


@kernel
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


@kernel
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


@kernel
def _take_out(uv: Array, disparity: Array, basis: Array, calib: Array) -> tuple[Array, Array]:
    """Positions and disparities without what the calibration adds to them."""
    uv, disparity = uv.copy(), disparity.copy()
    for i in range(len(uv)):
        for k in range(len(calib)):
            uv[i, 0] -= basis[i, 0, k] * calib[k]
            uv[i, 1] -= basis[i, 1, k] * calib[k]
            disparity[i] -= basis[i, 2, k] * calib[k]
    return uv, disparity


@kernel
def _residuals_and_cost(
    poses: Array,
    points: Array,
    calib: Array,
    kf: Ints,
    pt: Ints,
    uv: Array,
    disparity: Array,
    sigma: Array,
    sigma_d: Array,
    cam: Array,
    basis: Array,
    mean: Array,
    info: Array,
) -> tuple[Array, float]:
    uv, disparity = _take_out(uv, disparity, basis, calib)
    r = window_residuals(poses, points, kf, pt, uv, disparity, cam)
    return r, _cost(r, sigma, sigma_d, calib, mean, info)


@kernel
def _updated(poses: Array, slot: Ints, delta: Array) -> Array:
    """The free poses after a left update by their six numbers of ``delta`` each."""
    out = poses.copy()
    for k in range(len(poses)):
        if slot[k] >= 0:
            T = exp_update(delta[6 * slot[k] : 6 * slot[k] + 6], poses[k])
            for i in range(3):
                for j in range(4):
                    out[k, i, j] = T[i, j]
    return out


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
    aligned: DepthAlignment,
    iterations: int,
) -> tuple[Array, Array, Array, Array, float, float]:
    """Levenberg-Marquardt on robust reprojection and disparity errors.

    ``poses`` ``(K, 4, 4)``; ``slot`` ``(K,)``: number of a free pose, -1 = fixed; ``points`` ``(P, 3)``; the N
    observations are sorted by point, those of point j are ``start[j]:start[j + 1]``; ``kf``, ``pt`` ``(N,)`` indices,
    ``uv`` ``(N, 2)``, ``disparity`` ``(N,)`` NaN where unknown, ``sigma``, ``sigma_d`` ``(N,)`` pixels. Calibration:
    ``basis`` ``(N, 3, C)``, start and prior mean ``(C,)``, prior information ``(C, C)``; C = 0 keeps it out.
    ``aligned``: pairs of poses by their depth images. Returns poses, points, calibration, the calibration's
    information, cost before and after; the cost never rises.

    Python between compiled kernels: a compiled loop would contain all of them and take ten seconds to compile.
    """
    basis = np.ascontiguousarray(basis)
    seen, prior = (kf, pt, uv, disparity, sigma, sigma_d, cam, basis), (calib_mean, calib_info)
    free, n_c = int(slot.max()) + 1, basis.shape[2]
    m, n, n_points = 6 * free + n_c, len(kf), len(points)
    U, b_c, S = np.empty((m, m)), np.empty(m), np.zeros((m, m))
    V, b_p, V_inv = np.empty((n_points, 3, 3)), np.empty((n_points, 3)), np.empty((n_points, 3, 3))
    W, Wc = np.empty((n, 6, 3)), np.empty((n_points, n_c, 3))
    poses, points, calib = poses.copy(), points.copy(), calib.copy()
    r, cost = _residuals_and_cost(poses, points, calib, *seen, *prior)
    cost += aligned.cost_at(poses)
    first, damping, relinearise = cost, 1e-4, True
    for _ in range(iterations):
        if relinearise:
            given = (kf, disparity, sigma, sigma_d, cam, r, basis, free, calib, *prior)
            assemble(poses, slot, points, start, *given, U, b_c, V, b_p, W, Wc)
            aligned.add_to(U, b_c, poses, slot)
        S, rhs = reduce_points(slot, start, kf, n_c, free, U, b_c, V, b_p, W, Wc, V_inv, damping)
        delta = solve_symmetric(S, -rhs.reshape(m, 1)).reshape(m)
        new_poses, new_points, new_calib = _updated(poses, slot, delta), points.copy(), calib + delta[6 * free :]
        back_substitute(slot, start, kf, n_c, free, delta, b_p, W, Wc, V_inv, new_points)
        new_r, new_cost = _residuals_and_cost(new_poses, new_points, new_calib, *seen, *prior)
        new_cost += aligned.cost_at(new_poses)
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


def _marginal(S: Array, first: int) -> Array:
    """Information of the unknowns from ``first`` on when all others are left free."""
    if first == 0 or first == len(S):
        return S[first:, first:].copy()
    across = S[:first, first:].copy()
    solved = solve_symmetric(S[:first, :first].copy(), across)
    return np.asarray(S[first:, first:] - weighted_gram(across, np.ones(first), solved))
