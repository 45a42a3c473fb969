"""Window bundle adjustment: key-frame poses, points and the stereo rig's residual calibration, by a Schur complement.

``cam`` is ``[fx, fy, cx, cy, bf]``; poses are ``T_C_W``. A measured ``(u, v,
disparity)`` is modelled as the ideal one plus ``basis @ calib``: what the rig's residual calibration
(:mod:`maslam.frontend.estimation.self_calibration`) does at that place of the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maslam._kernels import kernel

from .depth_alignment import DepthAlignment
from .linear_algebra import solve_symmetric, weighted_gram
from .pose_refinement import exp_update
from .schur import (
    Array,
    Estimate,
    Ints,
    NormalEquations,
    Window,
    assemble,
    back_substitute,
    reduce_points,
    robust_weights,
)

_CONVERGED = 2e-4
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
def _cost(r: Array, sigma: Array, sigma_d: Array, calib: Array, mean: Array, information: Array) -> float:
    total = 0.0
    for i in range(len(r)):
        if np.isnan(r[i, 0]):
            total += 1e4
            continue
        total += robust_weights(r[i, 0] ** 2 + r[i, 1] ** 2, r[i, 2], sigma[i], sigma_d[i])[2]
    for a in range(len(calib)):
        for c in range(len(calib)):
            total += information[a, c] * (calib[a] - mean[a]) * (calib[c] - mean[c])
    return total


@kernel
def _without_calibration(uv: Array, disparity: Array, basis: Array, calib: Array) -> tuple[Array, Array]:
    """Positions and disparities without what the calibration adds to them."""
    uv, disparity = uv.copy(), disparity.copy()
    for i in range(len(uv)):
        for k in range(len(calib)):
            uv[i, 0] -= basis[i, 0, k] * calib[k]
            uv[i, 1] -= basis[i, 1, k] * calib[k]
            disparity[i] -= basis[i, 2, k] * calib[k]
    return uv, disparity


@kernel
def _residuals_and_cost(estimate: Estimate, window: Window) -> tuple[Array, float]:
    poses, points, calib = estimate.poses, estimate.points, estimate.calib
    seen = window.seen
    kf, pt, uv, disparity, sigma, sigma_d = seen.kf, seen.pt, seen.uv, seen.disparity, seen.sigma, seen.sigma_d
    uv, disparity = _without_calibration(uv, disparity, window.basis, calib)
    r = window_residuals(poses, points, kf, pt, uv, disparity, window.cam)
    return r, _cost(r, sigma, sigma_d, calib, window.mean, window.information)


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


@dataclass(frozen=True)
class AdjustedWindow:
    """Result of :func:`adjust_window`: the ``estimate``; the ``information`` ``(C, C)`` on its calibration, prior
    included; robust cost before and after."""

    estimate: Estimate
    information: Array
    cost_before: float
    cost_after: float


def adjust_window(begin: Estimate, window: Window, aligned: DepthAlignment, iterations: int) -> AdjustedWindow:
    """Levenberg-Marquardt on robust reprojection and disparity errors, from ``begin``; the cost never rises.

    ``aligned``: pairs of poses by their depth images; ``iterations``: steps at most.

    Python between compiled kernels: a compiled loop would contain all of them and take ten seconds to compile.
    """
    window = window._replace(basis=np.ascontiguousarray(window.basis))
    equations = NormalEquations.room_for(window)
    m, n_c, links = len(equations.b_c), window.basis.shape[2], (window.slot, window.seen.start, window.seen.kf)
    S, now = np.zeros((m, m)), begin
    r, cost = _residuals_and_cost(now, window)
    cost += aligned.cost_at(now.poses)
    first, damping, relinearise = cost, 1e-4, True
    for _ in range(iterations):
        if relinearise:
            equations.clear()
            assemble(now, window, r, equations)
            aligned.add_to(equations.U, equations.b_c, now.poses, window.slot)
        S, rhs = reduce_points(*links, equations, damping)
        delta = solve_symmetric(S, -rhs.reshape(m, 1)).reshape(m)
        new = Estimate(_updated(now.poses, window.slot, delta), now.points.copy(), now.calib + delta[m - n_c :])
        back_substitute(*links, equations, delta, new.points)
        new_r, new_cost = _residuals_and_cost(new, window)
        new_cost += aligned.cost_at(new.poses)
        if new_cost < cost:
            gain = (cost - new_cost) / cost
            now, r, cost = new, new_r, new_cost
            damping = max(damping * 0.2, 1e-8)
            relinearise = True
            if gain < _CONVERGED:
                break
        else:
            damping *= 10.0
            relinearise = False
            if damping > 1e6:
                break
    return AdjustedWindow(now, _marginal(S, m - n_c), first, cost)


def _marginal(S: Array, first: int) -> Array:
    """Information of the unknowns from ``first`` on when all others are left free."""
    if first == 0 or first == len(S):
        return S[first:, first:].copy()
    across = S[:first, first:].copy()
    solved = solve_symmetric(S[:first, :first].copy(), across)
    return np.asarray(S[first:, first:] - weighted_gram(across, np.ones(first), solved))
