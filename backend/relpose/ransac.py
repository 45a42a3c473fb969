"""Seeded RANSAC over arrays for the rigid or similarity transform that most matched points agree on.

Three matches make a hypothesis (Umeyama's closed form). Three pairs of points can only belong together if their
triangles have the same sides (up to one factor for similarities), which is cheap to test: many sets are drawn, the
most alike are solved and scored. Errors are angles, both ways: the depth of a stereo point is off by an amount that
grows with its square, its direction is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from ..config import RelPoseConfig
from ..geometry import Array, Sim3

# A triangle whose height is less than this share of its longest side says little about a rotation about that side.
_MIN_FLATNESS = 0.05


@dataclass(frozen=True, eq=False)
class Transforms:
    """A batch of similarities ``T_M_Q``: rotations ``(h, 3, 3)``, translations ``(h, 3)``, scales ``(h,)``."""

    rotations: Array
    translations: Array
    scales: Array

    def one(self, k: int) -> Sim3:
        """Similarity ``k`` of the batch."""
        return Sim3(self.rotations[k].copy(), self.translations[k].copy(), float(self.scales[k]))

    @classmethod
    def of(cls, transform: Sim3) -> Transforms:
        """A batch of one."""
        return cls(transform.rotation[None], transform.translation[None], np.array([transform.scale]))


def search(
    points_M: Array, points_Q: Array, with_scale: bool, config: RelPoseConfig, rng: np.random.Generator
) -> list[Sim3]:
    """Return the best few hypotheses, best first, for matched points ``(k, 3)`` in their cameras' frames; empty if none
    stands out."""
    triples = _alike_triples(points_M, points_Q, with_scale, config, rng)
    if not len(triples):
        return []
    hypotheses = _solve_triples(points_M[triples], points_Q[triples], with_scale)
    counts = agreeing(hypotheses, points_M, points_Q, config.search_angle_deg, config.depth_ratio).sum(axis=1)
    order = np.argsort(-counts, kind="stable")[: config.refined]
    return [hypotheses.one(k) for k in order if counts[k] > 3]


def agreeing(
    transforms: Transforms, points_M: Array, points_Q: Array, angle_deg: float, depth_ratio: float
) -> NDArray[np.bool_]:
    """Mask ``(h, k)`` of the matches that each transform explains: directions in both cameras within ``angle_deg``,
    depths within the factor ``depth_ratio``."""
    return np.asarray(
        _agreeing(
            transforms.rotations,
            transforms.translations,
            transforms.scales,
            np.ascontiguousarray(points_M),
            np.ascontiguousarray(points_Q),
            np.sqrt((points_M**2).sum(axis=1)),
            np.sqrt((points_Q**2).sum(axis=1)),
            np.cos(np.radians(angle_deg)),
            depth_ratio,
        )
    )


@kernel
def _agreeing(  # type: ignore[no-untyped-def]
    rotations, translations, scales, points_M, points_Q, range_M, range_Q, cos, ratio
):
    out = np.zeros((len(rotations), len(points_M)), dtype=np.bool_)
    for h in range(len(rotations)):
        R, t, s = rotations[h], translations[h], scales[h]
        for k in range(len(points_M)):
            m, q = points_M[k], points_Q[k]
            square = dot = square_back = dot_back = 0.0
            for a in range(3):
                p = s * (R[a, 0] * q[0] + R[a, 1] * q[1] + R[a, 2] * q[2]) + t[a]
                back = (R[0, a] * (m[0] - t[0]) + R[1, a] * (m[1] - t[1]) + R[2, a] * (m[2] - t[2])) / s
                square, dot = square + p * p, dot + p * m[a]
                square_back, dot_back = square_back + back * back, dot_back + back * q[a]
            near, near_back = np.sqrt(square), np.sqrt(square_back)
            out[h, k] = (
                dot > cos * near * range_M[k]
                and dot_back > cos * near_back * range_Q[k]
                and range_M[k] < ratio * near < ratio * ratio * range_M[k]
                and range_Q[k] < ratio * near_back < ratio * ratio * range_Q[k]
            )
    return out


def _alike_triples(
    points_M: Array, points_Q: Array, with_scale: bool, config: RelPoseConfig, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Sets of three matches ``(h, 3)`` whose triangles are most alike."""
    triples = rng.integers(0, len(points_M), size=(config.samples, 3))
    difference = _unlikeness(np.ascontiguousarray(points_M), np.ascontiguousarray(points_Q), triples, with_scale)
    alike = np.flatnonzero(difference < np.log(config.depth_ratio))
    order = np.argsort(difference[alike], kind="stable")[: config.hypotheses]
    return triples[alike[order]]


@kernel
def _unlikeness(points_M, points_Q, triples, with_scale):  # type: ignore[no-untyped-def]
    """Largest log ratio ``(h,)`` of the sides of two triangles, after their common factor where there may be one;
    infinite for triangles that say little."""
    out = np.full(len(triples), np.inf)
    sides, ratios = np.empty((2, 3)), np.empty(3)
    for h in range(len(triples)):
        for a in range(3):
            i, j = triples[h, a], triples[h, (a + 1) % 3]
            square = square_Q = 0.0
            for c in range(3):
                square += (points_M[i, c] - points_M[j, c]) ** 2
                square_Q += (points_Q[i, c] - points_Q[j, c]) ** 2
            sides[0, a], sides[1, a] = np.sqrt(square), np.sqrt(square_Q)
        if _flatness(sides[0]) <= _MIN_FLATNESS or _flatness(sides[1]) <= _MIN_FLATNESS:
            continue
        for a in range(3):
            ratios[a] = np.log(sides[0, a] / sides[1, a])
        common = (ratios[0] + ratios[1] + ratios[2]) / 3.0 if with_scale else 0.0
        out[h] = max(abs(ratios[0] - common), abs(ratios[1] - common), abs(ratios[2] - common))
    return out


@kernel
def _flatness(sides):  # type: ignore[no-untyped-def]
    """Height over longest side of a triangle given by its sides ``(3,)``; 0 for a point."""
    a, b, c = sides
    area = 0.25 * np.sqrt(max((a + b + c) * (-a + b + c) * (a - b + c) * (a + b - c), 0.0))
    return 2.0 * area / max(a, b, c, 1e-12) ** 2


def _solve_triples(a: Array, b: Array, with_scale: bool) -> Transforms:
    """Least-squares ``T_A_B`` of each set ``(h, 3, 3)`` of points (Umeyama, PAMI 1991)."""
    mean_a, mean_b = a.mean(axis=1, keepdims=True), b.mean(axis=1, keepdims=True)
    da, db = a - mean_a, b - mean_b
    u, singular, vt = np.linalg.svd(np.swapaxes(da, 1, 2) @ db)
    singular[:, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))
    u[:, :, 2] *= np.sign(np.linalg.det(u) * np.linalg.det(vt))[:, None]
    rotations = u @ vt
    scales = singular.sum(axis=1) / (db**2).sum(axis=(1, 2)) if with_scale else np.ones(len(a))
    turned = (rotations @ np.swapaxes(mean_b, 1, 2))[:, :, 0]
    return Transforms(rotations, mean_a[:, 0] - scales[:, None] * turned, scales)
