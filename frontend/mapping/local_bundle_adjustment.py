"""Bundle adjustment around the latest key-frame: which key-frames and points take part, and what becomes of the
result."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from maslam.backend.geometry import product

from ..config import OdometryConfig
from ..estimation.bundle_adjustment import adjust_window, window_residuals
from ..estimation.depth_alignment import DepthAlignment, align_surfaces
from ..estimation.schur import Estimate, Observations, Window
from ..estimation.self_calibration import CalibrationEstimate, basis, with_rows
from .map import Array, Ints, Map, MapKeyFrame
from .range_sensor import Ranging


@dataclass(frozen=True)
class SharedPoints:
    """P map points that take part, and their N observations ``seen``: ``ids`` ``(P,)`` in the map, ``row`` ``(N,)``
    rows of their key-frames."""

    ids: Ints
    row: Ints
    seen: Observations


def window_keyframes(map_: Map, config: OdometryConfig) -> tuple[list[int], list[int]]:
    """The latest key-frames, oldest first; and before them older ones that see the same place."""
    recent = map_.latest(config.mapping.window)
    if not recent:
        return [], []
    seen = map_.keyframes[recent[-1]].point
    older = map_.covisible(seen[seen >= 0], set(recent))[: config.mapping.covisible]
    return recent, sorted(older)


def adjust_locally(map_: Map, ranging: Ranging, config: OdometryConfig) -> None:
    """Refine the latest key-frames, their points and the rig's calibration; observations that disagree are dropped."""
    settings = config.mapping
    recent, older = window_keyframes(map_, config)
    if len(recent) < 2:
        return
    # At the start the first key-frame alone is the anchor; later the oldest of the window, and every older one.
    anchors = 1 if len(recent) < settings.window else settings.fixed
    keyframes = [map_.keyframes[number] for number in older + recent]
    slot = np.concatenate([np.full(len(older) + anchors, -1), np.arange(len(recent) - anchors)]).astype(np.int64)
    shared = gather(map_, keyframes, slot, ranging.sigma_d)
    if len(shared.row) < settings.min_observations:
        return
    count = len(ranging.calib) if ranging.calibrates(recent[-1] + 1) else 0
    prior = _calibration_prior(ranging, keyframes, count)
    before = np.stack([k.T_C_W for k in keyframes])
    adjusted = adjust_window(
        Estimate(before, map_.xyz[shared.ids], ranging.calib[:count]),
        _window(ranging, slot, shared.seen, prior),
        _align(ranging, keyframes, before, slot),
        settings.iterations,
    )
    found = adjusted.estimate
    if not (np.isfinite(found.poses).all() and np.isfinite(found.points).all()):
        return
    for keyframe, pose, place in zip(keyframes, found.poses, slot.tolist(), strict=True):
        if place >= 0:
            keyframe.T_C_W = pose
    map_.xyz[shared.ids] = found.points
    if count:
        ranging.learn(found.calib, adjusted.information - prior.information)
    _move_points_seen_once(map_, ranging, keyframes)
    _drop_outliers(map_, ranging, config, keyframes, found, shared)


def _window(ranging: Ranging, slot: Ints, seen: Observations, prior: CalibrationEstimate) -> Window:
    """The observations as measured where the calibration is estimated along, else without what is known of it."""
    count = len(prior.mean)
    added = basis(seen.uv, seen.disparity, ranging.cam, count)[:, :3]
    if not count:
        uv, disparity = ranging.measured(seen.uv, seen.disparity)
        seen = seen._replace(uv=uv, disparity=disparity)
    return Window(slot, seen, ranging.cam, added, prior.mean, prior.information)


def _align(ranging: Ranging, keyframes: list[MapKeyFrame], poses: Array, slot: Ints) -> DepthAlignment:
    """The depth images of the free key-frames against those before them."""
    config = ranging.config
    if keyframes[-1].surface is None:
        return DepthAlignment.none()
    pairs = [(k - lag, k) for k in np.flatnonzero(slot >= 0).tolist() for lag in config.align_lags if lag <= k]
    surfaces = [k.surface for k in keyframes]
    return align_surfaces(surfaces, poses, pairs, ranging.cam, config.depth_sigma_m, config.align_correlated)


def _calibration_prior(ranging: Ranging, keyframes: list[MapKeyFrame], count: int) -> CalibrationEstimate:
    """The rig's residual calibration by its prior and by the rows of the stereo matches."""
    if not count:
        return CalibrationEstimate(np.zeros(0), np.zeros((0, 0)))
    if ranging.calib_filter is not None:
        return ranging.calib_filter.estimate
    uv, disparity, row = (np.concatenate([getattr(k, name) for k in keyframes]) for name in ("uv", "disparity", "row"))
    ok = np.isfinite(disparity) & np.isfinite(row)
    sigma = ranging.config.row_sigma_px
    return with_rows(uv[ok], disparity[ok], row[ok], ranging.cam, ranging.prior(len(keyframes)), ranging.calib, sigma)


def gather(map_: Map, keyframes: list[MapKeyFrame], slot: Ints, sigma_d: float) -> SharedPoints:
    """What the key-frames see of points that a free key-frame sees (``slot`` >= 0); points seen once say nothing and
    stay out. ``sigma_d``: standard deviation of a disparity, pixels."""
    rows_of, kf_of = [], []
    for k, keyframe in enumerate(keyframes):
        rows = np.flatnonzero(keyframe.point >= 0)
        rows_of.append(rows[np.isfinite(map_.xyz[keyframe.point[rows], 0])])
        kf_of.append(np.full(len(rows_of[-1]), k))
    kf, row = np.concatenate(kf_of), np.concatenate(rows_of)
    first_row = np.concatenate([[0], np.cumsum([len(k.uv) for k in keyframes])])[:-1]
    flat = first_row[kf] + row
    point = np.concatenate([k.point for k in keyframes])[flat]
    # The window's points are numbered close together: tables over their range do not grow with the map.
    near = point - (point.min() if len(point) else 0)
    count = np.bincount(near)
    moves = np.bincount(near, weights=slot[kf] >= 0) > 0
    use = np.flatnonzero((count[near] >= 2) & moves[near])
    order = use[np.argsort(point[use], kind="stable")]
    begins = np.flatnonzero(np.diff(point[order], prepend=-1))
    ids, start = point[order][begins], np.append(begins, len(order)).astype(np.int64)
    flat = flat[order]
    seen = Observations(
        start,
        kf[order],
        np.repeat(np.arange(len(ids)), np.diff(start)),
        np.concatenate([k.uv for k in keyframes])[flat],
        np.concatenate([k.disparity for k in keyframes])[flat],
        np.concatenate([k.sigma for k in keyframes])[flat],
        np.full(len(order), sigma_d),
    )
    return SharedPoints(ids, row[order], seen)


def _move_points_seen_once(map_: Map, ranging: Ranging, keyframes: list[MapKeyFrame]) -> None:
    """They hang on their key-frame: they move with it and with the calibration."""
    rows_of = []
    for keyframe in keyframes:
        rows = np.flatnonzero((keyframe.point >= 0) & np.isfinite(keyframe.disparity))
        rows_of.append(rows[map_.views[keyframe.point[rows]] == 1])
    kf = np.repeat(np.arange(len(keyframes)), [len(rows) for rows in rows_of])
    point, uv, disparity = (
        np.concatenate([values(k)[rows] for k, rows in zip(keyframes, rows_of, strict=True)])
        for values in (attrgetter("point"), attrgetter("uv"), attrgetter("disparity"))
    )
    p_C = ranging.back_project(uv, disparity)
    good = np.isfinite(p_C[:, 0])
    T_W_C = np.stack([k.T_W_C for k in keyframes])[kf[good]]
    map_.xyz[point[good]] = product(T_W_C[:, :3, :3], p_C[good][:, :, None])[:, :, 0] + T_W_C[:, :3, 3]


def _drop_outliers(
    map_: Map,
    ranging: Ranging,
    config: OdometryConfig,
    keyframes: list[MapKeyFrame],
    found: Estimate,
    shared: SharedPoints,
) -> None:
    seen, row = shared.seen, shared.row
    limit = config.mapping.outlier_factor * config.pose.outlier_sigmas
    ideal = ranging.measured(seen.uv, seen.disparity)
    r = window_residuals(found.poses, found.points, seen.kf, seen.pt, *ideal, ranging.cam)
    far_off = ~(np.hypot(r[:, 0], r[:, 1]) < limit * seen.sigma)
    for i in np.flatnonzero(np.abs(r[:, 2]) > limit * ranging.sigma_d).tolist():
        keyframes[seen.kf[i]].disparity[row[i]] = np.nan
    for i in np.flatnonzero(far_off).tolist():
        map_.drop_observation(keyframes[seen.kf[i]].number, int(row[i]))
    touched = shared.ids[np.unique(seen.pt[far_off])]
    for point in touched[map_.views[touched] < 2].tolist():
        map_.drop_point(point)
