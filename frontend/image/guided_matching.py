"""ORB matching near predicted positions: compiled."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from ..config import MappingConfig


@dataclass(frozen=True)
class OrbFeatures:
    """n points with a look: ``uv`` ``(n, 2)`` pixels, ``level`` ``(n,)`` of the pyramid (predicted ones may be
    fractions), ``descriptors`` ``(n, 32)``."""

    uv: NDArray[np.float64]
    level: NDArray[np.float64] | NDArray[np.int8]
    descriptors: NDArray[np.uint8]


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
    predicted: OrbFeatures,
    radius: NDArray[np.float64],
    keypoints: OrbFeatures,
    settings: MappingConfig,
    level_slack: float = 1.5,
) -> NDArray[np.int64]:
    """For each of n ``predicted`` points the key-point ``(n,)`` that matches best, -1 for none; none is given twice.

    ``radius`` ``(n,)`` pixels; ``level_slack``: largest difference of the levels.
    """
    if not len(predicted.uv) or not len(keypoints.uv):
        return np.full(len(predicted.uv), -1, dtype=np.int64)
    words_a, words_b = (np.ascontiguousarray(x.descriptors).view(np.uint64) for x in (predicted, keypoints))
    downwards = np.argsort(keypoints.uv[:, 1])
    rows = keypoints.uv[downwards, 1]
    first = np.searchsorted(rows, predicted.uv[:, 1] - radius)
    last = np.searchsorted(rows, predicted.uv[:, 1] + radius, side="right")
    points_a = predicted.uv, np.asarray(predicted.level, dtype=np.float64), words_a
    points_b = keypoints.uv, np.asarray(keypoints.level, dtype=np.int8), words_b
    limits = level_slack, settings.match_distance, settings.match_ratio
    return _guided(*points_a, *points_b, radius, downwards, first, last, *limits)
