"""Robust least squares for the pose between two cameras that see the same points, with an honest uncertainty.

Each camera measures a point's direction well and its depth badly: the inverse depth has about the same error everywhere (stereo).
So residuals are direction (2) and inverse depth (1) in the match camera, weighted by the noise of both measurements; far points
then do not pull. Both noise levels are unknown (bundle adjusted points are better than one stereo pair) and are estimated from the
residuals. Gauss-Newton with Cauchy weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from backend.geometry import Array, Sim3, so3_exp

ITERATIONS = 12
# A tenth of a pixel of a common camera; noise below it is not believed.
_MIN_ANGLE_SIGMA = np.radians(0.01)
_START_ANGLE_SIGMA = np.radians(0.3)
# Inverse depth noise, as a share of the inverse of the median depth: where it starts, and what is not believed any more.
_START_DEPTH_SIGMA, _MIN_DEPTH_SIGMA = 0.1, 0.003
_MAD_TO_SIGMA = 1.4826


@dataclass(frozen=True, eq=False)
class Alignment:
    """A refined ``T_M_Q``; ``information`` ``(6, 6)`` of its rigid part, translation first, in the match's unit (scale marginalised).

    ``angle_sigma`` radians and ``depth_sigma`` (inverse units of the match): the noise found.
    """

    T_M_Q: Sim3
    information: Array
    angle_sigma: float
    depth_sigma: float


def refine(
    points_M: Array, points_Q: Array, start: Sim3, with_scale: bool, loss_scale: float, iterations: int = ITERATIONS
) -> Alignment:
    """Refine ``start`` on matched points ``(k, 3)``, k >= 3, most of which should be right."""
    T, size = start, 7 if with_scale else 6
    points_M, points_Q = np.ascontiguousarray(points_M), np.ascontiguousarray(points_Q)
    unit = 1.0 / float(np.median(np.linalg.norm(points_M, axis=1)))
    angle, depth = _START_ANGLE_SIGMA, _START_DEPTH_SIGMA * unit
    hessian = np.zeros((7, 7))
    for iteration in range(iterations):
        hessian, gradient, ratios = _normal_equations(
            points_M, points_Q, T.rotation, T.translation, T.scale, angle, depth, loss_scale
        )
        # A trace of damping keeps degenerate sets from flying off; it is far below any real information.
        damped = hessian[:size, :size] + np.diag(1e-9 * np.diag(hessian[:size, :size]) + 1e-12)
        step = np.zeros(7)
        step[:size] = -np.linalg.solve(damped, gradient[:size])
        T = _moved(T, step)
        if iteration < ITERATIONS // 2:
            # The noise at which the typical residual is as large as its covariance says.
            typical = _MAD_TO_SIGMA * np.median(ratios, axis=0)
            angle = float(max(angle * 0.5 * (typical[0] + typical[1]), _MIN_ANGLE_SIGMA))
            depth = float(np.clip(depth * typical[2], _MIN_DEPTH_SIGMA * unit, unit))
        elif np.abs(step).max() < 1e-10:
            break
    return Alignment(T, _rigid_information(hessian, with_scale), angle, depth)


@njit(cache=True, nogil=True)
def _normal_equations(points_M, points_Q, R, t, s, angle_sigma, depth_sigma, loss_scale):  # type: ignore[no-untyped-def]
    """Hessian ``(7, 7)``, gradient ``(7,)`` and ``|residual| / sigma`` ``(k, 3)`` around ``p = s R exp(phi) q + t + R rho``.

    The unknowns are (rho, phi, log scale). A residual's covariance is the match's own noise plus the query's, carried over.
    """
    hessian, gradient = np.zeros((7, 7)), np.zeros(7)
    ratios = np.empty((len(points_M), 3))
    residual, to_point, jacobian = np.empty(3), np.empty((3, 3)), np.empty((3, 7))
    for k in range(len(points_M)):
        m, q = points_M[k], points_Q[k]
        observed = np.sqrt(m @ m)
        b = m / observed
        # Two unit vectors across the observed direction.
        helper = np.zeros(3)
        helper[1 if abs(b[0]) > 0.9 else 0] = 1.0
        e1 = np.cross(b, helper)
        e1 /= np.sqrt(e1 @ e1)
        e2 = np.cross(b, e1)
        turned = R @ q
        p = s * turned + t
        distance = max(np.sqrt(p @ p), 1e-9)
        d = p / distance
        residual[0], residual[1], residual[2] = e1 @ d, e2 @ d, 1.0 / distance - 1.0 / observed
        to_point[0] = (e1 - residual[0] * d) / distance
        to_point[1] = (e2 - residual[1] * d) / distance
        to_point[2] = -d / distance**2
        # Noise of the query's measurement: across its ray, and along it.
        reach = s * np.sqrt(q @ q)
        ray = to_point @ (turned * (s / reach))
        across2, along2 = (angle_sigma * reach) ** 2, depth_sigma**2 * reach**4
        covariance = across2 * (to_point @ to_point.T) + (along2 - across2) * np.outer(ray, ray)
        covariance[0, 0] += angle_sigma**2
        covariance[1, 1] += angle_sigma**2
        covariance[2, 2] += depth_sigma**2
        inverse = np.linalg.inv(covariance)
        for a in range(3):
            ratios[k, a] = abs(residual[a]) / np.sqrt(covariance[a, a])
        weight = 1.0 / (1.0 + (residual @ inverse @ residual) / loss_scale**2)
        # Columns: rho; phi, which moves p by s R (e_a x q); log scale.
        columns = s * (to_point @ R)
        jacobian[:, :3] = columns / s
        jacobian[:, 3] = columns[:, 2] * q[1] - columns[:, 1] * q[2]
        jacobian[:, 4] = columns[:, 0] * q[2] - columns[:, 2] * q[0]
        jacobian[:, 5] = columns[:, 1] * q[0] - columns[:, 0] * q[1]
        jacobian[:, 6] = to_point @ (s * turned)
        weighted = weight * (jacobian.T @ inverse)
        hessian += weighted @ jacobian
        gradient += weighted @ residual
    return hessian, gradient, ratios


def _moved(T: Sim3, step: Array) -> Sim3:
    rotation = T.rotation @ so3_exp(step[3:6])
    return Sim3(rotation, T.translation + T.rotation @ step[:3], T.scale * float(np.exp(np.clip(step[6], -1.0, 1.0))))


def _rigid_information(hessian: Array, with_scale: bool) -> Array:
    information = hessian[:6, :6]
    if with_scale and hessian[6, 6] > 0:
        information = information - np.outer(hessian[:6, 6], hessian[6, :6]) / hessian[6, 6]
    return 0.5 * (information + information.T)
