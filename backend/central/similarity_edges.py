"""F over similarities: every node has a unit of length of its own, and an edge may measure how two units stand.

Node i is ``S_O_i``: its pose ``T_O_i`` and ``log_unit``, the logarithm of the size of its unit in the origin's. An edge
measures ``T_i_j``, its translation in i's unit, and ``log_scale``, of j's unit in i's. The cost is F of
:mod:`maslam.backend.central.linear` with one term more::

    kappa |R_j - R_i R_ij|_F^2 + tau |(t_j - t_i) / u_i - R_i t_ij|^2 + precision (log u_j - log u_i - log_scale)^2

which is F itself where all units are 1. To first order it is the logarithm of Sim(3) (Strasdat et al., RSS 2010).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..config import SimilarityConfig
from ..geometry import Array, product, project_to_so3, skew, so3_exp
from ..pose_graph.graph import Edge, EdgeKind
from .chordal import two_stage_poses
from .linear import BlockSystem, edge_costs, isotropic_weights, turn_derivatives
from .relaxation import Relaxation

WIDTH = 7
"""Unknowns of a node: shift in the common frame, turn in its own, logarithm of its unit."""
_DEFAULT = SimilarityConfig()
_HALVINGS = 12
# A fall of the cost by less than this share is rounding.
_ROUNDING = 1e-12


@dataclass(frozen=True, eq=False)
class SimilarityEdges:
    """``ends`` ``(m, 2)`` rows of the nodes, ``measured`` ``(m, 4, 4)``, and ``log_scale``, ``kappa``, ``tau``,
    ``precision`` ``(m,)``."""

    ends: NDArray[np.intp]
    measured: Array
    log_scale: Array
    kappa: Array
    tau: Array
    precision: Array

    def only(self, used: NDArray[np.bool_]) -> SimilarityEdges:
        """The edges ``used`` ``(m,)``."""
        weights = (self.kappa[used], self.tau[used], self.precision[used])
        return SimilarityEdges(self.ends[used], self.measured[used], self.log_scale[used], *weights)

    def and_also(self, other: SimilarityEdges) -> SimilarityEdges:
        """These, then the other's; ``ends`` as they are."""
        return SimilarityEdges.together([self, other])

    @staticmethod
    def together(groups: Sequence[SimilarityEdges]) -> SimilarityEdges:
        """All of the groups, one after the other, at least one; ``ends`` as they are."""
        by_group = [(g.ends, g.measured, g.log_scale, g.kappa, g.tau, g.precision) for g in groups]
        return SimilarityEdges(*(np.concatenate(column) for column in zip(*by_group, strict=True)))

    def moved_to(self, rows: NDArray[np.intp]) -> SimilarityEdges:
        """The same edges between other rows: node k of theirs is ``rows[k]``."""
        return replace(self, ends=rows[self.ends])

    def weighted(self, weight: Array) -> SimilarityEdges:
        """With all three weights multiplied by ``weight`` ``(m,)``."""
        return replace(self, kappa=self.kappa * weight, tau=self.tau * weight, precision=self.precision * weight)

    def costs(self, poses: Array, log_units: Array) -> Array:
        """Each edge's share of F ``(m,)``, from ``poses`` ``(n, 4, 4)`` and ``log_units`` ``(n,)``."""
        i, j = self.ends.T
        if not (log_units.any() or self.log_scale.any()):
            return edge_costs(poses[i], poses[j], self.measured, self.kappa, self.tau)
        R = poses[:, :3, :3]
        rotation = ((R[j] - R[i] @ self.measured[:, :3, :3]) ** 2).sum(axis=(1, 2))
        shift = self._seen(poses, log_units) - _apply(R[i], self.measured[:, :3, 3])
        scale = log_units[j] - log_units[i] - self.log_scale
        return np.asarray(self.kappa * rotation + self.tau * (shift**2).sum(axis=1) + self.precision * scale**2)

    def blocks(self, poses: Array, log_units: Array, fixed: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Hessians ``(m, 14, 14)`` and right-hand sides ``(m, 14, 1)`` of a Gauss-Newton step of F.

        Unknowns of a node: its translation (absolute), its turn ``R exp([delta])``, and the change of its log unit.
        Where a position is not known yet (NaN) the measurement stands in for it. ``fixed`` ``(n,)``: nodes whose unit
        stays.
        """
        i, j = self.ends.T
        m, R = len(i), poses[:, :3, :3]
        R_ij, t_ij = self.measured[:, :3, :3], self.measured[:, :3, 3]
        turned = _apply(R[i], t_ij)
        seen = self._seen(poses, log_units)
        seen = np.where(np.isfinite(seen), seen, turned)
        jacobian, residual = np.zeros((m, 13, 14)), np.zeros((m, 13))
        shrink = np.exp(-log_units[i])[:, None, None] * np.eye(3)
        jacobian[:, :3, :3], jacobian[:, :3, 7:10] = -shrink, shrink
        jacobian[:, :3, 3:6] = R[i] @ skew(t_ij)
        jacobian[:, :3, 6] = -seen
        jacobian[:, 3:12, 3:6], jacobian[:, 3:12, 10:13] = turn_derivatives(R[i], R[j], R_ij)
        jacobian[:, 12, 6], jacobian[:, 12, 13] = -1.0, 1.0
        residual[:, :3] = -turned
        residual[:, 3:12] = (R[j] - R[i] @ R_ij).reshape(m, 9)
        residual[:, 12] = log_units[j] - log_units[i] - self.log_scale
        jacobian[fixed[i], :, 6] = jacobian[fixed[j], :, 13] = 0.0
        weights = np.repeat(np.stack([self.tau, self.kappa, self.precision], axis=1), (3, 9, 1), axis=1)
        weighted = jacobian * weights[:, :, None]
        hessian = np.swapaxes(jacobian, 1, 2) @ weighted
        # What is fixed does not move: its equation says 1 times the change is 0.
        hessian[:, 6, 6] += fixed[i]
        hessian[:, 13, 13] += fixed[j]
        return hessian, -(np.swapaxes(weighted, 1, 2) @ residual[:, :, None])

    def _seen(self, poses: Array, log_units: Array) -> Array:
        """``(t_j - t_i) / u_i`` ``(m, 3)``."""
        i, j = self.ends.T
        return np.asarray((poses[j, :3, 3] - poses[i, :3, 3]) * np.exp(-log_units[i])[:, None])


def edges_of(
    edges: Sequence[Edge], ends: NDArray[np.intp], dimension: int = 3, config: SimilarityConfig = _DEFAULT
) -> SimilarityEdges:
    """Edges of a graph as arrays, their own weight multiplied in. ``config``: deviations of log scales where an edge
    says none."""
    measured = np.array([e.T_i_j for e in edges]).reshape(-1, 4, 4)
    kappa, tau = isotropic_weights(np.array([e.information for e in edges]), dimension)
    log_scale = np.log(np.array([e.scale for e in edges], dtype=np.float64))
    found = SimilarityEdges(ends, measured, log_scale, kappa, tau, scale_precisions(edges, config))
    return found.weighted(np.array([e.weight for e in edges], dtype=np.float64))


def scale_precisions(edges: Sequence[Edge], config: SimilarityConfig = _DEFAULT) -> Array:
    """Inverse variances ``(m,)`` of the edges' log scales: their own, else those of ``config`` for their kind."""
    by_kind = [config.drift_sigma if e.kind is EdgeKind.ODOMETRY else config.match_sigma for e in edges]
    sigma = [s if e.scale_sigma is None else e.scale_sigma for e, s in zip(edges, by_kind, strict=True)]
    return np.array(sigma, dtype=np.float64) ** -2.0


@dataclass(frozen=True, eq=False)
class Descended:
    """``poses`` ``(n, 4, 4)``, ``log_units`` ``(n,)``, the Gauss-Newton steps that led there."""

    poses: Array
    log_units: Array
    steps: int


def descend(
    edges: SimilarityEdges,
    poses: Array,
    log_units: Array,
    held: Sequence[int],
    fixed: NDArray[np.bool_],
    steps: int = 50,
) -> Descended:
    """At most ``steps`` Gauss-Newton steps on F, each halved until it lowers the cost; ``held`` nodes stay, those
    ``fixed`` keep their unit. Never ends higher than it began."""
    free = np.setdiff1d(np.arange(len(poses)), held)
    now = float(edges.costs(poses, log_units).sum())
    for taken in range(steps):
        step = newton_step(edges, poses, log_units, free, fixed)
        for halving in range(_HALVINGS):
            moved = moved_by(poses, log_units, free, step * 0.5**halving)
            cost = float(edges.costs(*moved).sum())
            if cost < now:
                break
        else:
            return Descended(poses, log_units, taken)
        fallen, now = now - cost, cost
        poses, log_units = moved
        if fallen <= _ROUNDING * now:
            return Descended(poses, log_units, taken + 1)
    return Descended(poses, log_units, steps)


def newton_step(
    edges: SimilarityEdges, poses: Array, log_units: Array, free: NDArray[np.intp], fixed: NDArray[np.bool_]
) -> Array:
    """A Gauss-Newton step ``(k, 7)`` of the ``free`` nodes, the others held."""
    hessian, rhs = edges.blocks(poses, log_units, fixed)
    system = BlockSystem(edges.ends, hessian, rhs, free, np.ones(len(edges.ends), dtype=bool))
    values = np.zeros((len(poses), WIDTH, 1))
    values[:, :3, 0] = poses[:, :3, 3]
    step: Array = system.solve(values)[:, :, 0]
    step[:, :3] -= poses[free, :3, 3]
    step[fixed[free], 6] = 0.0
    return step


def moved_by(poses: Array, log_units: Array, rows: NDArray[np.intp], step: Array) -> tuple[Array, Array]:
    """Poses and log units with the ``rows`` moved by ``step`` ``(k, 7)``."""
    poses, log_units = poses.copy(), log_units.copy()
    poses[rows, :3, :3] = project_to_so3(poses[rows, :3, :3] @ so3_exp(step[:, 3:6]))
    poses[rows, :3, 3] += step[:, :3]
    log_units[rows] += step[:, 6]
    return poses, log_units


def linear_start(
    edges: SimilarityEdges, poses: Array, log_units: Array, held: Sequence[int], fixed: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """Poses and log units from linear problems, no guess needed: chordal rotations, then log units, then translations
    with both held. ``held`` nodes stay as given, ``fixed`` ones keep their unit."""
    rows = np.array(held, dtype=np.intp)
    placed = two_stage_poses(edges.ends, edges.measured, (edges.kappa, edges.tau), poses, 0, held)
    known = np.union1d(rows, np.flatnonzero(fixed))
    units = differences(edges.ends, edges.log_scale[:, None], edges.precision, log_units[:, None], known)[:, 0]
    i = edges.ends[:, 0]
    size = np.exp(units[i])
    shift = _apply(placed[i, :3, :3], edges.measured[:, :3, 3]) * size[:, None]
    placed[:, :3, 3] = differences(edges.ends, shift, edges.tau / size**2, poses[:, :3, 3], rows)
    return placed, units


def differences(ends: NDArray[np.intp], wanted: Array, weight: Array, values: Array, given: NDArray[np.intp]) -> Array:
    """Values ``(n, c)`` whose differences along the edges are ``wanted`` ``(m, c)`` in the least squares; rows
    ``given``, and those that no edge ties to them, are those of ``values``."""
    if len(given) == len(values):
        return values.copy()
    unknown = np.full((len(values), 1, wanted.shape[1]), np.nan)
    unknown[given, 0] = values[given]
    hessian = weight[:, None, None] * np.array([[1.0, -1.0], [-1.0, 1.0]])
    rhs = weight[:, None, None] * np.stack([-wanted, wanted], axis=1)
    stage = Relaxation(ends, (hessian, rhs), unknown, len(values), given.tolist())
    stage.sweep(1.0)
    return np.where(np.isfinite(stage.values[:, 0]), stage.values[:, 0], values)


def _apply(matrices: Array, vectors: Array) -> Array:
    return product(matrices, vectors[..., None])[..., 0]
