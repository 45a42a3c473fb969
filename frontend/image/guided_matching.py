"""ORB matching near predicted positions: compiled, arrays in, arrays out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel


@kernel
def _popcount(x: np.uint64) -> np.uint64:
    x = x - ((x >> np.uint64(1)) & np.uint64(0x5555555555555555))
    x = (x & np.uint64(0x3333333333333333)) + ((x >> np.uint64(2)) & np.uint64(0x3333333333333333))
    x = (x + (x >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (x * np.uint64(0x0101010101010101)) >> np.uint64(56)


@kernel
def _guided(
    uv_a: NDArray[np.float64],
    level_a: NDArray[np.float64],
    words_a: NDArray[np.uint64],
    uv_b: NDArray[np.float64],
    level_b: NDArray[np.int8],
    words_b: NDArray[np.uint64],
    radius: NDArray[np.float64],
    downwards: NDArray[np.int64],
    first: NDArray[np.int64],
    last: NDArray[np.int64],
    level_slack: float,
    max_distance: int,
    ratio: float,
) -> NDArray[np.int64]:
    """``downwards``: the key-points b from the top of the image to its foot; ``first``, ``last`` ``(n,)``: where in it
    the rows within the radius of each point a begin and end."""
    out = np.full(len(uv_a), -1, dtype=np.int64)
    distance_of = np.full(len(uv_b), 257, dtype=np.int64)
    owner = np.full(len(uv_b), -1, dtype=np.int64)
    for i in range(len(uv_a)):
        best, second, index = np.int64(257), np.int64(257), np.int64(-1)
        r2 = radius[i] * radius[i]
        for place in range(first[i], last[i]):
            j = downwards[place]
            dx, dy = uv_a[i, 0] - uv_b[j, 0], uv_a[i, 1] - uv_b[j, 1]
            if dx * dx + dy * dy > r2 or abs(level_a[i] - level_b[j]) > level_slack:
                continue
            d = np.int64(0)
            for k in range(4):
                d += np.int64(_popcount(words_a[i, k] ^ words_b[j, k]))
            if d < best or (d == best and j < index):
                best, second, index = d, best, j
            elif d < second:
                second = d
        if index >= 0 and best <= max_distance and best <= ratio * second and best < distance_of[index]:
            if owner[index] >= 0:
                out[owner[index]] = -1
            owner[index], distance_of[index], out[i] = i, best, index
    return out


def guided_match(
    uv_a: NDArray[np.float64],
    level_a: NDArray[np.float64],
    descriptors_a: NDArray[np.uint8],
    uv_b: NDArray[np.float64],
    level_b: NDArray[np.int8],
    descriptors_b: NDArray[np.uint8],
    radius: NDArray[np.float64],
    max_distance: int,
    ratio: float,
    level_slack: float = 1.5,
) -> NDArray[np.int64]:
    """For each predicted point a the key-point b ``(n,)`` that matches best, -1 for none; no b is given twice.

    ``uv`` pixels, ``level`` pyramid level (predicted ones may be fractions), ``descriptors`` ``(n, 32)``; ``radius``
    ``(n,)`` pixels.
    """
    if not len(uv_a) or not len(uv_b):
        return np.full(len(uv_a), -1, dtype=np.int64)
    words_a = np.ascontiguousarray(descriptors_a).view(np.uint64)
    words_b = np.ascontiguousarray(descriptors_b).view(np.uint64)
    downwards = np.argsort(uv_b[:, 1])
    rows = uv_b[downwards, 1]
    first = np.searchsorted(rows, uv_a[:, 1] - radius)
    last = np.searchsorted(rows, uv_a[:, 1] + radius, side="right")
    points_a, points_b = (uv_a, level_a, words_a), (uv_b, level_b, words_b)
    return _guided(*points_a, *points_b, radius, downwards, first, last, level_slack, max_distance, ratio)
