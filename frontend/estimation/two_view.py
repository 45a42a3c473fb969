"""Motion and structure from two calibrated views: a homography scored against a fundamental matrix (thesis section
2.1.3; ORB-SLAM)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import inverse3, product, project_to_so3, se3, transform_points

from ..config import MonoConfig
from ..reason import NO_REASON, Reason
from .triangulation import triangulate

Array = NDArray[np.float64]
_CHI2_LINE, _CHI2_POINT = 3.841, 5.991
"""95 % bounds of a squared distance to a line (1 d.o.f.) and to a point (2), in squared standard deviations."""
_ROTATION_PX = 1.5
_AMBIGUOUS = 0.75
_PLAUSIBLE = 0.5
"""Motions with fewer good points, as a share of the best's, are not looked at again."""


@dataclass(frozen=True)
class PointPairs:
    """The same n points in two views of one camera: pixels ``uv1``, ``uv2`` ``(n, 2)`` with standard deviation
    ``sigma_px``; ``K`` ``(3, 3)``."""

    uv1: Array
    uv2: Array
    K: Array
    sigma_px: float

    def __len__(self) -> int:
        return len(self.uv1)


@dataclass(frozen=True)
class TwoViews:
    """``T_2_1`` (translation of length 1) with the points ``(n, 3)`` in view 1 and which pairs ``good`` ``(n,)`` they
    belong to; or None and the refusal. ``homography_share``: score of the homography over the sum of both.
    ``hypotheses``: all motions ``T_2_1`` with many good points, of both models; more views may decide between them."""

    T_2_1: Array | None
    points: Array
    good: NDArray[np.bool_]
    refusal: Reason = NO_REASON
    homography_share: float = float("nan")
    hypotheses: tuple[Array, ...] = ()

    @property
    def reason(self) -> str:
        """Why there is no motion, with figures."""
        return self.refusal.text


@dataclass(frozen=True)
class _Motions:
    """Rotations and directions of translation that one model allows, and its ``inlier`` pairs ``(n,)``."""

    model: str
    candidates: list[tuple[Array, Array]]
    inlier: NDArray[np.bool_]


@dataclass(frozen=True)
class _Trial:
    """One motion ``T_2_1``: a point ``(n, 3)`` for each pair, those in front of both views that reproject well
    ``good`` ``(n,)``, and their median parallax."""

    T_2_1: Array
    points: Array
    good: NDArray[np.bool_]
    parallax_deg: float

    @property
    def count(self) -> int:
        """Number of good points."""
        return int(self.good.sum())


def solve_two_views(pairs: PointPairs, config: MonoConfig) -> TwoViews:
    """Motion and points; pure rotation and two-fold planar motion are refused with the reason."""
    rest = residual_after_rotation(pairs)
    if rest < _ROTATION_PX:
        text = (
            f"turned without moving: but for the turn the points move by {rest:.2f} px (median), need {_ROTATION_PX} px"
        )
        return _refused(pairs, Reason("turned without moving", text, rest / _ROTATION_PX))
    models = _models(pairs)
    if models is None:
        return _refused(pairs, Reason("no motion fits the points", "no essential matrix fits the points"))
    homography, fundamental, share = models
    chosen = homography if share > config.homography_share else fundamental
    trials = _trials(pairs, chosen)
    refusal = _why_not(trials, len(pairs), f"{chosen.model}, score share of the homography {share:.2f}", config)
    hypotheses = _hypotheses([*trials, *_trials(pairs, fundamental if chosen is homography else homography)])
    if refusal is not None:
        return _refused(pairs, refusal, share, hypotheses)
    best = trials[0]
    return TwoViews(best.T_2_1, best.points[best.good], best.good, NO_REASON, share, hypotheses)


def _refused(
    pairs: PointPairs, refusal: Reason, share: float = float("nan"), hypotheses: tuple[Array, ...] = ()
) -> TwoViews:
    return TwoViews(None, np.zeros((0, 3)), np.zeros(len(pairs), dtype=bool), refusal, share, hypotheses)


def _trials(pairs: PointPairs, motions: _Motions) -> list[_Trial]:
    """The motions of one model, those with the most good points first."""
    return sorted((_try(R, t, pairs, motions.inlier) for R, t in motions.candidates), key=lambda trial: -trial.count)


def _why_not(trials: list[_Trial], count: int, model: str, config: MonoConfig) -> Reason | None:
    """Reason why the best of these ``trials`` of ``count`` pairs is not sure; None where it is."""
    if not trials:
        return Reason("no motion fits the points", f"the homography has no translation ({model})")
    best = trials[0]
    if len(trials) > 1 and trials[1].count > _AMBIGUOUS * best.count:
        text = f"ambiguous: {best.count} and {trials[1].count} points fit two different motions ({model})"
        return Reason("two motions fit the points", text, _AMBIGUOUS * best.count / trials[1].count)
    if best.count < config.min_points:
        what = f"of {count} points in front of both views ({model})"
        return Reason.few("too few points in front of both views", best.count, config.min_points, what)
    if best.parallax_deg < config.min_parallax_deg:
        text = f"parallax {best.parallax_deg:.2f} deg (median), need {config.min_parallax_deg} ({model})"
        return Reason("parallax too small", text, best.parallax_deg / config.min_parallax_deg)
    return None


def _hypotheses(trials: list[_Trial]) -> tuple[Array, ...]:
    """Motions with many good points, most first."""
    ranked = sorted((trial for trial in trials if trial.count), key=lambda trial: -trial.count)
    return tuple(trial.T_2_1 for trial in ranked if trial.count > _PLAUSIBLE * ranked[0].count)


def _models(pairs: PointPairs) -> tuple[_Motions, _Motions, float] | None:
    """What a homography and an essential matrix allow, and the homography's share of both scores; None without an
    essential matrix."""
    uv1, uv2, K, sigma_px = pairs.uv1, pairs.uv2, pairs.K, pairs.sigma_px
    H, _ = cv2.findHomography(uv1, uv2, cv2.RANSAC, 2.5 * sigma_px, maxIters=1000, confidence=0.999)
    E, _ = cv2.findEssentialMat(uv1, uv2, K, cv2.RANSAC, 0.999, 2.0 * sigma_px)
    if E is None or E.shape != (3, 3):
        return None
    K_inv = inverse3(K)
    F = product(product(K_inv.T, E), K_inv)
    score_F, inlier_F = score_fundamental(F, pairs)
    score_H, inlier_H = score_homography(H, pairs) if H is not None else (0.0, np.zeros(len(pairs), dtype=bool))
    flat = []
    if H is not None:
        _, rotations, translations, _ = cv2.decomposeHomographyMat(H, K)
        flat = [
            (r, t.ravel() / max(np.linalg.norm(t), 1e-12))
            for r, t in zip(rotations, translations, strict=True)
            if np.linalg.norm(t) > 1e-6
        ]
    r1, r2, t = cv2.decomposeEssentialMat(E)
    deep = [(r, s * t.ravel()) for r in (r1, r2) for s in (1.0, -1.0)]
    share = score_H / max(score_H + score_F, 1e-12)
    return _Motions("homography", flat, inlier_H), _Motions("fundamental matrix", deep, inlier_F), share


def residual_after_rotation(pairs: PointPairs) -> float:
    """Median distance in pixels between ``uv2`` and ``uv1`` turned by the rotation that fits best (robustly)."""
    a, b = _rays(pairs.uv1, pairs.K), _rays(pairs.uv2, pairs.K)
    a, b = a / np.linalg.norm(a, axis=1, keepdims=True), b / np.linalg.norm(b, axis=1, keepdims=True)
    weight = np.ones(len(a))
    rest = np.zeros(len(a))
    for _ in range(10):
        R = project_to_so3(product((b * weight[:, None]).T, a))
        turned = product(product(a, R.T), pairs.K.T)
        rest = np.linalg.norm(turned[:, :2] / turned[:, 2:] - pairs.uv2, axis=1)
        weight = 1.0 / (1.0 + (rest / max(float(np.median(rest)), 0.1)) ** 2)
    return float(np.median(rest))


def score_homography(H: Array, pairs: PointPairs) -> tuple[float, NDArray[np.bool_]]:
    """Symmetric transfer score (Mur-Artal et al., ORB-SLAM, 2015, eq. 2) of ``H`` (view 1 to view 2, pixels) and the
    inliers ``(n,)``."""
    total, inlier = 0.0, np.ones(len(pairs), dtype=bool)
    for M, a, b in ((H, pairs.uv1, pairs.uv2), (inverse3(H), pairs.uv2, pairs.uv1)):
        p = product(np.c_[a, np.ones(len(a))], M.T)
        e2 = ((p[:, :2] / p[:, 2:] - b) ** 2).sum(axis=1) / pairs.sigma_px**2
        total += float(np.where(e2 < _CHI2_POINT, _CHI2_POINT - e2, 0.0).sum())
        inlier &= e2 < _CHI2_POINT
    return total, inlier


def score_fundamental(F: Array, pairs: PointPairs) -> tuple[float, NDArray[np.bool_]]:
    """Symmetric epipolar score, same scale as the homography's, and the inliers ``(n,)``."""
    total, inlier = 0.0, np.ones(len(pairs), dtype=bool)
    for M, a, b in ((F, pairs.uv1, pairs.uv2), (F.T, pairs.uv2, pairs.uv1)):
        line = product(np.c_[a, np.ones(len(a))], M.T)
        distance = (line * np.c_[b, np.ones(len(b))]).sum(axis=1)
        e2 = distance**2 / np.maximum((line[:, :2] ** 2).sum(axis=1), 1e-18) / pairs.sigma_px**2
        total += float(np.where(e2 < _CHI2_LINE, _CHI2_POINT - e2, 0.0).sum())
        inlier &= e2 < _CHI2_LINE
    return total, inlier


def _rays(uv: Array, K: Array) -> Array:
    return np.stack([(uv[:, 0] - K[0, 2]) / K[0, 0], (uv[:, 1] - K[1, 2]) / K[1, 1], np.ones(len(uv))], axis=1)


def _try(R: Array, t: Array, pairs: PointPairs, inlier: NDArray[np.bool_]) -> _Trial:
    """Triangulate all pairs under one motion; good ones are among ``inlier`` ``(n,)``."""
    n = len(pairs)
    T = se3(R, t)
    rays = np.empty((2 * n, 3))
    rays[0::2], rays[1::2] = _rays(pairs.uv1, pairs.K), _rays(pairs.uv2, pairs.K)
    points, parallax = triangulate(np.stack([np.eye(4), T]), np.arange(0, 2 * n + 1, 2), np.tile([0, 1], n), rays)
    good = inlier & np.isfinite(points[:, 0])
    for pose, uv in ((np.eye(4), pairs.uv1), (T, pairs.uv2)):
        p = product(transform_points(pose, points), pairs.K.T)
        with np.errstate(invalid="ignore", divide="ignore"):
            good &= np.linalg.norm(p[:, :2] / p[:, 2:] - uv, axis=1) < 4.0 * pairs.sigma_px
    return _Trial(T, points, good, float(np.degrees(np.median(parallax[good]))) if good.any() else 0.0)
