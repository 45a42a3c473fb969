"""Whether images agree with poses that were given for them: epipolar geometry of key-points that look alike.

Poses of another frame (a body's, a LiDAR's), of another clock, or inverted ones contradict the images; a wrong unit of
length shows where depth was measured.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, product, skew

_FITS_PX, _FITS_SHARE = 2.0, 0.004
"""Distance from the epipolar line at which a match agrees: pixels, or that share of the image's width if it is more."""
_LEAST_MATCHES, _LEAST_CLEAR = 30, 8
_RATIO, _DISTANCE = 0.8, 50
_SURE_PARALLAX_RAD = 0.02
"""Parallax from which a depth by two rays is compared with a measured one."""
_SAME = 1.25
"""Ratio of the two up to which they are the same."""


@dataclass(frozen=True)
class PairAgreement:
    """Of ``matches`` between two key-frames the share ``near`` (0 to 1) on the epipolar lines of their poses; of those
    the number ``clear`` with parallax, and how many of them lie ``ahead`` of both cameras; ``unit``: median ratio of
    depth by the poses to depth measured, NaN where too few were measured; ``compared`` of them, ``same`` of these
    within a quarter."""

    matches: int
    near: float
    clear: int
    ahead: int
    unit: float
    compared: int
    same: int


def agreeing(pairs: Sequence[PairAgreement]) -> float:
    """Share (0 to 1) of matches that agree with the poses, over all ``pairs``: on the lines and in front. Inverted
    poses of a straight path put everything on its line, and behind the cameras."""
    clear = sum(pair.clear for pair in pairs)
    ahead = sum(pair.ahead for pair in pairs) / clear if clear >= _LEAST_CLEAR else 1.0
    return float(np.median([pair.near for pair in pairs])) * ahead


@dataclass(frozen=True)
class PosedView:
    """Key-points of an image: ``rays`` ``(n, 3)`` with z = 1, ``descriptors`` ``(n, 32)``, ``depth`` ``(n,)`` NaN where
    unknown, and its pose ``T_C_W``."""

    rays: Array
    descriptors: NDArray[np.uint8]
    depth: Array
    T_C_W: Array


@dataclass(frozen=True, eq=False)
class MatchedRays:
    """Rays ``first`` and ``second`` ``(n, 3)`` with z = 1 of what looks alike in two images; ``poses``: ``T_C_W`` of
    both; ``depth`` ``(n,)`` measured in the first, NaN where unknown."""

    first: Array
    second: Array
    poses: tuple[Array, Array]
    depth: Array


def matched_rays(first: PosedView, second: PosedView) -> MatchedRays | None:
    """What looks alike in two views; None where that is too little."""
    pairs = mutual_matches(first.descriptors, second.descriptors)
    if len(pairs) < _LEAST_MATCHES:
        return None
    a, b = pairs.T
    return MatchedRays(first.rays[a], second.rays[b], (first.T_C_W, second.T_C_W), first.depth[a])


def rays_agreement(matched: MatchedRays, fx: float, width: int) -> PairAgreement | None:
    """How far matches agree with the poses of their views; None where these did not move apart."""
    R, t = relative(*matched.poses)
    if float(np.linalg.norm(t)) < 1e-9:
        return None
    a, b, measured = matched.first, matched.second, matched.depth
    limit = max(_FITS_PX, _FITS_SHARE * width) / fx
    near = epipolar_distance(a, b, R, t) < limit
    z, parallax = two_view_depth(a, b, R, t)
    clear = near & (parallax > limit)
    known = near & (z > 0) & np.isfinite(measured) & (parallax > _SURE_PARALLAX_RAD)
    ratio = z[known] / measured[known]
    unit = float(np.median(ratio)) if len(ratio) >= _LEAST_MATCHES // 2 else float("nan")
    same = int((np.abs(np.log(ratio)) < np.log(_SAME)).sum())
    counts = int(clear.sum()), int((z[clear] > 0).sum())
    return PairAgreement(len(a), float(near.mean()), *counts, unit, len(ratio), same)


def relative(T_A_W: Array, T_B_W: Array) -> tuple[Array, Array]:
    """Rotation and translation of ``T_B_A``."""
    R = product(T_B_W[:3, :3], T_A_W[:3, :3].T)
    return R, T_B_W[:3, 3] - product(R, T_A_W[:3, 3])


def epipolar_distance(a: Array, b: Array, R: Array, t: Array) -> Array:
    """Distance ``(n,)`` of rays ``b`` (z = 1) from the epipolar lines of rays ``a`` at z = 1 of the second camera."""
    lines = product(a, product(skew(t), R).T)
    return np.asarray(np.abs((lines * b).sum(axis=1)) / np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12))


def all_epipolar_distances(a: Array, b: Array, R: Array, t: Array) -> Array:
    """As :func:`epipolar_distance` for each of ``a`` ``(n, 3)`` with each of ``b`` ``(m, 3)``: ``(n, m)``."""
    lines = product(a, product(skew(t), R).T)
    lines /= np.maximum(np.hypot(lines[:, 0], lines[:, 1]), 1e-12)[:, None]
    return np.asarray(np.abs(product(lines, np.ascontiguousarray(b.T))))


def two_view_depth(a: Array, b: Array, R: Array, t: Array) -> tuple[Array, Array]:
    """Depth ``(n,)`` along the first camera's axis of points on both rays (negative: behind it), and the angle between
    the rays, radians."""
    turned = product(a, R.T)
    across = np.cross(b, turned)
    square = (across**2).sum(axis=1)
    z = -(across * np.cross(b, t)).sum(axis=1) / np.maximum(square, 1e-18)
    lengths = np.linalg.norm(b, axis=1) * np.linalg.norm(turned, axis=1)
    return z, np.arcsin(np.minimum(np.sqrt(square) / lengths, 1.0))


def hamming(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """Bits that differ ``(n, m)`` between descriptors ``(n, 32)`` and ``(m, 32)``."""
    x, y = (np.ascontiguousarray(d).view(np.uint64) for d in (a, b))
    out = np.zeros((len(x), len(y)), dtype=np.uint16)
    for k in range(4):
        out += np.bitwise_count(x[:, k, None] ^ y[None, :, k])
    return out


def mutual_matches(
    a: NDArray[np.uint8], b: NDArray[np.uint8], allowed: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """Rows ``(k, 2)`` of descriptors that are each other's best, clearly better than the second best; among pairs
    ``allowed`` ``(n, m)``."""
    if len(a) < 2 or len(b) < 2:
        return np.zeros((0, 2), dtype=np.int64)
    d = hamming(a, b)
    if allowed is not None:
        d[~allowed] = 257
    best = d.argmin(axis=1)
    rows = np.arange(len(a))
    nearest = d[rows, best].astype(np.int64)
    back = d.argmin(axis=0)[best] == rows
    d[rows, best] = 257
    second = d.min(axis=1)
    good = back & (nearest <= _DISTANCE) & (nearest <= _RATIO * second)
    return np.column_stack([rows[good], best[good]])
