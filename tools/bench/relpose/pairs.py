"""Pairs of key-frames with known truth: right ones, which show one place, and look-alike wrong ones, hardest first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, se3_inverse
from maslam.frontend.config import OdometryConfig
from maslam.frontend.frames import Frame
from maslam.frontend.image.orb_features import Detector, Pyramid, describe
from maslam.frontend.mapping.range_sensor import Ranging

from .places import StereoVisit, angle_between_deg, seen_share, shared_view

# Two views that share less of what either sees show different places.
_APART = 0.02


@dataclass(frozen=True, eq=False)
class KeyPoints:
    """Result of the front end for one view: ``points_C`` ``(n, 3)`` from stereo, NaN where there is none;
    ``descriptors`` ``(n, 32)``; ``words`` ``(n,)`` at level 4."""

    points_C: Array
    descriptors: NDArray[np.uint8]
    words: NDArray[np.int32]


@dataclass(frozen=True)
class Pair:
    """Rows of the ``query`` and ``match`` views; ``T_M_Q`` ``(4, 4)``; ``shared``: of the view, 0 to 1; ``angle_deg``
    between the directions of view. ``right``: they show one place."""

    query: int
    match: int
    right: bool
    T_M_Q: Array
    shared: float
    angle_deg: float


def key_points(visit: StereoVisit, words: Callable[[NDArray[np.uint8]], NDArray[np.int32]]) -> KeyPoints:
    """ORB key-points of a new key-frame and their stereo depth, by the odometry's own detector and matcher."""
    config = OdometryConfig()
    features = config.features
    pyramid = Pyramid(visit.left, features.levels, features.scale_factor)
    uv, level, _ = Detector(features).detect(pyramid, features.tracks + features.landmarks, np.zeros((0, 2)))
    found = describe(pyramid, uv, level)
    ranging = Ranging(visit.rig, config.stereo, config.flow)
    disparity, _ = ranging.measure(Frame(0, 0, visit.left, visit.right), uv, np.full(len(uv), np.nan))
    kept = np.isfinite(found.angle_deg)
    points = ranging.back_project(uv, disparity)[kept]
    descriptors = found.descriptors[kept]
    return KeyPoints(points, descriptors, words(descriptors)[:, 1].astype(np.int32))


def right_pairs(visits: list[StereoVisit]) -> list[Pair]:
    """The two visits of each place."""
    return [
        _pair(visits, row + 1, row, True)
        for row in range(len(visits) - 1)
        if visits[row].place >= 0 and visits[row].place == visits[row + 1].place
    ]


def look_alike_pairs(visits: list[StereoVisit], vectors: NDArray[np.float32], count: int) -> list[Pair]:
    """``count`` pairs that share no surface, those of nearest place ``vectors`` ``(n, dim)`` first."""
    first, second = np.triu_indices(len(visits), 1)
    distances = np.linalg.norm(vectors[first] - vectors[second], axis=1)
    out: list[Pair] = []
    for k in np.argsort(distances, kind="stable"):
        if len(out) == count:
            break
        a, b = visits[first[k]], visits[second[k]]
        if a.place == b.place >= 0 or max(seen_share(a, b), seen_share(b, a)) > _APART:
            continue
        out.append(_pair(visits, int(first[k]), int(second[k]), False))
    return out


def _pair(visits: list[StereoVisit], query: int, match: int, right: bool) -> Pair:
    q, m = visits[query], visits[match]
    T_M_Q = se3_inverse(m.T_W_C) @ q.T_W_C
    return Pair(query, match, right, T_M_Q, shared_view(q, m), angle_between_deg(q, m))
