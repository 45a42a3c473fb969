"""Priors among a group's edges: the frame that they are measured in is one more node, found along with the poses.

A prior is an edge from that node, the origin, to a key-frame. The anchor's first node stays where it is, as without
priors; so the group keeps its frame, and the origin gets a place in it. Positions (GPS) weigh nothing on rotations;
those that are off are bounded by a kernel that is wide at first (graduated non-convexity) and ends at each one's bound.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..components import parts
from ..geometry import Array, Sim3, se3_inverse, umeyama
from ..pose_graph.graph import NodeId, Prior
from .linear import isotropic_weights
from .similarity_edges import SimilarityEdges, descend
from .trust_region import newton

_NO_SCALE = 1e-12
"""Precision of a prior's log scale: it measures none."""
_ROTATES = 1e-3
"""A prior with this share of its position's weight on rotation, for a metre, places a part by itself."""
_ENOUGH = 3
"""Positions that place a part."""
_ROUNDS, _NARROWER, _LAST_ROUNDS = 24, 2.0, 3
_ALIGNMENTS = 30


@dataclass(frozen=True, eq=False)
class OriginPriors:
    """m priors: their ``nodes``; ``measured`` ``(m, 4, 4)`` in the origin's frame; ``kappa`` and ``tau`` ``(m,)`` as an
    edge's; ``lever`` ``(m, 3)``: the point that was measured, in its node's frame and unit; ``bound`` ``(m,)``:
    standard deviations from which the kernel counts a residual less, infinite where it is quadratic."""

    nodes: tuple[NodeId, ...]
    measured: Array
    kappa: Array
    tau: Array
    lever: Array
    bound: Array

    @classmethod
    def of(cls, priors: Sequence[Prior], dimension: int) -> OriginPriors:
        """Those of a graph, their own weight multiplied in."""
        kappa, tau = isotropic_weights(np.array([p.information for p in priors]).reshape(-1, 6, 6), dimension)
        weight = np.array([p.weight for p in priors])
        return cls(
            tuple(p.node for p in priors),
            np.array([p.T_O_i for p in priors]).reshape(-1, 4, 4),
            kappa * weight,
            tau * weight,
            np.array([p.lever for p in priors]).reshape(-1, 3),
            np.array([np.inf if p.bound is None else p.bound for p in priors]),
        )

    def __len__(self) -> int:
        return len(self.nodes)

    def only(self, used: NDArray[np.bool_]) -> OriginPriors:
        """Those ``used`` ``(m,)``."""
        nodes = tuple(n for n, u in zip(self.nodes, used, strict=True) if u)
        rest = (self.measured[used], self.kappa[used], self.tau[used], self.lever[used], self.bound[used])
        return OriginPriors(nodes, *rest)

    def and_also(self, other: OriginPriors) -> OriginPriors:
        """These, then the other's."""
        mine = (self.measured, self.kappa, self.tau, self.lever, self.bound)
        more = (other.measured, other.kappa, other.tau, other.lever, other.bound)
        joined = [np.concatenate(pair) for pair in zip(mine, more, strict=True)]
        return OriginPriors(self.nodes + other.nodes, *joined)

    def weighted(self, weight: Array) -> OriginPriors:
        """With both weights multiplied by ``weight`` ``(m,)``."""
        return replace(self, kappa=self.kappa * weight, tau=self.tau * weight)

    @property
    def turning(self) -> NDArray[np.bool_]:
        """Those ``(m,)`` that tell a rotation, and so place a part by themselves."""
        return np.asarray(self.kappa > _ROTATES * self.tau)

    def points(self, poses: Array, log_units: Array) -> Array:
        """Where the measured points are in the group's frame, ``(m, 3)``, with their nodes at ``poses`` ``(m, 4, 4)``
        and ``log_units`` ``(m,)``."""
        turned = np.einsum("mij,mj->mi", poses[:, :3, :3], self.lever)
        return np.asarray(poses[:, :3, 3] + np.exp(log_units)[:, None] * turned)

    def residuals(self, poses: Array, log_units: Array, origin: Sim3) -> Array:
        """In standard deviations, ``(m,)``, with the ``origin`` of their frame at that place in the group's."""
        seen = (self.points(poses, log_units) - origin.translation) @ origin.rotation / origin.scale
        square = self.tau * ((seen - self.measured[:, :3, 3]) ** 2).sum(axis=1)
        turn = poses[:, :3, :3] - origin.rotation @ self.measured[:, :3, :3]
        return np.asarray(np.sqrt(square + self.kappa * (turn**2).sum(axis=(1, 2))))

    def cost(self, residual: Array) -> float:
        """Their share of F with these residuals ``(m,)``, each bounded by its kernel."""
        finite = np.isfinite(self.bound)
        bound = np.where(finite, self.bound, 1.0)
        return float(np.where(finite, bound**2 * np.log1p((residual / bound) ** 2), residual**2).sum())


NO_PRIORS = OriginPriors((), np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0), np.zeros((0, 3)), np.zeros(0))


@dataclass(frozen=True, eq=False)
class WithOrigin:
    """``poses`` ``(n, 4, 4)`` and ``log_units`` ``(n,)`` of the nodes, the ``origin``'s place among them, the steps
    taken, and which nodes ``(n,)`` have their place from the anchor, be it by the origin."""

    poses: Array
    log_units: Array
    origin: Sim3
    steps: int
    joined: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _PriorsProblem:
    """``rows`` ``(m,)`` of the priors' nodes; ``anchored``: the node that stays; ``free_unit``: whether the origin's
    unit of length is a variable, as all others' are their own."""

    edges: SimilarityEdges
    priors: OriginPriors
    rows: NDArray[np.intp]
    fixed: NDArray[np.bool_]
    free_unit: bool

    def points(self, poses: Array, log_units: Array) -> Array:
        """Where the measured points are in the group's frame, ``(m, 3)``."""
        return self.priors.points(poses[self.rows], log_units[self.rows])

    def residuals(self, poses: Array, log_units: Array, origin: Sim3) -> Array:
        """In standard deviations, ``(m,)``."""
        return self.priors.residuals(poses[self.rows], log_units[self.rows], origin)

    def cost(self, poses: Array, log_units: Array, origin: Sim3) -> float:
        """The priors' share of F, each bounded by its kernel."""
        return self.priors.cost(self.residuals(poses, log_units, origin))

    def as_edges(self, poses: Array, log_units: Array, origin: Sim3, weight: Array) -> SimilarityEdges:
        """Edges from the origin, row n, with the levers turned as the nodes stand now."""
        p, m = self.priors, len(self.rows)
        shift = np.einsum("mij,mj->mi", poses[self.rows, :3, :3], p.lever) * np.exp(log_units[self.rows])[:, None]
        measured = p.measured.copy()
        measured[:, :3, 3] -= shift @ origin.rotation / origin.scale
        ends = np.column_stack([np.full(m, len(poses)), self.rows]).astype(np.intp)
        return SimilarityEdges(ends, measured, np.zeros(m), p.kappa, p.tau, np.full(m, _NO_SCALE)).weighted(weight)


def with_origin(
    edges: SimilarityEdges,
    poses: Array,
    log_units: Array,
    anchored: int,
    fixed: NDArray[np.bool_],
    priors: OriginPriors,
    row: Mapping[NodeId, int],
) -> WithOrigin | None:
    """F's optimum with the priors, from poses that are F's optimum without; None where the anchor's part cannot be
    placed in their frame (fewer than three positions).

    ``fixed`` ``(n,)``: nodes whose unit stays; ``anchored``: the row that stays where it is. Parts that only priors
    join to the anchor's are placed by them.
    """
    label = parts(edges.ends, len(poses))
    rows = np.array([row[n] for n in priors.nodes], dtype=np.intp)
    usable = {int(k) for k in np.unique(label[rows]) if _places(priors, label[rows] == k)}
    if int(label[anchored]) not in usable:
        return None
    used = np.isin(label[rows], sorted(usable))
    whole = _PriorsProblem(edges, priors.only(used), rows[used], fixed, bool(not fixed[anchored] and not fixed.any()))
    poses, log_units = poses.copy(), log_units.copy()
    origin = _aligned(_part(whole, label, int(label[anchored])), poses, log_units)
    for k in sorted(usable - {int(label[anchored])}):
        there = _aligned(_part(whole, label, k), poses, log_units)
        step = origin @ there.inverse()
        mine = label == k
        poses[mine] = step.transform_poses(poses[mine])
        log_units[mine] += np.log(step.scale)
    return _descended(whole, poses, log_units, origin, anchored, label, usable)


def origin_of(
    priors: OriginPriors, row: Mapping[NodeId, int], poses: Array, log_units: Array, free_unit: bool
) -> tuple[Sim3, float]:
    """The origin's best place for these poses, and the priors' share of F there."""
    rows = np.array([row[n] for n in priors.nodes], dtype=np.intp)
    empty = np.zeros(0)
    none = SimilarityEdges(np.zeros((0, 2), np.intp), np.zeros((0, 4, 4)), empty, empty, empty, empty)
    problem = _PriorsProblem(none, priors, rows, np.full(len(poses), not free_unit), free_unit)
    origin = _aligned(problem, poses, log_units)
    held, n = list(range(len(poses))), len(poses)
    best, cost = origin, problem.cost(poses, log_units, origin)
    for _ in range(_LAST_ROUNDS + 2):
        every, units = _stacked(poses, log_units, best)
        weight = kernel(problem.residuals(poses, log_units, best), priors.bound)
        fixed = np.append(problem.fixed, not free_unit)
        step = descend(problem.as_edges(poses, log_units, best, weight), every, units, held, fixed)
        moved = _origin_in(step.poses[n], step.log_units[n])
        after = problem.cost(poses, log_units, moved)
        if after >= cost:
            break
        best, cost = moved, after
    return best, cost


def places_a_part(turning: int, priors: int) -> bool:
    """Whether so many ``priors``, ``turning`` of them, place a part as a whole."""
    return turning > 0 or priors >= _ENOUGH


def _places(priors: OriginPriors, mine: NDArray[np.bool_]) -> bool:
    return places_a_part(int((priors.turning & mine).sum()), int(mine.sum()))


def _part(problem: _PriorsProblem, label: NDArray[np.intp], k: int) -> _PriorsProblem:
    mine = label[problem.rows] == k
    return replace(problem, priors=problem.priors.only(mine), rows=problem.rows[mine])


def _aligned(problem: _PriorsProblem, poses: Array, log_units: Array) -> Sim3:
    """The origin's place by what one prior alone says, or by all positions together without those that are off."""
    p, points = problem.priors, problem.points(poses, log_units)
    wanted = p.measured[:, :3, 3]
    weight = np.ones(len(points))
    best: list[Sim3] = []
    for _ in range(_ALIGNMENTS):
        kept = weight >= 0.5
        kept = kept if kept.sum() >= min(_ENOUGH, len(points)) else np.ones(len(points), dtype=bool)
        origin = umeyama(points[kept], wanted[kept], with_scale=problem.free_unit)
        off = np.linalg.norm(points - origin.translation - origin.scale * wanted @ origin.rotation.T, axis=1)
        again = (off <= 3.0 * max(float(np.median(off)), 1e-9)).astype(float)
        if (again == weight).all():
            break
        weight = again
    best.append(origin)
    turning = np.flatnonzero(p.turning)
    for k in turning[:: max(1, len(turning) // 8)]:
        best.append(Sim3.from_se3(poses[problem.rows[k]] @ se3_inverse(p.measured[k])))
    return min(best, key=lambda one: problem.cost(poses, log_units, one))


def _descended(
    problem: _PriorsProblem,
    poses: Array,
    log_units: Array,
    origin: Sim3,
    anchored: int,
    label: NDArray[np.intp],
    usable: set[int],
) -> WithOrigin:
    """From the alignment to the optimum; the kernel begins as wide as the residuals are."""
    n, p = len(poses), problem.priors
    joined = np.isin(label, sorted(usable))
    others = [int(np.flatnonzero(label == k)[0]) for k in np.unique(label) if int(k) not in usable]
    held = sorted({anchored, *others})
    kept = np.append(problem.fixed, not problem.free_unit)
    kept[held] = True
    bounded = np.isfinite(p.bound)
    start = problem.residuals(poses, log_units, origin)
    widen = max(1.0, float((start[bounded] / p.bound[bounded]).max())) if bounded.any() else 1.0
    steps = 0
    for number in range(_ROUNDS):
        last = widen <= 1.0
        weight = kernel(problem.residuals(poses, log_units, origin), p.bound * widen)
        edges = problem.edges.and_also(problem.as_edges(poses, log_units, origin, weight))
        every, units = _stacked(poses, log_units, origin)
        if kept.all():
            refined = newton(edges.ends, edges.measured, (edges.kappa, edges.tau), every, held)
            every, taken = refined.poses, refined.steps
        else:
            found = descend(edges, every, units, held, kept, 20)
            every, units, taken = found.poses, found.log_units, found.steps
        steps += taken
        moved = float(np.abs(every[:n, :3, 3] - poses[:, :3, 3]).max())
        poses, log_units, origin = every[:n], units[:n], _origin_in(every[n], units[n])
        sigma = 1.0 / np.sqrt(max(float(p.tau.max()), 1e-12))
        if last and moved < 1e-3 * sigma:
            break
        widen = max(1.0, widen / _NARROWER)
        if number >= _ROUNDS - _LAST_ROUNDS:
            widen = 1.0
    return WithOrigin(poses, log_units, origin, steps, joined)


def _stacked(poses: Array, log_units: Array, origin: Sim3) -> tuple[Array, Array]:
    """The origin as the last row."""
    return np.concatenate([poses, origin.se3()[None]]), np.append(log_units, np.log(origin.scale))


def _origin_in(pose: Array, log_unit: float) -> Sim3:
    return Sim3(pose[:3, :3], pose[:3, 3], float(np.exp(log_unit)))


def kernel(residual: Array, bound: Array) -> Array:
    """Weights ``(m,)`` of Cauchy's kernel; 1 where there is no bound."""
    return np.where(np.isfinite(bound), 1.0 / (1.0 + (residual / np.where(np.isfinite(bound), bound, 1.0)) ** 2), 1.0)
