"""Two methods from matches to a pose: from 3-D points of both views, or from the match's points and the query's
directions alone."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..config import RelPoseConfig
from ..geometry import Array, Sim3
from .absolute_pose import lend_depths, lend_surface, refine_bearings, search_bearings, with_scale
from .alignment import ITERATIONS, Alignment, refine
from .ransac import Transforms, agreeing, search

# Depths of the query that make its unit known.
_MIN_DEPTHS = 6
# The query's depths are believed as evidence when so many of its matches' lie within this factor of the match's.
_SOUND_SHARE, _SOUND_RATIO = 0.8, 1.25


class PoseSolver(Protocol):
    """Solver for the pose between two views.

    Matched points are ``(k, 3)`` in their cameras' frames; ``points_Q`` may be mere directions to a solver that needs
    no depths of the query.
    """

    def search(self, points_M: Array, points_Q: Array, rng: np.random.Generator) -> list[Sim3]:
        """Hypotheses, best first."""

    def refine(self, points_M: Array, points_Q: Array, start: Sim3, iterations: int = ITERATIONS) -> Alignment:
        """Robust least squares from ``start``."""

    def placed(self, T_M_Q: Sim3, points_M: Array, points_Q: Array) -> Array:
        """The query's side of matches ``(k, 3)`` with depths that this solver goes by."""

    def surface(
        self, T_M_Q: Sim3, points_M: Array, points_Q: Array, known: NDArray[np.bool_], pairs: NDArray[np.intp]
    ) -> Array:
        """All points of the query ``(n, 3)`` as evidence: their depths may be ``known`` ``(n,)``, ``pairs`` ``(g, 2)``
        are matched to those of the match ``(m, 3)``."""

    def finish(self, found: Alignment, points_M: Array, points_Q: Array, known: NDArray[np.bool_]) -> Alignment | str:
        """The result in both views' units, of final matches, of which the query's depth may be ``known`` ``(k,)``; or
        why there is none."""


class PointsSolver:
    """Points to points: depths of both views count, by their noise."""

    def __init__(self, scaled: bool, config: RelPoseConfig) -> None:
        self._scaled, self._config = scaled, config

    def search(self, points_M: Array, points_Q: Array, rng: np.random.Generator) -> list[Sim3]:
        """See :meth:`PoseSolver.search`."""
        return search(points_M, points_Q, self._scaled, self._config, rng)

    def refine(self, points_M: Array, points_Q: Array, start: Sim3, iterations: int = ITERATIONS) -> Alignment:
        """See :meth:`PoseSolver.refine`."""
        return refine(points_M, points_Q, start, self._scaled, self._config.loss_scale, iterations)

    def placed(self, T_M_Q: Sim3, points_M: Array, points_Q: Array) -> Array:
        """The query's points as they are."""
        return points_Q

    def surface(
        self, T_M_Q: Sim3, points_M: Array, points_Q: Array, known: NDArray[np.bool_], pairs: NDArray[np.intp]
    ) -> Array:
        """The query's points as they are."""
        return points_Q

    def finish(self, found: Alignment, points_M: Array, points_Q: Array, known: NDArray[np.bool_]) -> Alignment | str:
        """``found`` as it is."""
        return found


class BearingsSolver:
    """Points to directions (PnP): the query's depths are neither used nor missed, but for the scale."""

    def __init__(self, scaled: bool, config: RelPoseConfig) -> None:
        self._scaled, self._config = scaled, config

    def search(self, points_M: Array, points_Q: Array, rng: np.random.Generator) -> list[Sim3]:
        """See :meth:`PoseSolver.search`."""
        return search_bearings(points_M, points_Q, self._config.search_angle_deg, rng)

    def refine(self, points_M: Array, points_Q: Array, start: Sim3, iterations: int = ITERATIONS) -> Alignment:
        """See :meth:`PoseSolver.refine`."""
        return refine_bearings(points_M, points_Q, start, self._config.loss_scale, iterations)

    def placed(self, T_M_Q: Sim3, points_M: Array, points_Q: Array) -> Array:
        """The query's directions at the depths of the match's points under the pose."""
        return lend_depths(T_M_Q, points_M, points_Q)

    def surface(
        self, T_M_Q: Sim3, points_M: Array, points_Q: Array, known: NDArray[np.bool_], pairs: NDArray[np.intp]
    ) -> Array:
        """See :meth:`PoseSolver.surface`."""
        lent = lend_surface(T_M_Q, points_M, points_Q)
        measured = pairs[known[pairs[:, 0]]]
        if len(measured) < _MIN_DEPTHS:
            return lent
        own, points = points_Q[measured[:, 0]], points_M[measured[:, 1]]
        logs = np.log(np.linalg.norm(lend_depths(T_M_Q, points, own), axis=1) / np.linalg.norm(own, axis=1))
        sound = np.mean(np.abs(logs) < np.log(_SOUND_RATIO)) >= _SOUND_SHARE
        return np.where(known[:, None], points_Q, lent) if sound else lent

    def finish(self, found: Alignment, points_M: Array, points_Q: Array, known: NDArray[np.bool_]) -> Alignment | str:
        """See :meth:`PoseSolver.finish`."""
        if not self._scaled:
            return found
        if known.sum() < _MIN_DEPTHS:
            return f"no scale: {known.sum()} matches have a depth in the query < {_MIN_DEPTHS}"
        return with_scale(found, points_M[known], points_Q[known], self._config.loss_scale)


def solver_for(scaled: bool, config: RelPoseConfig) -> PoseSolver:
    """The solver for ``config``; ``scaled``: one of the views has a unit of its own."""
    return BearingsSolver(scaled, config) if config.solver == "pnp" else PointsSolver(scaled, config)


def fitting(
    solver: PoseSolver, T_M_Q: Sim3, points_M: Array, points_Q: Array, angle_deg: float, depth_ratio: float
) -> NDArray[np.bool_]:
    """Mask ``(k,)`` of the matches that a pose explains: bearing error up to ``angle_deg``, depths within the factor
    ``depth_ratio``."""
    placed = solver.placed(T_M_Q, points_M, points_Q)
    return agreeing(Transforms.of(T_M_Q), points_M, placed, angle_deg, depth_ratio)[0]
