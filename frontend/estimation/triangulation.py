"""Points from rays of several key-frames: compiled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .linear_algebra import solve_symmetric

Array = NDArray[np.float64]


@kernel
def triangulate(poses: Array, start: NDArray[np.int64], kf: NDArray[np.int64], rays: Array) -> tuple[Array, Array]:
    """Point nearest to all its rays, and the widest angle between them.

    ``poses`` ``(K, 4, 4)`` ``T_C_W``; rays of point j are rows ``start[j]:start[j + 1]`` of ``kf`` and ``rays`` ``(N,
    3)`` (camera frame). Returns points ``(P, 3)``, NaN where the rays are parallel or the point is behind a camera,
    and parallaxes ``(P,)`` in radians.
    """
    count = len(start) - 1
    points, parallax = np.full((count, 3), np.nan), np.zeros(count)
    d, centre = np.zeros(3), np.zeros(3)
    for j in range(count):
        A, b = np.zeros((3, 3)), np.zeros((3, 1))
        first = np.zeros(3)
        least = 1.0
        for i in range(start[j], start[j + 1]):
            T = poses[kf[i]]
            for a in range(3):
                d[a] = T[0, a] * rays[i, 0] + T[1, a] * rays[i, 1] + T[2, a] * rays[i, 2]
                centre[a] = -(T[0, a] * T[0, 3] + T[1, a] * T[1, 3] + T[2, a] * T[2, 3])
            length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
            for a in range(3):
                d[a] /= length
            for a in range(3):
                for c in range(3):
                    m = (1.0 if a == c else 0.0) - d[a] * d[c]
                    A[a, c] += m
                    b[a, 0] += m * centre[c]
            if i == start[j]:
                first[0], first[1], first[2] = d[0], d[1], d[2]
            else:
                least = min(least, first[0] * d[0] + first[1] * d[1] + first[2] * d[2])
        parallax[j] = np.arccos(max(min(least, 1.0), -1.0))
        if start[j + 1] - start[j] < 2 or parallax[j] < 1e-4:
            continue
        p = solve_symmetric(A, b).reshape(3)
        ahead = True
        for i in range(start[j], start[j + 1]):
            T = poses[kf[i]]
            if T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3] <= 0:
                ahead = False
        if ahead:
            points[j, 0], points[j, 1], points[j, 2] = p[0], p[1], p[2]
    return points, parallax
