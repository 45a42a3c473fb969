"""Which axes poses have that images contradict: those of a body that carries the camera, of another convention, or
inverted ones, by the same epipolar geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from itertools import product as choices

import numpy as np

from maslam.backend.geometry import Array, product, quat_wxyz_from_rotation, se3, se3_inverse

from .pose_agreement import MatchedRays, agreeing, rays_agreement

_USUAL = (
    ((0, 0, 1), (-1, 0, 0), (0, -1, 0)),  # x ahead, y left, z up: ROS, LiDARs
    ((0, 0, 1), (1, 0, 0), (0, 1, 0)),  # x ahead, y right, z down: aircraft
    ((1, 0, 0), (0, 0, 1), (0, -1, 0)),  # x right, y ahead, z up: survey
    ((1, 0, 0), (0, -1, 0), (0, 0, -1)),  # x right, y up, z behind: OpenGL
)
_WAYS = (("right", "left"), ("down", "up"), ("ahead", "behind"))
_ALIKE = 0.02
"""Shares of matches that differ by less are the same: on a straight path several axes fit."""


@dataclass(frozen=True, eq=False)
class FittingAxes:
    """``R_B_C`` ``(3, 3)``: the camera's axes in those of the poses; ``inverted``: poses map the world to the body;
    ``share`` (0 to 1) of matches that agree with the poses so taken."""

    R_B_C: Array
    inverted: bool
    share: float

    def words(self) -> str:
        """What the poses then are, for people."""
        if self.inverted:
            return "inverted poses (T_W_C, which maps the camera to the world, is meant)"
        ways = [_WAYS[int(np.abs(row).argmax())][int(row.sum() < 0)] for row in self.R_B_C]
        return f"poses of a body whose x points {ways[0]}, y {ways[1]}, z {ways[2]}"

    def numbers(self) -> str:
        """``T_B_C`` at no distance, as ``x,y,z,qx,qy,qz,qw``."""
        w, x, y, z = quat_wxyz_from_rotation(self.R_B_C)
        return ",".join(f"{v:.9g}" for v in (0.0, 0.0, 0.0, x + 0.0, y + 0.0, z + 0.0, w))


def fitting_axes(
    matched: Sequence[MatchedRays], fx: float, width: int, R_rectified: Array | None = None
) -> FittingAxes | None:
    """Of all axes along or against the camera's the first that agree best with ``matched`` rays, usual ones first;
    None without matches. Poses are those of the rectified camera, taken for the poses' own frame turned by
    ``R_rectified`` ``(3, 3)``."""
    turn = np.eye(3) if R_rectified is None else R_rectified
    best: FittingAxes | None = None
    for inverted in (False, True):
        for R_B_C in _axes(inverted):
            X = se3(turn.T if inverted else product(product(turn, R_B_C), turn.T), np.zeros(3))
            found = [rays_agreement(_seen_from(one, X, inverted), fx, width) for one in matched]
            pairs = [pair for pair in found if pair is not None]
            share = agreeing(pairs) if pairs else 0.0
            if best is None or share > best.share + _ALIKE:
                best = FittingAxes(R_B_C, inverted, share)
    return best if matched else None


def _axes(inverted: bool) -> list[Array]:
    """``R_B_C`` of the 24 ways in which axes can lie along or against the camera's, usual ones first, without its
    own; of ``inverted`` poses the camera's own only."""
    if inverted:
        return [np.eye(3)]
    usual = [np.array(rows, dtype=np.float64) for rows in _USUAL]
    every = [
        np.array(signs)[:, None] * np.eye(3)[list(order)]
        for order in permutations(range(3))
        for signs in choices((1.0, -1.0), repeat=3)
    ]
    others = [
        R for R in every if np.linalg.det(R) > 0 and not any(np.array_equal(R, one) for one in (*usual, np.eye(3)))
    ]
    return [*usual, *others]


def _seen_from(one: MatchedRays, X: Array, inverted: bool) -> MatchedRays:
    """The same rays with the camera at ``X`` in the frame of the poses."""
    back, (first, second) = se3_inverse(X), one.poses
    first, second = (se3_inverse(first), se3_inverse(second)) if inverted else (first, second)
    return replace(one, poses=(product(back, first), product(back, second)))
