"""Robust least squares for the pose between two cameras that see the same points, with an honest uncertainty.

Each camera measures a point's direction well and its depth badly: the inverse depth has about the same error everywhere (stereo).
So residuals are direction (2) and inverse depth (1) in the match camera, weighted by the noise of both measurements; far points
then do not pull. Both noise levels are unknown (bundle adjusted points are better than one stereo pair) and are estimated from the
residuals. Gauss-Newton with Cauchy weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from backend.geometry import Array, Sim3, skew, so3_exp

_ITERATIONS = 12
# A tenth of a pixel of a common camera; noise below it is not believed.
_MIN_ANGLE_SIGMA = np.radians(0.01)
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


def refine(points_M: Array, points_Q: Array, start: Sim3, with_scale: bool, loss_scale: float) -> Alignment:
    """Refine ``start`` on matched points ``(k, 3)``, k >= 3, most of which should be right."""
    T = start
    range_M = np.linalg.norm(points_M, axis=1)
    unit = 1.0 / float(np.median(range_M))
    angle_sigma, depth_sigma = np.radians(0.3), _START_DEPTH_SIGMA * unit
    hessian = np.eye(7)
    for iteration in range(_ITERATIONS):
        residual, to_point = _residuals(points_M, points_Q, T)
        covariance = _covariances(points_Q, T, to_point, angle_sigma, depth_sigma)
        inverse = np.linalg.inv(covariance)
        squared = np.einsum("ka,kab,kb->k", residual, inverse, residual)
        weight = 1.0 / (1.0 + squared / loss_scale**2)
        jacobian = to_point @ _point_jacobians(points_Q, T)
        weighted = np.swapaxes(jacobian, 1, 2) @ (inverse * weight[:, None, None])
        hessian = (weighted @ jacobian).sum(axis=0)
        gradient = (weighted @ residual[:, :, None]).sum(axis=0)[:, 0]
        size = 7 if with_scale else 6
        # A trace of damping keeps degenerate sets from flying off; it is far below any real information.
        damped = hessian[:size, :size] + np.diag(1e-9 * np.diag(hessian[:size, :size]) + 1e-12)
        step = np.zeros(7)
        step[:size] = -np.linalg.solve(damped, gradient[:size])
        T = _moved(T, step)
        if iteration < _ITERATIONS // 2:
            angle_sigma, depth_sigma = _noise(residual, covariance, angle_sigma, depth_sigma, unit)
        elif np.abs(step).max() < 1e-10:
            break
    return Alignment(T, _rigid_information(hessian, with_scale), angle_sigma, depth_sigma)


def _residuals(points_M: Array, points_Q: Array, T: Sim3) -> tuple[Array, Array]:
    """Residuals ``(k, 3)``: direction of the predicted point across the observed one, inverse depth; and d residual / d point."""
    observed = np.linalg.norm(points_M, axis=1, keepdims=True)
    across = _across(points_M / observed)
    predicted = T @ points_Q
    distance = np.maximum(np.linalg.norm(predicted, axis=1, keepdims=True), 1e-9)
    bearing = predicted / distance
    direction = np.einsum("kca,kc->ka", across, bearing)
    residual = np.concatenate([direction, 1.0 / distance - 1.0 / observed], axis=1)
    tangent = (np.eye(3) - bearing[:, :, None] * bearing[:, None, :]) / distance[:, :, None]
    to_point = np.concatenate([np.swapaxes(across, 1, 2) @ tangent, -(bearing / distance**2)[:, None, :]], axis=1)
    return residual, to_point


def _across(bearings: Array) -> Array:
    """Two unit vectors ``(k, 3, 2)`` across each unit vector ``(k, 3)``."""
    helper = np.where(np.abs(bearings[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    first = np.cross(bearings, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(bearings, first)], axis=2)


def _covariances(points_Q: Array, T: Sim3, to_point: Array, angle_sigma: float, depth_sigma: float) -> Array:
    """Covariances ``(k, 3, 3)`` of the residuals: noise of the match's measurement plus that of the query's, carried over."""
    distance = np.linalg.norm(points_Q, axis=1, keepdims=True)
    ray = points_Q / distance
    reach = (T.scale * distance)[:, :, None]
    along = ray[:, :, None] * ray[:, None, :]
    in_Q = (angle_sigma * reach) ** 2 * (np.eye(3) - along) + depth_sigma**2 * reach**4 * along
    carried = to_point @ T.rotation
    own = np.diag([angle_sigma**2, angle_sigma**2, depth_sigma**2])
    return own + carried @ in_Q @ np.swapaxes(carried, 1, 2)


def _point_jacobians(points_Q: Array, T: Sim3) -> Array:
    """d point / d (rho, phi, log scale) ``(k, 3, 7)``; rho in the match's unit: ``p = s R exp(phi) q + t + R rho``."""
    out = np.empty((len(points_Q), 3, 7))
    out[:, :, :3] = T.rotation
    out[:, :, 3:6] = -T.scale * T.rotation @ skew(points_Q)
    out[:, :, 6] = T.scale * points_Q @ T.rotation.T
    return out


def _moved(T: Sim3, step: Array) -> Sim3:
    rotation = T.rotation @ so3_exp(step[3:6])
    return Sim3(rotation, T.translation + T.rotation @ step[:3], T.scale * float(np.exp(np.clip(step[6], -1.0, 1.0))))


def _noise(residual: Array, covariance: Array, angle: float, depth: float, unit: float) -> tuple[float, float]:
    """Noise levels at which the typical residual is as large as its covariance says."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    typical = _MAD_TO_SIGMA * np.median(np.abs(residual) / sigma, axis=0)
    return (
        float(max(angle * 0.5 * (typical[0] + typical[1]), _MIN_ANGLE_SIGMA)),
        float(np.clip(depth * typical[2], _MIN_DEPTH_SIGMA * unit, unit)),
    )


def _rigid_information(hessian: Array, with_scale: bool) -> Array:
    information = hessian[:6, :6]
    if with_scale and hessian[6, 6] > 0:
        information = information - np.outer(hessian[:6, 6], hessian[6, :6]) / hessian[6, 6]
    return 0.5 * (information + information.T)
