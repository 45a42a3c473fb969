"""Lengths of odometry: one factor a robot, by which all its steps are too long or too short (a wrong baseline).

Steps that are all wrong by one share do not average out, as errors that differ from step to step do. So each robot has
a factor ``l`` near 1, with a deviation ``sigma`` before anything is known, and F of its steps becomes::

    kappa |R_j - R_i R_ij|_F^2 + tau |(t_j - t_i) / u_i - l R_i t_ij|^2,   and (l - 1)^2 / sigma^2 once a robot

Given the poses the best factors have a closed form (``factors`` below). Given the factors the poses are those of
stretched measurements, which any solver finds. Newton's method on the factors alone joins the two: its gradient is that
of F at the solved poses, its matrix the Schur complement, a row and a column a robot.

Loops tell how the robots' lengths stand to each other. What is common to all only the matches' own lengths could tell:
of maps made with the same odometry, and of errors that neighbouring matches share. Found from them it is another one
with each match more, and so is the size of the map. So the factors' mean stays 1: they are ``1 + B z``, the columns of
``B`` adding up to nothing. The prior alone asks for the same. One robot alone has none.

Factors that nothing calls for do harm: those of exact odometries are found up to the noise of a few matches, and
stretch maps that were right. So they are used only where the evidence (the marginal likelihood of ``z`` over that of
none, Laplace's approximation) is clear, with the deviations of the steps as large as the residuals say that they are,
and loops and separators fit what they state themselves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from ..geometry import Array, product, skew
from .linear import BlockSystem, pose_blocks
from .similarity_edges import Descended, SimilarityEdges, descend
from .trust_region import newton

_CLEAR = 2.0
"""Logarithm of the odds for factors from which on they are used; 2: seven to one."""
# Errors of odometry over the ways between loops over those stated, at least: they are no steps that are wrong each by
# itself. A heading that drifts evenly bends tracks as wrong lengths do (2.0 over 50 steps where no length was wrong).
_WANDERING = 2.5
# Noise of loops and separators over what they state, beyond which they tell nothing of lengths.
_FITTING = 1.3
_ROUNDS = 6
# A factor's last change, as a share of its deviation before anything is known.
_SETTLED = 1e-3
# Columns solved at a time, and most edges beside the steps whose share of the freedom is computed.
_COLUMNS, _MOST_EDGES = 16, 60


@dataclass(frozen=True, eq=False)
class OdometrySteps:
    """Which edges are odometry whose length has a factor: ``robot`` ``(m,)``, the number of the factor, -1 where there
    is none; ``count`` factors of deviation ``sigma`` each."""

    robot: NDArray[np.intp]
    count: int
    sigma: float

    def factors(self, edges: SimilarityEdges, poses: Array, log_units: Array) -> Array:
        """The best ``(count,)`` for these poses: F is quadratic in them. Poses that are not known are NaN."""
        used = (self.robot >= 0) & np.isfinite(poses[edges.ends]).all(axis=(1, 2, 3))
        e, prior = edges.only(used), self.sigma**-2.0
        turned, seen = _turned(e, poses), _seen(e, poses, log_units)
        known = self.sums(used, e.tau * (turned * seen).sum(axis=1))
        return np.asarray((known + prior) / (self.sums(used, e.tau * (turned**2).sum(axis=1)) + prior))

    def stretched(self, edges: SimilarityEdges, factors: Array) -> SimilarityEdges:
        """The edges with each step multiplied by its robot's factor."""
        measured = edges.measured.copy()
        used = self.robot >= 0
        measured[used, :3, 3] *= factors[self.robot[used]][:, None]
        return replace(edges, measured=measured)

    def cost(self, edges: SimilarityEdges, poses: Array, log_units: Array) -> float:
        """F with the best factors for these poses, and what they cost themselves."""
        factors = self.factors(edges, poses, log_units)
        own = float((((factors - 1.0) / self.sigma) ** 2).sum())
        return float(self.stretched(edges, factors).costs(poses, log_units).sum()) + own

    def sums(self, used: NDArray[np.bool_], values: Array) -> Array:
        """Of ``values``, one for each edge ``used``, by robot ``(count,)``."""
        return np.bincount(self.robot[used], values, minlength=self.count).astype(np.float64)


def steps_of(ends: NDArray[np.intp], robot_of: NDArray[np.intp], count: int, sigma: float) -> OdometrySteps:
    """Of nodes in order, those of one robot one after the other: an edge from a node to the one beside it is a step.
    ``robot_of`` ``(n,)``: the number of each node's factor, -1 where it has none (as robots with units of their own).
    """
    i, j = ends.T
    step = (np.abs(i - j) == 1) & (robot_of[i] == robot_of[j])
    return OdometrySteps(np.where(step, robot_of[i], -1), count if sigma > 0 else 0, sigma if sigma > 0 else 1.0)


@dataclass(frozen=True, eq=False)
class Lengths:
    """``factors`` ``(count,)``, all 1 where they are not ``used``; ``doubt`` ``(count,)``: their deviations, what is
    common to all included; ``evidence``: logarithm of the odds for them; ``noise``: the steps' deviations over the
    stated ones as the residuals tell them, NaN where too little does, from ``freedom`` degrees."""

    used: bool
    factors: Array
    doubt: Array
    evidence: float
    noise: float
    freedom: float


def with_lengths(
    edges: SimilarityEdges,
    found: Descended,
    held: Sequence[int],
    kept: NDArray[np.bool_],
    steps: OdometrySteps,
    freedom: int,
) -> tuple[Descended, Lengths]:
    """Poses with the lengths of odometry among the unknowns; ``found`` as it is where these are not called for.

    ``found``: the minimum of F with the nodes ``held`` and the units ``kept`` ``(n,)``; ``freedom``: its degrees.
    """
    factors = np.ones(steps.count)
    if steps.count == 0:  # every unit of length is a robot's own
        return found, Lengths(False, factors, factors, 0.0, float("nan"), 0.0)
    at = _Linear(edges, found, held, kept, steps, factors)
    if freedom <= 0 or at.evidence(1.0) <= _CLEAR:
        return found, Lengths(False, factors, at.doubt(), at.evidence(1.0), float("nan"), 0.0)
    now = found
    for _ in range(_ROUNDS):
        change = at.change()
        factors = factors + change
        now = _again(steps.stretched(edges, factors), now, held, kept)
        at = _Linear(edges, now, held, kept, steps, factors)
        if np.abs(change).max() < _SETTLED * steps.sigma:
            break
    noise, steps_freedom, others = at.noise(freedom)
    evidence = at.evidence(max(_WANDERING, noise, others) ** 2)
    # Matches that do not fit each other, as a liar's, are no evidence of lengths.
    used = evidence > _CLEAR and others <= _FITTING
    doubt = at.doubt()
    if not used:
        return found, Lengths(False, np.ones(steps.count), doubt, evidence, noise, steps_freedom)
    return replace(now, steps=found.steps + now.steps), Lengths(True, factors, doubt, evidence, noise, steps_freedom)


def _again(edges: SimilarityEdges, found: Descended, held: Sequence[int], kept: NDArray[np.bool_]) -> Descended:
    """The minimum that the present poses lead to."""
    if kept.all():
        refined = newton(edges.ends, edges.measured, (edges.kappa, edges.tau), found.poses, held)
        return Descended(refined.poses, found.log_units, refined.steps)
    return descend(edges, found.poses, found.log_units, held, kept)


class _Linear:
    """F's second-order model in the factors, at poses that are best for them."""

    def __init__(
        self,
        edges: SimilarityEdges,
        found: Descended,
        held: Sequence[int],
        kept: NDArray[np.bool_],
        steps: OdometrySteps,
        factors: Array,
    ) -> None:
        self._steps, self._factors = steps, factors
        self._edges, self._found = steps.stretched(edges, factors), found
        n = len(found.poses)
        self._free = np.setdiff1d(np.arange(n), held)
        blocks = self._blocks(kept)
        self._hessian, self._width = blocks[0], blocks[0].shape[1] // 2
        self._system = BlockSystem(edges.ends, *blocks, self._free, np.ones(len(edges.ends), dtype=bool))
        used = steps.robot >= 0
        raw, own = edges.only(used), self._edges.only(used)
        i, j = raw.ends.T
        turned, seen = _turned(raw, found.poses), _seen(raw, found.poses, found.log_units)
        shrink = np.exp(-found.log_units[i])[:, None]
        residual = seen - _turned(own, found.poses)
        pull = raw.tau[:, None] * turned
        self._gradient = (factors - 1.0) / steps.sigma**2 - steps.sums(used, (pull * residual).sum(axis=1))
        curvature = steps.sums(used, (pull * turned).sum(axis=1))
        cross = np.zeros((n, 7))
        np.add.at(cross[:, :3], i, pull * shrink)
        np.add.at(cross[:, :3], j, -pull * shrink)
        lever = product(found.poses[i, :3, :3], skew(own.measured[:, :3, 3]))
        np.add.at(cross[:, 3:6], i, -np.einsum("mab,ma->mb", lever, pull))
        np.add.at(cross[:, 6], i, np.where(kept[i], 0.0, (pull * seen).sum(axis=1)))
        self._robot_of = np.full(n, -1)
        self._robot_of[raw.ends] = steps.robot[used][:, None]
        # Orthonormal columns that add up to nothing: factors move along these alone.
        self._apart = null_space(np.ones((1, steps.count)))
        self._data = self._between(np.diag(curvature) - self._explained(cross[:, : self._width]))
        self._matrix = self._data + np.eye(steps.count - 1) / steps.sigma**2

    def _blocks(self, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        e, poses = self._edges, self._found.poses
        if not kept.all():
            return e.blocks(poses, self._found.log_units, kept)
        i, j = e.ends.T
        R = poses[:, :3, :3]
        return pose_blocks(R[i], R[j], e.measured, e.kappa, e.tau)

    def _explained(self, cross: Array) -> Array:
        """What the poses' own moves take off the factors' curvature ``(count, count)``; a node is of one robot."""
        count, rows = self._steps.count, self._robot_of[self._free]
        mine, cross = rows >= 0, cross[self._free]
        out = np.zeros((count, count))
        for first in range(0, count, _COLUMNS):
            columns = np.arange(first, min(first + _COLUMNS, count))
            rhs = cross[:, :, None] * (rows[:, None] == columns)[:, None, :]
            moved = (cross[:, :, None] * self._system.solve_for(rhs)).sum(axis=1)
            np.add.at(out[:, columns[0] : columns[-1] + 1], rows[mine], moved[mine])
        return 0.5 * (out + out.T)

    def _between(self, matrix: Array) -> Array:
        """A matrix of the factors, for how they differ."""
        return np.asarray(self._apart.T @ matrix @ self._apart)

    def change(self) -> Array:
        """Newton's step of the factors ``(count,)``; their mean stays."""
        step = np.linalg.solve(self._matrix, self._apart.T @ self._gradient)
        return np.asarray(-self._apart @ step, dtype=np.float64)

    def doubt(self) -> Array:
        """Deviations of the factors ``(count,)``, with that of what is common to all."""
        between = self._apart @ np.linalg.inv(self._matrix) @ self._apart.T
        variance: Array = np.maximum(np.diag(between), 0.0) + self._steps.sigma**2 / self._steps.count
        return np.asarray(variance**0.5, dtype=np.float64)

    def evidence(self, noise: float) -> float:
        """Logarithm of the odds for factors of the stated deviation against none, with residuals of variance
        ``noise``."""
        prior = np.eye(self._steps.count - 1) / self._steps.sigma**2
        data = self._data / noise
        wanted = self._matrix @ (self._apart.T @ (self._factors - 1.0)) - self._apart.T @ self._gradient
        gain = wanted / noise @ np.linalg.solve(data + prior, wanted / noise)
        return float(0.5 * gain - 0.5 * np.linalg.slogdet(np.eye(len(prior)) + data * self._steps.sigma**2)[1])

    def noise(self, freedom: int) -> tuple[float, float, float]:
        """Deviations of the steps' residuals over the stated ones; the degrees of freedom that say so; and those of the
        other edges. Each edge has as much of the freedom as its measurement is not explained by."""
        costs = self._edges.costs(self._found.poses, self._found.log_units)
        steps = self._steps.robot >= 0
        others = np.flatnonzero(~steps)
        theirs = self._freedom_of(others)
        ours = freedom - theirs
        noise = float(np.sqrt(costs[steps].sum() / ours)) if ours >= 1.0 else float("nan")
        return noise, ours, float(np.sqrt(costs[others].sum() / theirs)) if theirs >= 1.0 else 1.0

    def _freedom_of(self, edges: NDArray[np.intp]) -> float:
        """How much of the degrees of freedom lies in these edges; of many a part stands for all."""
        asked = edges[:: -(-len(edges) // _MOST_EDGES)] if len(edges) else edges
        explained = 0.0
        row = np.full(len(self._found.poses), -1)
        row[self._free] = np.arange(len(self._free))
        rank, w = self._width, self._width
        for k in asked:
            values, vectors = np.linalg.eigh(self._hessian[k])
            root = vectors[:, -rank:] * np.sqrt(np.maximum(values[-rank:], 0.0))
            rhs = np.zeros((len(self._free), w, rank))
            for side, node in enumerate(self._edges.ends[k]):
                if row[node] >= 0:
                    rhs[row[node]] += root[side * w : (side + 1) * w]
            explained += float((rhs * self._system.solve_for(rhs)).sum())
        return (rank * len(asked) - explained) * len(edges) / max(len(asked), 1)


def _turned(edges: SimilarityEdges, poses: Array) -> Array:
    """``R_i t_ij`` ``(m, 3)``."""
    return product(poses[edges.ends[:, 0], :3, :3], edges.measured[:, :3, 3, None])[..., 0]


def _seen(edges: SimilarityEdges, poses: Array, log_units: Array) -> Array:
    """``(t_j - t_i) / u_i`` ``(m, 3)``."""
    i, j = edges.ends.T
    return np.asarray((poses[j, :3, 3] - poses[i, :3, 3]) * np.exp(-log_units[i])[:, None])
