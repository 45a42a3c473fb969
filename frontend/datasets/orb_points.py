"""ORB key-points of two images that are each other's nearest. OpenCV's, not the odometry's: an opinion of its own."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_BITS = 256


@dataclass(frozen=True)
class OrbPoints:
    """Key-points at ``uv`` ``(n, 2)`` pixels; ``signs`` ``(n, 256)``: the bits of their descriptors, as 1 and -1."""

    uv: NDArray[np.float32]
    signs: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.uv)


@dataclass(frozen=True)
class PairMatches:
    """Points of the left image, ``left_uv`` ``(n, 2)`` pixels, found in the right one at ``right_uv``; wrong ones are
    among them. ``features``: how many points the left image has."""

    left_uv: NDArray[np.float32]
    right_uv: NDArray[np.float32]
    features: int


def find_points(image: NDArray[np.uint8] | None, count: int) -> OrbPoints:
    """At most ``count`` key-points; none of None."""
    none = OrbPoints(np.zeros((0, 2), np.float32), np.zeros((0, _BITS), np.float32))
    if image is None:
        return none
    points, descriptors = cv2.ORB.create(nfeatures=count).detectAndCompute(image, None)
    if descriptors is None:
        return none
    uv = np.array([point.pt for point in points], dtype=np.float32).reshape(-1, 2)
    return OrbPoints(uv, 2 * np.unpackbits(np.asarray(descriptors), axis=1).astype(np.float32) - 1)


def match_points(left: OrbPoints, right: OrbPoints, at_most: int) -> PairMatches:
    """Points that are each other's nearest, the first of equals, with at most so many bits different.

    What ``cv2.BFMatcher`` finds with ``crossCheck``, in a third of the time: sums of 256 signs, which are exact in any
    order, instead of bits counted in both directions.
    """
    if not len(left) or not len(right):
        return PairMatches(left.uv[:0], right.uv[:0], len(left))
    alike = left.signs @ right.signs.T
    nearest = alike.argmax(axis=1)
    rows = np.flatnonzero(alike.argmax(axis=0)[nearest] == np.arange(len(left)))
    rows = rows[_BITS - alike[rows, nearest[rows]] <= 2 * at_most]
    return PairMatches(left.uv[rows], right.uv[nearest[rows]], len(left))
