"""Map points refined from all their rays with the poses held: Gauss-Newton on each point by itself, all at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array

Ints = NDArray[np.int64]
_STEPS = 8
_HUBER_SIGMAS = 2.0
_LIMIT_SIGMAS = 3.0
"""A view is left out beyond this many standard deviations; one is a pixel of the view's pyramid level, or what most
views are off by if that is more: given poses may be rougher than images."""
_MEDIAN_2 = 1.177
"""Median length of a residual in two dimensions, in standard deviations."""


@dataclass(frozen=True, eq=False)
class PointRays:
    """N views sorted by point: key-frame ``kf`` and point ``point`` ``(N,)``, ideal pixels ``uv`` ``(N, 2)`` with
    ``sigma_px`` ``(N,)``, ``disparity`` ``(N,)`` pixels, NaN where unknown, with one ``sigma_d``."""

    kf: Ints
    point: Ints
    uv: Array
    sigma_px: Array
    disparity: Array
    sigma_d: float


def refine_points(T_C_W: Array, points: Array, rays: PointRays, cam: Array) -> tuple[Array, NDArray[np.bool_], float]:
    """Points ``(P, 3)`` that fit their views best, the views ``(N,)`` that agree with them, and the median distance of
    a view from its point, pixels.

    ``T_C_W`` ``(K, 4, 4)``; ``points``: where to start; ``cam``: ``[fx, fy, cx, cy, bf]``.
    """
    if not len(rays.kf):
        return points, np.zeros(0, dtype=bool), float("nan")
    R, t = T_C_W[rays.kf, :3, :3], T_C_W[rays.kf, :3, 3]
    starts = np.flatnonzero(np.diff(rays.point, prepend=-1))
    best = points.copy()
    cost = _costs(R, t, best, rays, cam, starts)
    for _ in range(_STEPS):
        residual, jacobian = _linear(R, t, best, rays, cam)
        weight = _huber(residual)
        weighted = jacobian * weight[:, :, None]
        H = np.add.reduceat(np.einsum("nki,nkj->nij", weighted, jacobian), starts)
        g = np.add.reduceat(np.einsum("nki,nk->ni", weighted, residual), starts)
        H += (1e-9 + 1e-6 * np.trace(H, axis1=1, axis2=2))[:, None, None] * np.eye(3)
        moved = best - np.linalg.solve(H, g[:, :, None])[:, :, 0]
        after = _costs(R, t, moved, rays, cam, starts)
        better = after < cost
        best[better], cost[better] = moved[better], after[better]
        if not better.any():
            break
    residual, _ = _linear(R, t, best, rays, cam)
    off = np.hypot(residual[:, 0], residual[:, 1])
    several = np.bincount(rays.point, minlength=len(points))[rays.point] > 1
    typical = float(np.median(off[several])) if several.any() else 0.0
    noise = max(1.0, typical / _MEDIAN_2)
    kept = (off <= _LIMIT_SIGMAS * noise) & (np.abs(residual[:, 2]) <= 2.0 * _LIMIT_SIGMAS)
    return best, kept, float(np.median((off * rays.sigma_px)[several])) if several.any() else float("nan")


def _linear(R: Array, t: Array, points: Array, rays: PointRays, cam: Array) -> tuple[Array, Array]:
    """Residuals ``(N, 3)`` in standard deviations (u, v, disparity; 0 where none) and derivatives ``(N, 3, 3)``."""
    fx, fy, cx, cy, bf = cam
    p = np.einsum("nij,nj->ni", R, points[rays.point]) + t
    z = np.where(p[:, 2] > 1e-6, p[:, 2], 1e-6)
    known = np.isfinite(rays.disparity) & (bf > 0)
    residual = np.stack(
        [
            (fx * p[:, 0] / z + cx - rays.uv[:, 0]) / rays.sigma_px,
            (fy * p[:, 1] / z + cy - rays.uv[:, 1]) / rays.sigma_px,
            np.where(known, (bf / z - np.where(known, rays.disparity, 0.0)) / rays.sigma_d, 0.0),
        ],
        axis=1,
    )
    by_p = np.zeros((len(z), 3, 3))
    by_p[:, 0, 0], by_p[:, 0, 2] = fx / z, -fx * p[:, 0] / z**2
    by_p[:, 1, 1], by_p[:, 1, 2] = fy / z, -fy * p[:, 1] / z**2
    by_p[:, :2] /= rays.sigma_px[:, None, None]
    by_p[:, 2, 2] = np.where(known, -bf / z**2 / rays.sigma_d, 0.0)
    return residual, np.einsum("nki,nij->nkj", by_p, R)


def _huber(residual: Array) -> Array:
    """Weights ``(N, 3)``: of the pixel as a whole, and of the disparity."""
    pixel = np.hypot(residual[:, 0], residual[:, 1])
    sizes = np.stack([pixel, pixel, np.abs(residual[:, 2])], axis=1)
    return np.asarray(np.minimum(1.0, _HUBER_SIGMAS / np.maximum(sizes, 1e-12)))


def _costs(R: Array, t: Array, points: Array, rays: PointRays, cam: Array, starts: Ints) -> Array:
    """Huber cost ``(P,)`` of each point."""
    residual, _ = _linear(R, t, points, rays, cam)
    sizes = np.stack([np.hypot(residual[:, 0], residual[:, 1]), np.abs(residual[:, 2])], axis=1)
    bounded = np.where(sizes <= _HUBER_SIGMAS, 0.5 * sizes**2, _HUBER_SIGMAS * (sizes - 0.5 * _HUBER_SIGMAS))
    return np.asarray(np.add.reduceat(bounded.sum(axis=1), starts))
