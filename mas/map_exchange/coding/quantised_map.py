"""A quantised map: all its numbers whole, so that every copy of a version is the same to the last bit.

The owner rounds once. Whatever way a copy takes, whole or in patches, from the owner or from somebody who bought it,
it ends with these numbers. All lengths are in the owner's own unit; steps are relative to depth, so that they fit any.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, Sim3, se3, so3_exp, so3_log

from ...errors import MasError
from ...protocol.ids import FrameId, MatchId
from ...state.place_match import ReportedMatch

Ints = NDArray[np.int64]

TICK_NS = 1_000_000
# Columns of a pose, and with the key-frame's own unit.
RIGID, WITH_UNIT = 6, 7
# Steps travel as powers of 2^(1/8).
_STEPS_AN_OCTAVE = 8
_LEAST_STEP, _MOST_STEP = -240, 240
# e^20 units away: beyond any camera.
_MOST_LOG_DEPTH = 20.0


class StepsError(MasError):
    """Steps out of range."""


@dataclass(frozen=True)
class Steps:
    """Quantisation steps: ``position`` (owner's unit), ``rotation`` (radians, and log scale), ``direction``
    (tangent), ``depth`` (logarithm), each as the exponent ``n`` of ``2^(n/8)``."""

    position: int
    rotation: int
    direction: int
    depth: int

    def __post_init__(self) -> None:
        for name in ("position", "rotation", "direction", "depth"):
            if not _LEAST_STEP <= getattr(self, name) <= _MOST_STEP:
                raise StepsError(f"{name}: step 2^({getattr(self, name)}/8) is out of range")

    @classmethod
    def of(cls, point_error: float, pose_error: float, depth: float) -> Steps:
        """Steps for points with this median error, as a share of their distance, and poses that are this exact, as a
        share of the scene's median ``depth`` and in radians; a lattice of a quarter of that.

        A point's error is that of a cube of half a step: its median is 0.98 of it ((3 / pi)^(1/3)).
        """
        point = exponent(2.0 * point_error)
        return cls(exponent(0.25 * pose_error * depth), exponent(0.25 * pose_error), point, point)


def exponent(step: float) -> int:
    """The largest ``n`` with ``2^(n/8) <= step``."""
    return int(np.floor(_STEPS_AN_OCTAVE * np.log2(step) + 1e-9))


def size(n: int) -> float:
    """``2^(n/8)``."""
    return float(2.0 ** (n / _STEPS_AN_OCTAVE))


@dataclass(frozen=True, eq=False)
class QuantisedMap:
    """``version`` counts from 1; ``frame``: whose coordinates, ``unit``: what the owner's unit is worth there, that of
    its first key-frame where each has its own (``drifting``).

    ``keyframes``, ``ticks`` (milliseconds) ``(K,)``; ``poses`` ``(K, 6)``: position and rotation vector of ``T_F_C``;
    ``(K, 7)`` where it is drifting, then with the log of the key-frame's own unit in ``unit``. What a key-frame sees is
    in its own unit and is never sold again, whatever an optimisation does to that. ``counts`` ``(K,)``: points of each
    key-frame, whose ``cells`` ``(P, 2)`` are row and column of their direction and ``depths`` ``(P,)`` the logarithm of
    z; ``descriptors`` ``(P, 32)`` or None; ``matches`` ``(m, 3)``: own key-frame
    (query), agent and key-frame of the match; ``transforms`` ``(m, 7)``: ``T_M_Q`` in the owner's unit, and log scale.
    """

    owner: int
    version: int
    frame: FrameId
    unit: float
    steps: Steps
    keyframes: Ints
    ticks: Ints
    poses: Ints
    counts: Ints
    cells: Ints
    depths: Ints
    descriptors: NDArray[np.uint8] | None
    matches: Ints
    transforms: Ints

    @property
    def stamps_ns(self) -> Ints:
        """``(K,)`` time stamps in the source's clock, to the millisecond."""
        return self.ticks * TICK_NS

    @property
    def references(self) -> Ints:
        """``(P,)`` row of the key-frame of each point."""
        return np.repeat(np.arange(len(self.keyframes)), self.counts)

    @property
    def drifting(self) -> bool:
        """Whether each key-frame has a unit of its own."""
        return self.poses.shape[1] > RIGID

    def poses_F(self) -> Array:
        """``(K, 4, 4)``, in ``unit``."""
        return poses_of(self.poses, self.steps)

    def units(self) -> Array:
        """``(K,)``: each key-frame's own unit, in ``unit``."""
        if not self.drifting:
            return np.ones(len(self.poses))
        return np.asarray(np.exp(self.poses[:, RIGID] * size(self.steps.rotation)))

    def points_C(self) -> Array:
        """``(P, 3)`` in their key-frame's camera and unit."""
        return points_of(self.cells, self.depths, self.steps)

    def reported_matches(self) -> tuple[ReportedMatch, ...]:
        """The owner's accepted queries."""
        rotation = size(self.steps.rotation)
        scales = np.exp(self.transforms[:, 6] * rotation)
        moves = self.transforms[:, :3] * size(self.steps.position) * scales[:, None]
        turns = so3_exp(self.transforms[:, 3:6] * rotation)
        return tuple(
            ReportedMatch(MatchId(self.owner, *ids), Sim3(turn, move, float(scale)))
            for ids, turn, move, scale in zip(self.matches.tolist(), turns, moves, scales, strict=True)
        )


def empty_map(owner: int, frame: FrameId, steps: Steps) -> QuantisedMap:
    """Version 0: nothing."""
    none = np.zeros(0, dtype=np.int64)
    rows = [none.reshape(0, n) for n in (6, 2, 3, 7)]
    return QuantisedMap(owner, 0, frame, 1.0, steps, none, none, rows[0], none, rows[1], none, None, rows[2], rows[3])


def quantised(poses: Array, steps: Steps, units: Array | None = None) -> Ints:
    """``(K, 6)`` of ``(K, 4, 4)`` in the owner's unit; ``(K, 7)`` with the key-frames' own ``units`` ``(K,)``."""
    t = np.asarray(poses, dtype=np.float64).reshape(-1, 4, 4)
    rotation = size(steps.rotation)
    rows = [t[:, :3, 3] / size(steps.position), so3_log(t[:, :3, :3]).reshape(-1, 3) / rotation]
    if units is not None:
        rows.append(np.log(units)[:, None] / rotation)
    return _rounded(np.concatenate(rows, axis=1))


def widened(poses: Ints, columns: int) -> Ints:
    """``(K, columns)``: poses of a map that is not drifting as those of one that is, all units 1."""
    return np.pad(poses, ((0, 0), (0, columns - poses.shape[1])))


def poses_of(rows: Ints, steps: Steps) -> Array:
    """The poses of :func:`quantised` rows."""
    return se3(so3_exp(rows[:, 3:RIGID] * size(steps.rotation)), rows[:, :3] * size(steps.position))


def quantised_match(T_M_Q: Sim3, steps: Steps) -> Ints:
    """``(7,)``."""
    rotation = size(steps.rotation)
    move = T_M_Q.translation / T_M_Q.scale / size(steps.position)
    return _rounded(np.concatenate([move, so3_log(T_M_Q.rotation) / rotation, [np.log(T_M_Q.scale) / rotation]]))


@dataclass(frozen=True, eq=False)
class QuantisedPoints:
    """Points of one key-frame in order of their cells: ``order`` ``(n,)``: the row that each had, ``cells`` ``(n, 2)``,
    ``depths`` ``(n,)`` as in :class:`QuantisedMap`."""

    order: Ints
    cells: Ints
    depths: Ints


def quantised_points(points_C: NDArray[Any], steps: Steps) -> QuantisedPoints:
    """Points ``(n, 3)`` in front of a camera, in the owner's unit."""
    p = np.asarray(points_C, dtype=np.float64)
    cells = np.floor(p[:, [1, 0]] / p[:, 2:] / size(steps.direction)).astype(np.int64)
    depths = _rounded(np.log(p[:, 2]) / size(steps.depth))
    order = np.lexsort((depths, cells[:, 1], cells[:, 0]))
    return QuantisedPoints(order, cells[order], depths[order])


def points_of(cells: Ints, depths: Ints, steps: Steps) -> Array:
    """Inverse of :func:`quantised_points`: the middle of each cell."""
    z = np.exp(np.clip(depths * size(steps.depth), -_MOST_LOG_DEPTH, _MOST_LOG_DEPTH))
    xy = (cells[:, ::-1] + 0.5) * size(steps.direction)
    return np.column_stack([xy * z[:, None], z])


def _rounded(values: Array) -> Ints:
    return np.rint(values).astype(np.int64)
