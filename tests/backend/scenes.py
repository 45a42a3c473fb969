"""Two stereo cameras in a street of random points, with ORB-like descriptors: scenes of which everything is known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maslam.backend.geometry import Sim3, se3_exp, se3_inverse, transform_points
from maslam.backend.relpose.verification import PlaceView

FOCAL_PX, BASELINE_M, WIDTH_PX, HEIGHT_PX = 320.0, 0.5, 640, 360


@dataclass(frozen=True)
class Noise:
    """Stereo noise in pixels, bits flipped in a descriptor between two views, and points that only one view has."""

    pixel: float = 0.4
    disparity: float = 0.3
    bit_flip: float = 0.08
    unshared: float = 0.3


def street(rng, count=1500):
    """World points ``(count, 3)``: two facades, the ground, and things between, ahead of the origin."""
    z = rng.uniform(3.0, 60.0, count)
    kind = rng.integers(0, 4, count)
    x = np.select(
        [kind == 0, kind == 1],
        [-8.0 + 0.3 * rng.normal(size=count), 9.0 + 0.3 * rng.normal(size=count)],
        rng.uniform(-8.0, 9.0, count),
    )
    y = np.select([kind == 2], [np.full(count, 1.6)], rng.uniform(-6.0, 1.6, count))
    return np.stack([x, y, z], axis=1)


def observe(points_W, descriptors, T_W_C, noise, rng, scale=1.0, metric=True):
    """What a stereo camera at ``T_W_C`` sees; returns the view and the rows of the points in it."""
    p = transform_points(se3_inverse(T_W_C), points_W)
    with np.errstate(divide="ignore", invalid="ignore"):
        uv = FOCAL_PX * p[:, :2] / p[:, 2:] + [WIDTH_PX / 2, HEIGHT_PX / 2]
    seen = (p[:, 2] > 1.0) & (uv >= 0).all(axis=1) & (uv[:, 0] < WIDTH_PX) & (uv[:, 1] < HEIGHT_PX)
    seen &= rng.random(len(p)) > noise.unshared
    rows = np.flatnonzero(seen)
    uv = uv[rows] + noise.pixel * rng.normal(size=(len(rows), 2))
    disparity = FOCAL_PX * BASELINE_M / p[rows, 2] + noise.disparity * rng.normal(size=len(rows))
    good = disparity > 1.5
    rows, uv, disparity = rows[good], uv[good], disparity[good]
    z = FOCAL_PX * BASELINE_M / disparity
    points = np.column_stack([(uv - [WIDTH_PX / 2, HEIGHT_PX / 2]) / FOCAL_PX * z[:, None], z])
    flips = np.packbits(rng.random((len(rows), 256)) < noise.bit_flip, axis=1)
    order = rng.permutation(len(rows))
    return PlaceView(points[order] / scale, (descriptors[rows] ^ flips)[order], metric=metric), rows[order]


def random_descriptors(rng, count):
    return rng.integers(0, 256, size=(count, 32), dtype=np.uint8)


def pair(rng, noise=None, xi=None, outliers=0.0, scale=1.0, metric=True, points=None):
    """A query and a match view of one street and the true ``T_M_Q``.

    ``outliers``: share of the query's descriptors that are swapped among its points, so that they match the wrong
    points. ``scale``: size of the query's unit in the match's.
    """
    noise = noise or Noise()
    points = street(rng) if points is None else points
    descriptors = random_descriptors(rng, len(points))
    xi = rng.uniform([-1.5, -0.2, -3.0, -0.03, -0.2, -0.03], [1.5, 0.2, 3.0, 0.03, 0.2, 0.03]) if xi is None else xi
    T_M_Q = se3_exp(xi)
    match, _ = observe(points, descriptors, np.eye(4), noise, rng)
    query, _ = observe(points, descriptors, T_M_Q, noise, rng, scale, metric)
    wrong = np.flatnonzero(rng.random(len(query.points_C)) < outliers)
    swapped = query.descriptors.copy()
    swapped[wrong] = query.descriptors[np.roll(wrong, 1)]
    return PlaceView(query.points_C, swapped, metric=metric), match, Sim3(T_M_Q[:3, :3], T_M_Q[:3, 3], scale)


LOOK_ALIKES = ("permuted", "another street", "lattice")


def look_alikes(kind, rng, metric=True):
    """Query and match views with the same descriptors at other points: hundreds of tentative matches, none right."""
    if kind == "lattice":
        x, y, z = np.meshgrid(np.arange(-8, 9, 1.0), [1.6], np.arange(3, 60, 1.0), indexing="ij")
        points = np.stack([x, y, z], axis=-1).reshape(-1, 3)
        here, there = rng.permutation(points), rng.permutation(points)
    else:
        here = street(rng)
        there = rng.permutation(here) if kind == "permuted" else street(rng)
    descriptors = random_descriptors(rng, len(here))
    match, _ = observe(here, descriptors, np.eye(4), Noise(), rng, metric=metric)
    query, _ = observe(there, descriptors, np.eye(4), Noise(), rng, metric=metric)
    return query, match
