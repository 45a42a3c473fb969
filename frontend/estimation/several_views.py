"""Motion and structure from more than two calibrated views: which of several motions all views agree with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, rotation_angle_deg

from ..reason import NO_REASON, Reason
from .bundle_adjustment import adjust_window, window_residuals
from .depth_alignment import DepthAlignment
from .pose_refinement import SeenPoints, refine_pose
from .schur import Estimate, Observations, Window
from .triangulation import triangulate

Array = NDArray[np.float64]
_CHI2_POINT = 9.21
"""99 % bound of a squared distance in the image (2 degrees of freedom), in squared standard deviations: a point must
keep it in every view."""
_ITERATIONS, _ROUNDS = 20, 3
_SAME_DEG, _SAME_HEADING_DEG = 0.5, 10.0
"""Two results turn and move alike within these angles: they are one."""
_EVIDENCE, _CONTRADICTION = 5.0, 2.0
"""How much worse every other motion must explain the views, standard deviations: to be sure of the best, and not to
doubt one that two views were sure of."""
_TURN_DEG = 0.5
"""Largest standard deviation of the turn between the first view and the last, degrees."""
_SIGNAL = 5.0
"""Least median parallax, as a multiple of the noise that the fit leaves."""
_LEAST_SIGMA = 0.3
"""Followed points are never believed to be more exact than this share of their standard deviation."""
_SLACK, _MEDIAN_2 = 2.0, 1.386
"""How much worse than most, in variance, a point may be that has a say; median of chi-square (2 degrees of freedom)."""


@dataclass(frozen=True)
class ViewTracks:
    """The same n points in V views of one camera, in order of time: ideal pixels ``uv`` ``(V, n, 2)`` with standard
    deviation ``sigma_px``; ``cam``: ``[fx, fy, cx, cy, bf]``."""

    uv: Array
    cam: Array
    sigma_px: float

    def rays(self) -> Array:
        """Viewing rays ``(V, n, 3)`` with z = 1."""
        fx, fy, cx, cy = self.cam[:4]
        u, v = (self.uv[..., 0] - cx) / fx, (self.uv[..., 1] - cy) / fy
        return np.stack([u, v, np.ones_like(u)], axis=-1)


@dataclass(frozen=True)
class Needs:
    """Least number of ``points`` that agree in all views, their least ``share`` of those followed, and their least
    median parallax, degrees."""

    points: int
    share: float
    parallax_deg: float


@dataclass(frozen=True)
class SeveralViews:
    """``T_2_1`` from the first to the last view (translation of length 1) with the points ``(m, 3)`` in the first and
    which of the n tracks ``good`` ``(n,)`` they belong to; or None and the refusal."""

    T_2_1: Array | None
    points: Array
    good: NDArray[np.bool_]
    refusal: Reason = NO_REASON

    @classmethod
    def refused(cls, count: int, refusal: Reason) -> SeveralViews:
        """No motion for ``count`` tracks."""
        return cls(None, np.zeros((0, 3)), np.zeros(count, dtype=bool), refusal)


@dataclass(frozen=True)
class AdjustedMotion:
    """One motion adjusted to all views: ``poses`` ``(V, 4, 4)`` ``T_C_W``; a point ``(n, 3)`` for each track; those
    within the bounds in every view ``good`` ``(n,)``; the median ``parallax_deg`` of these; ``cost`` ``(n,)``:
    chi-square of each track, bounded."""

    poses: Array
    points: Array
    good: NDArray[np.bool_]
    parallax_deg: float
    cost: Array

    @property
    def motion(self) -> Array:
        """``T_2_1`` of the last view, translation of length 1."""
        T = self.poses[-1].copy()
        T[:3, 3] /= max(float(np.linalg.norm(T[:3, 3])), 1e-12)
        return T


def adjust_all(tracks: ViewTracks, hypotheses: tuple[Array, ...]) -> list[AdjustedMotion]:
    """Each of ``hypotheses`` (``T_2_1`` from the first to the last view) adjusted to all views, the most likely
    first."""
    fits = (_fit(tracks, T) for T in hypotheses)
    return sorted((fit for fit in fits if fit is not None), key=lambda fit: float(fit.cost.sum()))


def decide(tracks: ViewTracks, fits: list[AdjustedMotion], needs: Needs) -> SeveralViews:
    """The one motion that all views agree with.

    It is sure where enough points agree with it in every view, with enough parallax, where turn and step can be
    distinguished, and where the views are much less likely under every other.
    """
    refusal = _why_not(tracks, fits, needs)
    if refusal is not None:
        return SeveralViews.refused(tracks.uv.shape[1], refusal)
    return SeveralViews(fits[0].motion, fits[0].points[fits[0].good], fits[0].good)


def contradicted(fits: list[AdjustedMotion], T_2_1: Array) -> bool:
    """Whether another motion explains the views better than ``T_2_1``, or nearly as well."""
    return bool(fits) and (not _alike(fits[0].motion, T_2_1) or _evidence(fits) < _CONTRADICTION)


def _why_not(tracks: ViewTracks, fits: list[AdjustedMotion], needs: Needs) -> Reason | None:
    views, count = tracks.uv.shape[:2]
    if not fits:
        return Reason("no motion fits the points", f"no motion fits the points in {views} views")
    best = fits[0]
    good, need = int(best.good.sum()), max(needs.points, int(np.ceil(needs.share * count)))
    if good < need:
        what = f"of {count} points agree in {views} views"
        return Reason.few("too few points agree in several views", good, need, what)
    noise_px = _noise_px(tracks, best)
    need_deg = max(needs.parallax_deg, float(np.degrees(_SIGNAL * noise_px / tracks.cam[0])))
    if best.parallax_deg < need_deg:
        text = f"parallax {best.parallax_deg:.2f} deg (median, {views} views), need {need_deg:.2f}"
        return Reason("parallax too small", text, best.parallax_deg / need_deg)
    turn_deg = _turn_deviation_deg(tracks, best) * max(1.0, noise_px / tracks.sigma_px)
    if turn_deg > _TURN_DEG:
        text = f"flat or far scene: turn known to {turn_deg:.2f} deg beside the step, need {_TURN_DEG}"
        return Reason("turn and step cannot be distinguished", text, _TURN_DEG / turn_deg)
    evidence = _evidence(fits)
    if evidence < _EVIDENCE:
        text = f"ambiguous: two motions fit {views} views, {evidence:.1f} deviations apart, need {_EVIDENCE}"
        return Reason("two motions fit the points", text, evidence / _EVIDENCE)
    return None


def _noise_px(tracks: ViewTracks, fit: AdjustedMotion) -> float:
    """Standard deviation of a position, pixels, by what the fit leaves of the good points."""
    views, n = len(fit.poses), int(fit.good.sum())
    error2 = _errors2(tracks, fit.poses, fit.points)[:, fit.good]
    freedom = max((2 * views - 3) * n - 6 * (views - 1), 1)
    return tracks.sigma_px * float(np.sqrt(error2.sum() / freedom))


def _alike(a: Array, b: Array) -> bool:
    """Whether two motions (translations of length 1) are one."""
    turned = float(rotation_angle_deg(product(a[:3, :3], b[:3, :3].T)))
    heading = float(np.degrees(np.arccos(np.clip(a[:3, 3] @ b[:3, 3], -1.0, 1.0))))
    return turned <= _SAME_DEG and heading <= _SAME_HEADING_DEG


def _evidence(fits: list[AdjustedMotion]) -> float:
    """How surely the points prefer the best fit to the next that is another motion: mean over standard deviation of
    the difference in chi-square per point, times the root of their number (Vuong, 1989); infinite where there is no
    other."""
    for other in fits[1:]:
        if not _alike(fits[0].motion, other.motion):
            worse = other.cost - fits[0].cost
            return float(worse.mean() / max(worse.std(), 1e-9) * np.sqrt(len(worse)))
    return float("inf")


def _turn_deviation_deg(tracks: ViewTracks, fit: AdjustedMotion) -> float:
    """Largest standard deviation of the turn between the first and the last view, degrees, by the epipolar constraint
    of the good points. It grows where the scene is flat and narrow: there a turn and a step move the points alike (the
    bas-relief ambiguity; Belhumeur et al., 1999)."""
    rays, T = tracks.rays(), fit.motion
    R, t = T[:3, :3], T[:3, 3]
    a, b = product(rays[0][fit.good], R.T), rays[-1][fit.good]
    line = np.cross(t, a)
    line_1 = product(np.cross(b, t), R)
    length = np.sqrt((line[:, :2] ** 2).sum(axis=1) + (line_1[:, :2] ** 2).sum(axis=1))
    across = np.linalg.svd(t[None])[2][1:]
    J = np.concatenate([np.cross(a, np.cross(b, t)), product(np.cross(a, b), across.T)], axis=1)
    J *= (tracks.cam[0] / np.maximum(length, 1e-12) / tracks.sigma_px)[:, None]
    information = product(J.T, J) + 1e-12 * np.eye(5)
    step = np.asarray(np.linalg.solve(information[3:, 3:], information[3:, :3]), dtype=np.float64)
    turn = np.asarray(information[:3, :3] - product(information[:3, 3:], step), dtype=np.float64)
    return float(np.degrees(1.0 / np.sqrt(max(float(np.linalg.eigvalsh(turn)[0]), 1e-12))))


def _fit(tracks: ViewTracks, T_2_1: Array) -> AdjustedMotion | None:
    """Points from the first and the last view, the views between from the points, then all adjusted."""
    rays, views = tracks.rays(), len(tracks.uv)
    points, _ = _triangulated(np.stack([np.eye(4), T_2_1]), rays[[0, -1]])
    good: NDArray[np.bool_] = np.isfinite(points[:, 0])
    if good.sum() < 10:
        return None
    poses = np.tile(np.eye(4), (views, 1, 1))
    poses[-1] = T_2_1
    sigma = np.full(int(good.sum()), tracks.sigma_px)
    for v in range(views - 2, 0, -1):
        seen = SeenPoints.without_depth(points[good], tracks.uv[v][good], sigma)
        poses[v], _, _ = refine_pose(poses[v + 1], seen, tracks.cam, np.sqrt(_CHI2_POINT), 4)
    if not np.isfinite(poses).all():
        return None
    use = good
    for _ in range(_ROUNDS):
        poses = _adjusted(tracks, poses, points, use)
        if not np.isfinite(poses).all():
            return None
        points, parallax = _triangulated(poses, rays)
        error2 = _errors2(tracks, poses, points)
        good = np.asarray((error2 < _CHI2_POINT).all(axis=0))
        # A few points that slide by a pixel bend a flat scene: the motion is that of the exact ones.
        exact = _SLACK * float(np.median(error2[:, good])) / _MEDIAN_2 if good.any() else 1.0
        use = np.asarray((error2 < _CHI2_POINT * np.clip(exact, _LEAST_SIGMA**2, 1.0)).all(axis=0))
        if use.sum() < 10:
            return None
    cost = np.minimum(error2, _CHI2_POINT).sum(axis=0)
    return AdjustedMotion(poses, points, good, float(np.degrees(np.median(parallax[good]))), cost)


def _triangulated(poses: Array, rays: Array) -> tuple[Array, Array]:
    """Points ``(n, 3)`` and parallaxes ``(n,)``, radians, of ``rays`` ``(V, n, 3)``."""
    views, n = rays.shape[:2]
    start = np.arange(0, views * n + 1, views)
    by_point = np.ascontiguousarray(rays.transpose(1, 0, 2)).reshape(-1, 3)
    return triangulate(poses, start, np.tile(np.arange(views), n), by_point)


def _adjusted(tracks: ViewTracks, poses: Array, points: Array, good: NDArray[np.bool_]) -> Array:
    """Poses ``(V, 4, 4)`` after a bundle adjustment of the ``good`` points, in the first camera's frame."""
    views, n = len(poses), int(good.sum())
    seen = Observations(
        np.arange(0, views * n + 1, views),
        np.tile(np.arange(views), n),
        np.repeat(np.arange(n), views),
        np.ascontiguousarray(tracks.uv[:, good].transpose(1, 0, 2)).reshape(-1, 2),
        np.full(views * n, np.nan),
        np.full(views * n, tracks.sigma_px),
        np.ones(views * n),
    )
    slot = np.arange(-1, views - 1)
    window = Window(slot, seen, tracks.cam, np.zeros((views * n, 3, 0)), np.zeros(0), np.zeros((0, 0)))
    begin = Estimate(poses, points[good], np.zeros(0))
    return adjust_window(begin, window, DepthAlignment.none(), _ITERATIONS).estimate.poses


def _errors2(tracks: ViewTracks, poses: Array, points: Array) -> Array:
    """Squared reprojection errors ``(V, n)`` in squared standard deviations; infinite without a point or behind a
    camera."""
    views, n = len(poses), len(points)
    kf, pt = np.repeat(np.arange(views), n), np.tile(np.arange(n), views)
    unknown = np.full(views * n, np.nan)
    r = window_residuals(poses, points, kf, pt, tracks.uv.reshape(-1, 2), unknown, tracks.cam)
    error2 = (r[:, 0] ** 2 + r[:, 1] ** 2) / tracks.sigma_px**2
    return np.nan_to_num(error2, nan=np.inf).reshape(views, n)
