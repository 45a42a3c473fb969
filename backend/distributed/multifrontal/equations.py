"""The quadratic problems that lead to the minimum of F, one after the other, as blocks of a robot's edges.

Rotations (chordal), log units, positions: linear, no guess needed. Then Gauss-Newton steps for all (as
:mod:`maslam.backend.central.similarity_edges` has them).
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from ...central.linear import curvature_blocks, pose_blocks, rotation_blocks
from ...central.similarity_edges import SimilarityEdges
from ...geometry import Array, project_to_so3, se3, so3_exp
from ..places import RIGID, SCALED, Places


class Unknowns(IntEnum):
    """What a pass looks for; ``KNOWN``: nothing, the poses share a frame already and are passed on."""

    KNOWN = 0
    ROTATION = 1
    UNIT = 2
    POSITION = 3
    POSE = 4


class Matrices(IntEnum):
    """Which matrices robots pass on: none, the last ones count again; Gauss-Newton's, or those of linear problems; the
    exact second derivative's, where that has a minimum."""

    OLD = 0
    GAUSS_NEWTON = 1
    EXACT = 2


class StepFrom(IntEnum):
    """Where the next pass begins: a step further; there, and where poses are now is remembered as the best; half of the
    last step back; where the best was."""

    FURTHER = 0
    BEST_AND_FURTHER = 1
    HALFWAY = 2
    BEST = 3

    @property
    def moves(self) -> bool:
        """Whether a step's numbers come with it."""
        return self in (StepFrom.FURTHER, StepFrom.BEST_AND_FURTHER)


def shape_of(problem: Unknowns, scaled: bool) -> tuple[int, int]:
    """Unknowns of a node, and right-hand sides."""
    poses = SCALED if scaled else RIGID
    return {
        Unknowns.KNOWN: (0, 0),
        Unknowns.ROTATION: (3, 3),
        Unknowns.UNIT: (1, 1),
        Unknowns.POSITION: (1, 3),
        Unknowns.POSE: (poses, 1),
    }[problem]


class Equations:
    """A robot's edges between ``places`` ``(n,)``; ``fixed`` ``(n,)``: nodes whose unit stays."""

    def __init__(self, edges: SimilarityEdges, fixed: NDArray[np.bool_], scaled: bool) -> None:
        self.edges, self._fixed, self._scaled = edges, fixed, scaled

    def blocks(self, problem: Unknowns, places: Places) -> tuple[Array, Array]:
        """Matrices ``(m, 2w, 2w)`` and right-hand sides ``(m, 2w, c)`` of each edge; in ``POSE`` of a move from where
        the nodes are, else of what is looked for itself."""
        match problem:
            case Unknowns.ROTATION:
                return rotation_blocks(self.edges.measured[:, :3, :3], self.edges.kappa)
            case Unknowns.UNIT:
                return self._units()
            case Unknowns.POSITION:
                return self._positions(places)
            case _:
                return self._poses(places)

    def curvature(self, places: Places) -> Array:
        """What the second derivative has more than the matrices of ``POSE``; nothing where units are variables."""
        i, j = self.edges.ends.T
        if self._scaled:
            return np.zeros((len(i), 2 * SCALED, 2 * SCALED))
        e = self.edges
        return curvature_blocks(places.poses[i], places.poses[j], e.measured, e.kappa, e.tau)

    def right_hand_sides(self, problem: Unknowns, places: Places, count: int) -> Array:
        """Their sums ``(n, w, c)`` over the ``count`` nodes."""
        width, columns = shape_of(problem, self._scaled)
        out = np.zeros((count, width, columns))
        rhs = self.blocks(problem, places)[1]
        for side in range(2):
            np.add.at(out, self.edges.ends[:, side], rhs[:, side * width : (side + 1) * width])
        return out

    def cost(self, places: Places) -> float:
        """F over the edges."""
        return float(self.edges.costs(places.poses, places.log_units).sum())

    def _units(self) -> tuple[Array, Array]:
        free = ~self._fixed[self.edges.ends]
        matrix = np.array([[1.0, -1.0], [-1.0, 1.0]]) * (free[:, :, None] & free[:, None, :])
        weight = self.edges.precision
        hessian = weight[:, None, None] * matrix
        for side in range(2):
            hessian[:, side, side] = np.where(free[:, side], weight, 1.0)
        wanted = (weight * self.edges.log_scale)[:, None] * np.array([-1.0, 1.0]) * free
        return hessian, wanted[:, :, None]

    def _positions(self, places: Places) -> tuple[Array, Array]:
        i = self.edges.ends[:, 0]
        size = np.exp(places.log_units[i])
        shift = np.einsum("mab,mb->ma", places.poses[i, :3, :3], self.edges.measured[:, :3, 3]) * size[:, None]
        weight = (self.edges.tau / size**2)[:, None, None]
        return weight * np.array([[1.0, -1.0], [-1.0, 1.0]]), weight * np.stack([-shift, shift], axis=1)

    def _poses(self, places: Places) -> tuple[Array, Array]:
        i, j = self.edges.ends.T
        poses = places.poses
        if self._scaled:
            hessian, rhs = self.edges.blocks(poses, places.log_units, self._fixed)
        else:
            R = poses[:, :3, :3]
            hessian, rhs = pose_blocks(R[i], R[j], self.edges.measured, self.edges.kappa, self.edges.tau)
        width = hessian.shape[1] // 2
        now = np.zeros((len(i), 2 * width, 1))
        now[:, :3, 0], now[:, width : width + 3, 0] = poses[i, :3, 3], poses[j, :3, 3]
        return hessian, rhs - hessian @ now


def put_solution(problem: Unknowns, places: Places, rows: NDArray[np.intp], values: Array) -> None:
    """Set ``rows`` of ``places`` to what was found ``(k, w, c)``; in place."""
    match problem:
        case Unknowns.ROTATION:
            places.poses[rows, :3, :3] = project_to_so3(np.swapaxes(values, 1, 2))
        case Unknowns.UNIT:
            places.log_units[rows] = values[:, 0, 0]
        case Unknowns.POSITION:
            places.poses[rows, :3, 3] = values[:, 0]
        case Unknowns.POSE:
            x = values[:, :, 0]
            R, t = places.poses[rows, :3, :3], places.poses[rows, :3, 3]
            places.poses[rows] = se3(R @ so3_exp(x[:, 3:6]), t + x[:, :3])
            if x.shape[1] == SCALED:
                places.log_units[rows] += x[:, 6]


def solution_at(problem: Unknowns, places: Places, rows: NDArray[np.intp]) -> Array:
    """Inverse of :func:`put_solution` for the linear problems: ``(k, w, c)``."""
    match problem:
        case Unknowns.ROTATION:
            return np.swapaxes(places.poses[rows, :3, :3], 1, 2)
        case Unknowns.UNIT:
            return places.log_units[rows][:, None, None]
        case _:
            return places.poses[rows, :3, 3][:, None, :]
