"""Points of a map moved to where their views see them, poses fixed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .geometry import Array

_STEPS = 10
_ROBUST_PX = 2.0
"""Cauchy's width: views much farther off do not count."""
_TRUST = 0.05
"""Standard deviation of the map's own position, share of the distance from the first camera that sees the point: what
views of little parallax leave open stays as it was."""


def refit_points(
    points: Array, start: NDArray[np.int64], image: NDArray[np.int64], uv: Array, poses: Array, cameras: Array
) -> Array:
    """``points`` ``(P, 3)`` moved to the least robust reprojection error; those of less than two views stay.

    Point j has the views ``start[j]`` to ``start[j + 1]``: in ``image`` ``(n,)`` at ``uv`` ``(n, 2)`` pixels. ``poses``
    ``(I, 4, 4)`` ``T_C_W`` and ``cameras`` ``(I, 4)`` fx, fy, cx, cy of the images.
    """
    out = np.ascontiguousarray(points, dtype=np.float64).copy()
    arrays = np.ascontiguousarray(uv, dtype=np.float64), np.ascontiguousarray(poses), np.ascontiguousarray(cameras)
    _refit(out, start.astype(np.int64), image.astype(np.int64), *arrays)
    return out


@kernel
def _cost(
    x: Array, first: int, last: int, image: NDArray[np.int64], uv: Array, poses: Array, cameras: Array, known: Array,
    precision: float,
) -> float:  # fmt: skip
    cost = 0.0
    for k in range(3):
        cost += 0.5 * precision * (x[k] - known[k]) ** 2
    for v in range(first, last):
        T, c = poses[image[v]], cameras[image[v]]
        z = T[2, 0] * x[0] + T[2, 1] * x[1] + T[2, 2] * x[2] + T[2, 3]
        if z <= 0.0:
            return np.inf
        du = c[0] * (T[0, 0] * x[0] + T[0, 1] * x[1] + T[0, 2] * x[2] + T[0, 3]) / z + c[2] - uv[v, 0]
        dv = c[1] * (T[1, 0] * x[0] + T[1, 1] * x[1] + T[1, 2] * x[2] + T[1, 3]) / z + c[3] - uv[v, 1]
        cost += 0.5 * _ROBUST_PX * _ROBUST_PX * np.log(1.0 + (du * du + dv * dv) / (_ROBUST_PX * _ROBUST_PX))
    return cost


@kernel
def _refit(
    points: Array, start: NDArray[np.int64], image: NDArray[np.int64], uv: Array, poses: Array, cameras: Array
) -> None:
    H, b, x, J = np.zeros((3, 3)), np.zeros(3), np.zeros(3), np.zeros((2, 3))
    for j in range(len(points)):
        first, last = start[j], start[j + 1]
        if last - first < 2:
            continue
        known = points[j].copy()
        T = poses[image[first]]
        away = 0.0
        for k in range(3):
            away += (T[k, 0] * known[0] + T[k, 1] * known[1] + T[k, 2] * known[2] + T[k, 3]) ** 2
        precision = 1.0 / max(_TRUST * _TRUST * away, 1e-12)
        before = _cost(known, first, last, image, uv, poses, cameras, known, precision)
        if not np.isfinite(before):
            continue
        for _ in range(_STEPS):
            H[:], b[:] = 0.0, 0.0
            now = points[j]
            for k in range(3):
                H[k, k] = precision
                b[k] = precision * (known[k] - now[k])
            for v in range(first, last):
                T, c = poses[image[v]], cameras[image[v]]
                px = T[0, 0] * now[0] + T[0, 1] * now[1] + T[0, 2] * now[2] + T[0, 3]
                py = T[1, 0] * now[0] + T[1, 1] * now[1] + T[1, 2] * now[2] + T[1, 3]
                z = T[2, 0] * now[0] + T[2, 1] * now[1] + T[2, 2] * now[2] + T[2, 3]
                du, dv = uv[v, 0] - c[0] * px / z - c[2], uv[v, 1] - c[1] * py / z - c[3]
                w = 1.0 / (1.0 + (du * du + dv * dv) / (_ROBUST_PX * _ROBUST_PX))
                for k in range(3):
                    J[0, k] = c[0] * (T[0, k] - px / z * T[2, k]) / z
                    J[1, k] = c[1] * (T[1, k] - py / z * T[2, k]) / z
                for k in range(3):
                    b[k] += w * (J[0, k] * du + J[1, k] * dv)
                    for i in range(3):
                        H[k, i] += w * (J[0, k] * J[0, i] + J[1, k] * J[1, i])
            c00, c01 = H[1, 1] * H[2, 2] - H[1, 2] ** 2, H[0, 2] * H[1, 2] - H[0, 1] * H[2, 2]
            c02 = H[0, 1] * H[1, 2] - H[0, 2] * H[1, 1]
            c11, c12 = H[0, 0] * H[2, 2] - H[0, 2] ** 2, H[0, 1] * H[0, 2] - H[0, 0] * H[1, 2]
            c22 = H[0, 0] * H[1, 1] - H[0, 1] ** 2
            det = H[0, 0] * c00 + H[0, 1] * c01 + H[0, 2] * c02
            if not det > 0.0:
                break
            x[0] = now[0] + (c00 * b[0] + c01 * b[1] + c02 * b[2]) / det
            x[1] = now[1] + (c01 * b[0] + c11 * b[1] + c12 * b[2]) / det
            x[2] = now[2] + (c02 * b[0] + c12 * b[1] + c22 * b[2]) / det
            after = _cost(x, first, last, image, uv, poses, cameras, known, precision)
            if not after < before:
                break
            gained = before - after
            points[j, 0], points[j, 1], points[j, 2] = x[0], x[1], x[2]
            before = after
            if gained < 1e-4 * after:
                break
