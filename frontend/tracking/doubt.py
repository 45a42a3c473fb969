"""Poses that may be wrong, and why: weak support by points, a second motion in the image, a jump in the trajectory.

A doubtful pose stays in its track; :class:`maslam.frontend.odometry.OdometryResult` lists the intervals.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, transform_points

from ..estimation.absolute_pose import absolute_pose
from ..estimation.pose_refinement import SeenPoints, refine_pose
from ..mapping.range_sensor import Ranging
from ..reason import NO_REASON, Reason

Array = NDArray[np.float64]
_GRID = (8, 6)
"""Cells of the image, columns and rows."""
_FEW_POINTS, _FEW_CELLS, _MANY_POINTS, _POSITION_SHARE = 25, 12, 60, 0.0025
"""Fewer points, fewer cells that hold some (of less than many points), and a larger deviation of the position (share of
the median depth) are weak support. Sound sequences have 29, 13 and 0.0014 at worst."""
_PLENTY = 1.5
"""Times those cells, held by many points, are support that needs no further look."""
_STILL_PX, _MOVING_PX = 0.3, 2.0
"""A point that moves less from one frame to the next stands still in the image; others move clearly that move more."""
_STILL_SHARE, _ALL_STILL = 0.2, 0.9
"""Shares of the points that stand still beside something that moves, and of a camera that stands. Moving cameras have
0.11 at most, standing ones 0.97 at least."""
_SECOND_SHARE, _DISAGREE_SHARE = 0.25, 0.3
"""Shares of the points found that agree on a second motion, and above which that is looked for."""
_NEIGHBOURS, _STEP_SPREADS, _STEP_SHARE = 4, 2.0, 0.005
"""A step is a jump where it differs from the median of its neighbours on each side by more than so many times their
spread and a share of the median depth, and by more the farther these are away in time."""


@dataclass(frozen=True)
class PointsFound:
    """n points found in a frame: their positions ``xyz`` ``(n, 3)`` in the track's frame, ``uv`` ``(n, 2)`` pixels,
    ``before`` ``(n, 2)`` in the frame before, NaN where they were not found, and those that agree with the pose
    ``inlier`` ``(n,)``."""

    xyz: Array
    uv: Array
    before: Array
    inlier: NDArray[np.bool_]

    @cached_property
    def moved_px(self) -> Array:
        """Displacements ``(n,)`` since the frame before; NaN where a point was not found there."""
        return np.asarray(np.hypot(*(self.uv - self.before).T))

    @cached_property
    def still(self) -> NDArray[np.bool_]:
        """Points ``(n,)`` that stand still in the image."""
        return np.asarray(np.nan_to_num(self.moved_px, nan=np.inf) < _STILL_PX)

    @property
    def still_share(self) -> float:
        """Share of the points that stand still."""
        return float(self.still.mean()) if len(self.uv) else 0.0

    @property
    def divided(self) -> bool:
        """Whether a part of the points stands still while the others clearly move."""
        if self.still_share < _STILL_SHARE:
            return False
        moved = self.moved_px[~self.still]
        moved = moved[np.isfinite(moved)]
        return len(moved) >= _STILL_SHARE * len(self.uv) and float(np.median(moved)) > _MOVING_PX


def stands(points: PointsFound, stood: bool) -> bool:
    """Whether the camera stands: nearly all points stand still, or it ``stood`` and a part of them goes on to."""
    return points.still_share >= (_STILL_SHARE if stood else _ALL_STILL)


def doubt(T_C_W: Array, points: PointsFound, ranging: Ranging, sigma_px: float) -> Reason:
    """Reason to doubt a pose by its points, with figures; :data:`NO_REASON` where there is none."""
    weak = weak_support(T_C_W, points.xyz[points.inlier], points.uv[points.inlier], ranging, sigma_px)
    return weak if weak.kind else _second_motion(points, ranging, sigma_px)


def weak_support(T_C_W: Array, xyz: Array, uv: Array, ranging: Ranging, sigma_px: float) -> Reason:
    """Doubt about a pose that few points ``xyz`` ``(n, 3)`` at ``uv`` ``(n, 2)`` support, or only in a small part of
    the image, or so that its position is not known well. Positions of points are taken as exact."""
    camera = ranging.rig.camera
    column, row = (uv * _GRID / [camera.width, camera.height]).astype(np.int64).T
    filled = np.zeros(_GRID[0] * _GRID[1], dtype=bool)
    filled[row * _GRID[0] + column] = True
    cells = int(filled.sum())
    if len(uv) >= _MANY_POINTS and cells >= _PLENTY * _FEW_CELLS:
        return NO_REASON  # their position cannot be badly known, and most frames are such
    depth = float(np.median(transform_points(T_C_W, xyz)[:, 2]))
    share = _position_deviation(T_C_W, xyz, uv, ranging, sigma_px) / max(depth, 1e-9)
    crowded = _FEW_CELLS / cells if len(uv) < _MANY_POINTS else 0.0
    worst = max(_FEW_POINTS / len(uv), crowded, share / _POSITION_SHARE)
    if worst <= 1.0:
        return NO_REASON
    percent = 100 * cells / len(filled)
    text = f"{len(uv)} points in {percent:.0f} % of the image, position known to {100 * share:.2f} % of the depth"
    return Reason("few points support the pose", text, worst)


def _position_deviation(T_C_W: Array, xyz: Array, uv: Array, ranging: Ranging, sigma_px: float) -> float:
    """Largest standard deviation of the camera's position, in the track's unit."""
    seen = SeenPoints.without_depth(xyz, ranging.ideal(uv), np.full(len(uv), sigma_px))
    _, _, information = refine_pose(T_C_W, seen, ranging.cam, np.inf, 1)
    step, turn, both = information[:3, :3], information[3:, 3:], information[:3, 3:]
    alone = step - product(product(both, np.asarray(np.linalg.pinv(turn), dtype=np.float64)), both.T)
    return float(1.0 / np.sqrt(max(float(np.linalg.eigvalsh(alone)[0]), 1e-18)))


def _second_motion(points: PointsFound, ranging: Ranging, sigma_px: float) -> Reason:
    """Doubt where many points contradict the pose and agree on another: that of a standing camera, or any."""
    n, other = len(points.uv), ~points.inlier
    if points.divided:
        text = f"{100 * points.still_share:.0f} % of the points stand still while the others move"
        return Reason("a part of the image stands still", text, points.still_share)
    if other.sum() < max(_DISAGREE_SHARE * n, _FEW_POINTS):
        return NO_REASON
    xyz, uv = points.xyz[other], ranging.ideal(points.uv[other])
    T = absolute_pose(xyz, uv, ranging.cam, 4.0 * sigma_px)
    if T is None:
        return NO_REASON
    seen = SeenPoints.without_depth(xyz, uv, np.full(len(uv), sigma_px))
    second = int(refine_pose(T, seen, ranging.cam, 2.45, 4)[1].sum())
    if second < _SECOND_SHARE * n:
        return NO_REASON
    text = f"{int(points.inlier.sum())} points agree with the pose and {second} with another"
    return Reason("two motions in the image", text, second / n)


def jumps(
    stamps_ns: NDArray[np.int64], centres: Array, depth: Array, unit: str = "(unit of the track)"
) -> list[tuple[int, Reason]]:
    """Frames ``k`` of a trajectory whose step from ``k - 1`` is a jump, with the doubt. ``centres`` ``(N, 3)``;
    ``depth`` ``(N,)`` median depth that each frame sees, both in the track's ``unit``."""
    n = len(centres) - 1
    if n < _NEIGHBOURS + 1:
        return []
    dt = np.maximum(np.diff(stamps_ns).astype(np.float64), 1.0)
    velocity = np.diff(centres, axis=0) / dt[:, None]
    near = _neighbours(velocity)
    usual = np.nanmedian(near, axis=0)
    spread = np.nanmedian(np.linalg.norm(near - usual, axis=2), axis=0) * dt
    beyond = np.linalg.norm(velocity - usual, axis=1) * dt
    bound = _away(stamps_ns) * (_STEP_SPREADS * spread + _STEP_SHARE * depth[1:])
    out = []
    for k in np.flatnonzero(beyond > bound).tolist():
        text = f"a step {beyond[k]:.3g} beyond its neighbours', bound {bound[k]:.3g} {unit}"
        out.append((k + 1, Reason("a jump in the trajectory", text, float(beyond[k] / max(bound[k], 1e-12)))))
    return out


def _neighbours(values: Array) -> Array:
    """Of each step the values ``(8, n, ...)`` of those before and after it, NaN beyond the ends."""
    n = len(values)
    around = np.full((n + 2 * _NEIGHBOURS, *values.shape[1:]), np.nan)
    around[_NEIGHBOURS:-_NEIGHBOURS] = values
    return np.stack([around[k : k + n] for k in range(2 * _NEIGHBOURS + 1) if k != _NEIGHBOURS])


def _away(stamps_ns: NDArray[np.int64]) -> Array:
    """How far in time each step ``(n,)`` is from the middle of its neighbours, in multiples of what it is at the ends
    of a track without gaps, at least 1. A track may begin with a view of some frames ago; the camera that turns or
    brakes meanwhile moves otherwise than its neighbours, which are on one side only, tell."""
    middle = (stamps_ns[1:] + stamps_ns[:-1] - 2 * stamps_ns[0]) / 2.0
    apart = np.abs(np.nanmedian(_neighbours(middle) - middle, axis=0))
    return np.maximum(apart / ((_NEIGHBOURS + 1) / 2 * float(np.median(np.diff(stamps_ns)))), 1.0)
