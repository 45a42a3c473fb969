"""Central optimisation over similarities: every node has a scale of its own, so drift of the scale is a variable.

A monocular track's unit of length drifts. Node i is ``S_O_i`` = (rotation, translation, scale s_i, the size of its
unit in the origin's); an edge measures the rigid ``T_i_j``, its translation in i's unit, and ``scale``, the size of
j's unit in i's. Residuals of an edge, in standard deviations:

- shift: ``R_ij^T (R_i^T (t_j - t_i) / s_i - t_ij)`` and turn ``log(R_ij^T R_i^T R_j)``, under the edge's information;
- scale: ``log(s_j / (s_i scale))``, under the settings' deviations.

To first order these are the logarithm of Sim(3) (Strasdat et al., RSS 2010). The cost is half the sum of squares.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..config import SimilarityConfig
from ..geometry import Array, Sim3, project_to_so3, se3, skew, so3_exp, so3_log, umeyama
from ..pose_graph.graph import NodeId, PoseGraph
from .linear import BlockSystem, isotropic_weights, positive_information
from .similarity_edges import SimilarityEdges, linear_start, scale_precisions
from .trust_region import anchors, named_parts

_HALVINGS = 12
# How much stiffer than the stiffest edge what is fixed is held.
_FIRM = 1e6


@dataclass(frozen=True, eq=False)
class SimilarityResult:
    """``poses`` ``S_O_i`` by node, in the unit of the anchors (1 for metric robots); costs as the module states them.

    ``graph``: the rigid parts, in that unit throughout: translations of edges multiplied by their node's scale, and the
    edges' ``scale`` what is left of it (1 where it agrees).
    """

    graph: PoseGraph
    poses: Mapping[NodeId, Sim3]
    cost_before: float
    cost_after: float
    iterations: int


def optimise_similarity(
    graph: PoseGraph,
    config: SimilarityConfig,
    metric: frozenset[int] = frozenset(),
    start: Mapping[NodeId, Sim3] | None = None,
) -> SimilarityResult:
    """Optimise poses and scales. ``metric``: robots whose unit is the metre; without any, the first node of each
    connected part has scale 1, and stays. ``start``: poses to begin at (and ``cost_before`` of); without one they come
    from linear problems: chordal rotations, then log scales, then translations.
    """
    problem = _Problem(graph, config, metric)
    known = start or {n: Sim3.from_se3(graph.poses[n]) for n in graph.nodes}
    given = problem.state([known[n] for n in graph.nodes])
    if start is not None:
        state = given
    elif graph.priors:
        placed = _placed(graph, config, metric)
        state = problem.state([placed[n] for n in graph.nodes])
    else:
        state = problem.linear_start(given)
    before, now = problem.cost(given), problem.cost(state)
    iterations = 0
    while iterations < config.iterations:
        iterations += 1
        after, cost = problem.improved(state, now)
        fallen, state, now = now - cost, after, cost
        if fallen <= config.tolerance * now:
            break
    if now > before:
        state, now = given, before
    return _result(graph, state, before, now, iterations)


def _placed(graph: PoseGraph, config: SimilarityConfig, metric: frozenset[int]) -> dict[NodeId, Sim3]:
    """Solved without the priors; then each connected part is moved, and stretched where it has no metric robot, to
    where its priors want it: by their positions where there are three, else by the first one's pose.
    """
    free = replace(graph, priors=())
    poses = dict(optimise_similarity(free, config, metric).poses)
    part = dict(zip(graph.nodes, named_parts(free.arrays()).tolist(), strict=True))
    for label in sorted({part[p.node] for p in graph.priors}):
        priors = [p for p in graph.priors if part[p.node] == label]
        nodes = [n for n in graph.nodes if part[n] == label]
        move = Sim3.from_se3(priors[0].T_O_i) @ replace(poses[priors[0].node], scale=1.0).inverse()
        if len(priors) >= 3:
            wanted = np.array([p.T_O_i[:3, 3] for p in priors])
            found = np.array([poses[p.node].translation for p in priors])
            move = umeyama(wanted, found, with_scale=not any(n.robot in metric for n in nodes))
        poses |= {n: move @ poses[n] for n in nodes}
    return poses


@dataclass(frozen=True, eq=False)
class _State:
    rotation: Array
    translation: Array
    log_scale: Array


class _Problem:
    """Edges (priors among them) as arrays, the residuals' first derivatives, and what stands fixed."""

    def __init__(self, graph: PoseGraph, config: SimilarityConfig, metric: frozenset[int]) -> None:
        a = graph.arrays()
        self.ends, self.measured = a.ends, a.measured
        self._count = len(a.poses)
        self._weights = isotropic_weights(a.information)
        scale = [e.scale for e in graph.edges] + [1.0] * len(graph.priors)
        self.log_scale = np.log(np.array(scale, dtype=np.float64))
        self.information = np.zeros((len(a.ends), 7, 7))
        self.information[:, :6, :6] = positive_information(a.information)
        # Priors say nothing of a node's unit.
        precision = np.concatenate([scale_precisions(graph.edges, config), np.zeros(len(graph.priors))])
        self.information[:, 6, 6] = a.weight * precision
        self._held, part = anchors(a), named_parts(a)
        is_metric = np.array([n.robot in metric for n in a.nodes] + [True] * (a.origin is not None), dtype=bool)
        self._fixed = np.zeros((self._count, 7), dtype=bool)
        self._fixed[self._held, :6] = True
        self._fixed[is_metric, 6] = True
        for k in self._held:
            # Of a part without a metric robot the anchor gives the unit.
            self._fixed[k, 6] |= not is_metric[part == part[k]].any()

    def state(self, poses: list[Sim3]) -> _State:
        """Of all rows; the origin's, if there are priors, is the identity."""
        rows = [*poses, *[Sim3.identity()] * (self._count - len(poses))]
        scales = np.array([s.scale for s in rows])
        return _State(np.array([s.rotation for s in rows]), np.array([s.translation for s in rows]), np.log(scales))

    def residuals(self, x: _State) -> Array:
        """``(m, 7)``: shift, turn, log scale."""
        i, j = self.ends.T
        R_ij_T = np.swapaxes(self.measured[:, :3, :3], 1, 2)
        R_i_T = np.swapaxes(x.rotation[i], 1, 2)
        out = np.empty((len(i), 7))
        seen = _apply(R_i_T, x.translation[j] - x.translation[i]) * np.exp(-x.log_scale[i])[:, None]
        out[:, :3] = _apply(R_ij_T, seen - self.measured[:, :3, 3])
        out[:, 3:6] = so3_log(R_ij_T @ R_i_T @ x.rotation[j])
        out[:, 6] = x.log_scale[j] - x.log_scale[i] - self.log_scale
        return out

    def cost(self, x: _State) -> float:
        r = self.residuals(x)
        return 0.5 * float(np.einsum("ma,mab,mb->", r, self.information, r))

    def improved(self, x: _State, now: float) -> tuple[_State, float]:
        """A Gauss-Newton step, halved until it lowers the cost; the same state where none does."""
        step = self._step(x)
        for halving in range(_HALVINGS):
            after = _moved(x, step * 0.5**halving)
            cost = self.cost(after)
            if cost < now:
                return after, cost
        return x, now

    def _step(self, x: _State) -> Array:
        """Gauss-Newton ``(n, 7)``. What is fixed is tied firmly to a row of its own that stands still."""
        J, r = self._jacobian(x), self.residuals(x)
        weighted = self.information @ J
        hessian, rhs = np.swapaxes(J, 1, 2) @ weighted, -(np.swapaxes(weighted, 1, 2) @ r[:, :, None])
        pinned = np.flatnonzero(self._fixed.any(axis=1))
        pins = np.zeros((len(pinned), 14, 14))
        firm = _FIRM * max(float(np.abs(hessian).max(initial=0.0)), 1.0)
        pins[:, range(7), range(7)] = np.where(self._fixed[pinned], firm, 0.0)
        ends = np.concatenate([self.ends, np.stack([pinned, np.full_like(pinned, self._count)], axis=1)])
        rhs = np.concatenate([rhs, np.zeros((len(pinned), 14, 1))])
        everything, used = np.arange(self._count), np.ones(len(ends), dtype=bool)
        system = BlockSystem(ends, np.concatenate([hessian, pins]), rhs, everything, used)
        step = system.solve(np.zeros((self._count + 1, 7, 1)))[:, :, 0]
        step[self._fixed] = 0.0
        return step

    def _jacobian(self, x: _State) -> Array:
        """``(m, 7, 14)``: by shift (common frame), turn (own frame) and log scale of i, then of j."""
        i, j = self.ends.T
        R_ij_T, R_i_T = np.swapaxes(self.measured[:, :3, :3], 1, 2), np.swapaxes(x.rotation[i], 1, 2)
        shrink = np.exp(-x.log_scale[i])[:, None, None]
        seen = _apply(R_i_T, x.translation[j] - x.translation[i]) * shrink[:, 0]
        out = np.zeros((len(i), 7, 14))
        out[:, :3, 7:10] = R_ij_T @ R_i_T * shrink
        out[:, :3, :3] = -out[:, :3, 7:10]
        out[:, :3, 3:6] = R_ij_T @ skew(seen)
        out[:, :3, 6] = -_apply(R_ij_T, seen)
        turn = so3_log(R_ij_T @ R_i_T @ x.rotation[j])
        out[:, 3:6, 10:13] = _inverse_right_jacobian(turn)
        out[:, 3:6, 3:6] = -out[:, 3:6, 10:13] @ np.swapaxes(x.rotation[j], 1, 2) @ x.rotation[i]
        out[:, 6, 6], out[:, 6, 13] = -1.0, 1.0
        return out

    def linear_start(self, given: _State) -> _State:
        """Chordal rotations; log scales from the edges' scales; translations with both held."""
        kappa, tau = self._weights
        edges = SimilarityEdges(self.ends, self.measured, self.log_scale, kappa, tau, self.information[:, 6, 6])
        poses, units = se3(given.rotation, given.translation), np.zeros(self._count)
        poses, log_scale = linear_start(edges, poses, units, self._held, self._fixed[:, 6])
        return _State(poses[:, :3, :3], poses[:, :3, 3], log_scale)


def _moved(x: _State, step: Array) -> _State:
    rotation = project_to_so3(x.rotation @ so3_exp(step[:, 3:6]))
    return _State(rotation, x.translation + step[:, :3], x.log_scale + step[:, 6])


def _apply(matrices: Array, vectors: Array) -> Array:
    return np.asarray(np.einsum("mab,mb->ma", matrices, vectors))


def _inverse_right_jacobian(phi: Array) -> Array:
    """Of SO(3) ``(m, 3, 3)``: the derivative of ``log(exp(phi) exp(d))`` by d."""
    angle2 = (phi**2).sum(axis=1)[:, None, None]
    small = angle2 < 1e-8
    safe = np.where(small, 1.0, angle2)
    half = 0.5 * np.sqrt(safe)
    factor = np.where(small, 1.0 / 12.0, (1.0 - half / np.tan(half)) / safe)
    k = skew(phi)
    return np.eye(3) + 0.5 * k + factor * (k @ k)


def _result(graph: PoseGraph, x: _State, before: float, after: float, iterations: int) -> SimilarityResult:
    scales = np.exp(x.log_scale)
    poses = {n: Sim3(x.rotation[k], x.translation[k], float(scales[k])) for k, n in enumerate(graph.nodes)}
    units = {n: S.scale for n, S in poses.items()}
    rigid = graph.in_one_unit({n: S.se3() for n, S in poses.items()}, units)
    return SimilarityResult(rigid, poses, before, after, iterations)
