"""Points from rays of several key-frames: compiled."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


@njit(cache=True, nogil=True)
def triangulate(poses: Array, start: NDArray[np.int64], kf: NDArray[np.int64], rays: Array) -> tuple[Array, Array]:
    """Point nearest to all its rays, and the widest angle between them.

    ``poses`` ``(K, 4, 4)`` ``T_C_W``; rays of point j are rows ``start[j]:start[j + 1]`` of ``kf`` and ``rays`` ``(N,
    3)`` (camera frame). Returns points ``(P, 3)``, NaN where the rays are parallel or the point is behind a camera,
    and parallaxes ``(P,)`` in radians.
    """
    count = len(start) - 1
    points, parallax = np.full((count, 3), np.nan), np.zeros(count)
    for j in range(count):
        A, b = np.zeros((3, 3)), np.zeros(3)
        first = np.zeros(3)
        least = 1.0
        for i in range(start[j], start[j + 1]):
            R = np.ascontiguousarray(poses[kf[i], :3, :3])
            d = R.T @ rays[i]
            d /= np.sqrt((d * d).sum())
            centre = -(R.T @ np.ascontiguousarray(poses[kf[i], :3, 3]))
            for a in range(3):
                for c in range(3):
                    m = (1.0 if a == c else 0.0) - d[a] * d[c]
                    A[a, c] += m
                    b[a] += m * centre[c]
            if i == start[j]:
                first[:] = d
            else:
                least = min(least, (first * d).sum())
        parallax[j] = np.arccos(max(min(least, 1.0), -1.0))
        if start[j + 1] - start[j] < 2 or parallax[j] < 1e-4:
            continue
        p = np.linalg.solve(A, b)
        ahead = True
        for i in range(start[j], start[j + 1]):
            T = poses[kf[i]]
            if T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3] <= 0:
                ahead = False
        if ahead:
            points[j] = p
    return points, parallax
