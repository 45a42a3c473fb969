"""Knots along a robot's track, and how poses between them go along: the coarse level's unknowns.

A knot moves as a rigid body (or a similarity) about its centre. A pose between two knots moves by a mix of both, in
linear proportion to its place between them; poses beyond the outermost go with these.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import Array, skew
from ..places import RIGID, SCALED, Places

# Weights are shares of this, so that a byte says them exactly.
_WHOLE = 255
# A piece with so few shared poses has a knot at each.
_FEW = 6


@dataclass(frozen=True, eq=False)
class Hats:
    """``first`` ``(n,)``: the knot before each pose, -1 where none moves it; ``weight`` ``(n,)``: the share (0 to 1) of
    the knot after it, a multiple of 1/255."""

    first: NDArray[np.intp]
    weight: Array

    def at(self, rows: NDArray[np.intp]) -> Hats:
        """Those of some ``rows``."""
        return Hats(self.first[rows], self.weight[rows])

    def sides(self) -> tuple[tuple[NDArray[np.intp], Array], tuple[NDArray[np.intp], Array]]:
        """Knots and weights, before and after; a knot of no weight is the one before."""
        after = np.where(self.weight > 0, self.first + 1, self.first)
        return (self.first, 1.0 - self.weight), (after, self.weight)


def hats_of(label: NDArray[np.intp], key: NDArray[np.bool_], spacing: int) -> tuple[Hats, NDArray[np.intp]]:
    """Hats of poses ``(n,)`` in the order of their track, and the rows at which knots are.

    ``label`` ``(n,)``: the piece that a pose belongs to, no knot holds two together; ``key`` ``(n,)``: poses that
    matter to others: about one in ``spacing`` of them is a knot, the first and the last always.
    """
    first, weight = np.full(len(label), -1, dtype=np.intp), np.zeros(len(label))
    knots: list[int] = []
    for piece in np.unique(label[key]):
        rows = np.flatnonzero(label == piece)
        keys = np.flatnonzero((label == piece) & key)
        count = min(len(keys), max(-(-len(keys) // spacing) + 1, _FEW))
        at = np.unique(keys[np.rint(np.linspace(0, len(keys) - 1, count)).astype(np.intp)])
        place = np.interp(rows, at, np.arange(len(at)))
        before = np.minimum(place.astype(np.intp), max(len(at) - 2, 0))
        first[rows] = len(knots) + before
        weight[rows] = np.rint((place - before) * _WHOLE) / _WHOLE if len(at) > 1 else 0.0
        knots += at.tolist()
    return Hats(first, weight), np.array(knots, dtype=np.intp)


def weight_bytes(weight: Array) -> NDArray[np.uint8]:
    """Weights as they are sent."""
    return np.asarray(np.rint(weight * _WHOLE), dtype=np.uint8)


def weights_from(data: NDArray[np.uint8]) -> Array:
    """Inverse of :func:`weight_bytes`."""
    return np.asarray(data / _WHOLE, dtype=np.float64)


def carried(hats: Hats, centres: Array, steps: Array, places: Places, fixed: NDArray[np.bool_]) -> Array:
    """Moves ``(n, w)`` of ``places`` (shift in the common frame, turn in the pose's own, log unit) where knots at
    ``centres`` ``(k, 3)`` move by ``steps`` ``(k, w)``: shift of the centre and turn, both in the common frame, and log
    unit. ``fixed`` ``(n,)``: poses whose unit stays."""
    n, width = len(hats.first), steps.shape[1]
    shift, turn, grown = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros(n)
    moved = hats.first >= 0
    for knot, weight in hats.sides():
        k, w = knot[moved], weight[moved][:, None]
        arm = places.poses[moved, :3, 3] - centres[k]
        shift[moved] += w * (steps[k, :3] + np.cross(steps[k, 3:6], arm))
        turn[moved] += w * steps[k, 3:6]
        if width == SCALED:
            shift[moved] += w * steps[k, 6:] * arm
            grown[moved] += w[:, 0] * steps[k, 6]
    out = np.zeros((n, width))
    out[:, :3] = shift
    out[:, 3:6] = np.einsum("nba,nb->na", places.poses[:, :3, :3], turn)
    if width == SCALED:
        out[:, 6] = np.where(fixed, 0.0, grown)
    return out


def gathered(hats: Hats, centres: Array, forces: Array, places: Places, fixed: NDArray[np.bool_]) -> Array:
    """The transpose of :func:`carried`: what ``forces`` ``(n, w)`` on poses are to the knots ``(k, w)``."""
    width = forces.shape[1]
    out = np.zeros((len(centres), width))
    moved = np.flatnonzero(hats.first >= 0)
    pull = forces[moved, :3]
    twist = np.einsum("nab,nb->na", places.poses[moved, :3, :3], forces[moved, 3:6])
    for knot, weight in hats.sides():
        k, w = knot[moved], weight[moved][:, None]
        arm = places.poses[moved, :3, 3] - centres[k]
        np.add.at(out[:, :3], k, w * pull)
        np.add.at(out[:, 3:6], k, w * (twist + np.cross(arm, pull)))
        if width == SCALED:
            own = np.where(fixed[moved], 0.0, forces[moved, 6])
            np.add.at(out[:, 6], k, w[:, 0] * ((arm * pull).sum(axis=1) + own))
    return out


def arms(point: Array, centre: Array, width: int) -> Array:
    """``(m, w, w)``: how a body at ``point`` ``(m, 3)`` moves that goes with a knot at ``centre`` ``(m, 3)``: shift and
    turn in the common frame, and log unit."""
    out = np.zeros((len(point), width, width))
    out[:, range(width), range(width)] = 1.0
    out[:, :3, 3:6] = -skew(point - centre)
    if width == SCALED:
        out[:, :3, RIGID] = point - centre
    return out
