"""Evidence for and against a relative pose: of the points that both cameras should see, how many look the same,
how many look otherwise, and how many float in front of a surface that the other camera sees behind them.

Matches alone cannot tell two rooms of one pattern apart: any number of them is right on paint that repeats. What is
missing can: a poster that only one view has, a cupboard that stands where the other camera looks through.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maslam._kernels import kernel

from ..geometry import Array, Sim3
from .matching import Distances

# Neighbours within this angle tell the depth of the surface that a camera sees in some direction; so many are needed.
_SURFACE_DEG, _SURFACE_POINTS = 2.0, 3
# A point floats when it is nearer than all of them, by so many standard deviations and this share of the depth.
_FLOAT_SIGMAS, _FLOAT_SHARE = 3.0, 0.03
# The same for points of both views that may be one.
_SAME_SIGMAS = 4.0


@dataclass(frozen=True)
class Side:
    """Counts over the ``points`` of one view.

    ``visible``: in the other camera's field of view; ``tested``: of these, those where it sees a surface; ``floating``:
    of these, those in front of that surface; ``met``: visible points that fall on a point of the other view; ``alike``:
    of these, those with a similar descriptor; ``deserted``: visible points with no similar one among as many of their
    neighbours as should have three (chance alone makes 5 % of them so); ``close``: visible points that meet one within
    half the bound.
    """

    points: int
    visible: int
    tested: int
    floating: int
    met: int
    alike: int
    deserted: int
    close: int

    @property
    def repeated_share(self) -> float:
        """Of the visible points, the share that fall on a point of the other view beyond chance. Chance fills the disc
        evenly: a ring of three times the area measures it."""
        return max(self.close - (self.met - self.close) / 3.0, 0.0) / max(self.visible, 1)

    @property
    def floating_share(self) -> float:
        """Of the tested points, those in front of the surface that the other view sees (0 to 1)."""
        return self.floating / max(self.tested, 1)

    @property
    def deserted_share(self) -> float:
        """Of the visible points, those in a neighbourhood without similar points (0 to 1)."""
        return self.deserted / max(self.visible, 1)


@dataclass(frozen=True)
class Evidence:
    """Evidence in both directions: the query's points in the match's view, the match's points in the query's view, and
    figures of both."""

    query: Side
    match: Side

    @property
    def common(self) -> float:
        """The smaller share of a view's points that the other camera has in view, not hidden."""
        return min(side.visible / max(side.points, 1) for side in (self.query, self.match))

    @property
    def floating(self) -> float:
        """The larger share of floating points: a cupboard floats in front of the wall in one direction only."""
        return max(self.query.floating_share, self.match.floating_share)

    @property
    def deserted(self) -> float:
        """The smaller share of deserted points: one view may see less than the other and still be right."""
        return min(self.query.deserted_share, self.match.deserted_share)

    @property
    def repeated(self) -> float:
        """The larger share of repeated points: each view may see details that the other is too far away for."""
        return max(self.query.repeated_share, self.match.repeated_share)

    @property
    def alike(self) -> float:
        """Share of points with a similar descriptor among those that meet one of the other view."""
        return (self.query.alike + self.match.alike) / max(self.query.met + self.match.met, 1)


def weigh(
    points_M: Array, points_Q: Array, distances: Distances, T_M_Q: Sim3, angle_deg: float, alike: int, sigma: float
) -> Evidence:
    """Evidence for ``T_M_Q`` between all points ``(m, 3)``, ``(n, 3)`` of two views in their cameras' frames.

    ``distances`` ``(n, m)`` of their descriptors, at most ``alike`` for the same point; ``angle_deg``: bearing error of
    the same point; ``sigma``: deviation of an inverse distance of one view, 1 / unit of the match.
    """
    # An inverse distance in the query's unit is larger by the scale; both views' noise enters a difference.
    sigma_M, sigma_Q = np.sqrt(2.0) * sigma, np.sqrt(2.0) * sigma * T_M_Q.scale
    query = _side(T_M_Q @ points_Q, points_M, distances, np.radians(angle_deg), alike, sigma_M)
    match = _side(T_M_Q.inverse() @ points_M, points_Q, distances, np.radians(angle_deg), alike, sigma_Q, True)
    return Evidence(query, match)


def _field(points: Array) -> Array:
    """``(4,)``: left, top, right, bottom of a view in the plane at unit depth, by the points it has."""
    plane = points[:, :2] / np.maximum(points[:, 2:], 1e-9)
    return np.concatenate([plane.min(axis=0), plane.max(axis=0)])


def _side(
    predicted: Array,
    own: Array,
    distances: Distances,
    radius: float,
    alike: int,
    sigma: float,
    transposed: bool = False,
) -> Side:
    """Counts of ``predicted`` ``(n, 3)`` among the ``own`` ``(m, 3)`` points of the camera that they are in;
    ``transposed``: ``distances`` are ``(m, n)``."""
    counts = _count(
        np.ascontiguousarray(predicted),
        np.ascontiguousarray(own),
        distances,
        transposed,
        _field(own),
        np.cos(radius),
        np.cos(0.5 * radius),
        alike,
        np.cos(np.radians(_SURFACE_DEG)),
        _SURFACE_POINTS,
        _SAME_SIGMAS * sigma,
        _FLOAT_SIGMAS * sigma,
        _FLOAT_SHARE,
    )
    return Side(len(predicted), *(int(c) for c in counts))


@kernel
def _count(  # type: ignore[no-untyped-def]
    predicted, own, distances, transposed, field, cos_same, cos_close, alike, cos_surface, enough, same, apart, share
):
    n, m = len(predicted), len(own)
    out = np.zeros(7, dtype=np.int64)
    rays, inverse = np.empty((m, 3)), np.empty(m)
    for j in range(m):
        inverse[j] = 1.0 / max(np.sqrt(own[j, 0] ** 2 + own[j, 1] ** 2 + own[j, 2] ** 2), 1e-9)
        for c in range(3):
            rays[j, c] = own[j, c] * inverse[j]
    seen, similar = np.empty((n, 3)), np.zeros(n, dtype=np.bool_)
    v = 0
    for i in range(n):
        x, y, z = predicted[i, 0], predicted[i, 1], predicted[i, 2]
        if z <= 1e-6 or not (field[0] < x / z < field[2] and field[1] < y / z < field[3]):
            continue
        own_inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
        x, y, z = x * own_inverse, y * own_inverse, z * own_inverse
        around, nearest, farthest, met, close, same_look = 0, 0.0, np.inf, False, False, False
        for j in range(m):
            cos = x * rays[j, 0] + y * rays[j, 1] + z * rays[j, 2]
            if cos < cos_surface:
                continue
            around += 1
            nearest, farthest = max(nearest, inverse[j]), min(farthest, inverse[j])
            if cos >= cos_same and abs(inverse[j] - own_inverse) < same:
                met = True
                close |= cos >= cos_close
                same_look |= (distances[j, i] if transposed else distances[i, j]) <= alike
        if around >= enough:
            out[1] += 1
            out[2] += own_inverse > nearest * (1.0 + share) + apart
            if own_inverse < farthest * (1.0 - share) - apart:
                continue
        out[3] += met
        out[6] += close
        out[4] += same_look
        seen[v, 0], seen[v, 1], seen[v, 2], similar[v] = x, y, z, same_look
        v += 1
    out[0] = v
    out[5] = _deserted(seen, similar, out[0])
    return out


@kernel
def _deserted(rays, similar, count):  # type: ignore[no-untyped-def]
    """Number of the first ``count`` rays without a similar one among as many neighbours as should have three."""
    alike, n_alike = np.empty((count, 3)), 0
    for i in range(count):
        if similar[i]:
            alike[n_alike, 0], alike[n_alike, 1], alike[n_alike, 2] = rays[i, 0], rays[i, 1], rays[i, 2]
            n_alike += 1
    if n_alike == 0:
        return count
    neighbours = int(np.ceil(3.0 * count / n_alike))
    deserted = 0
    for i in range(count):
        best = -1.0
        for j in range(n_alike):
            best = max(best, rays[i, 0] * alike[j, 0] + rays[i, 1] * alike[j, 1] + rays[i, 2] * alike[j, 2])
        nearer = 0
        for j in range(count):
            nearer += rays[i, 0] * rays[j, 0] + rays[i, 1] * rays[j, 1] + rays[i, 2] * rays[j, 2] > best
            if nearer >= neighbours:
                deserted += 1
                break
    return deserted
