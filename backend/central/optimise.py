"""Central optimisation of a whole graph: chordal start, Levenberg-Marquardt, and Newton's method to the last digit."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from maslam._replaced import replaced

from ..components import parts
from ..config import CentralConfig
from ..errors import BackendError
from ..geometry import Array, se3_inverse, umeyama
from ..pose_graph.edge_arrays import EdgeArrays
from ..pose_graph.graph import PoseGraph, Prior
from .chordal import two_stage_poses
from .costs import cost, frobenius_weights
from .gtsam_adapter import levenberg_marquardt
from .odometry import corrected, odometry_corrections
from .origin import OriginPriors, origin_of, with_origin
from .similarity_edges import edges_of
from .trust_region import anchors, named_parts, newton

log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class OptimisationResult:
    """The optimised graph; costs in the convention that was asked for; ``iterations`` of the non-linear solver.

    Where nothing better was found, ``graph`` is the one that came in and ``improved`` is False. ``lengths``: what
    odometry of these robots was found to have to be multiplied by, ``turns`` ``(3,)``: by how much more it is to turn,
    rad/m (costs are with both); none where they were not asked for or are right.
    """

    graph: PoseGraph
    cost_before: float
    cost_after: float
    iterations: int
    improved: bool
    lengths: Mapping[int, float] = field(default_factory=dict)
    turns: Mapping[int, Array] = field(default_factory=dict)


def optimise(graph: PoseGraph, config: CentralConfig) -> OptimisationResult:
    """Optimise all poses of ``graph``; the cost never ends higher than it began.

    Fixed nodes keep their poses; in each connected part without any the first one does, unless priors determine the
    part's place.
    """
    if config.heading_sigma_deg > 0 and config.length_sigma <= 0:
        raise BackendError("headings as unknowns (heading_sigma_deg) are found beside lengths: set length_sigma too")
    if config.length_sigma > 0:
        return _with_corrections(graph, config)
    if any(p.bound is not None or p.lever.any() for p in graph.priors):
        return _with_positions(graph, config)
    before = cost(graph, config.cost)
    if not graph.edges and not graph.priors:
        return OptimisationResult(graph, before, before, 0, False)
    start = two_stage(graph, config.cost == "U") if config.start == "chordal" else graph
    solved, iterations = _descend(start, config)
    if config.start == "chordal" and cost(solved, config.cost) > before:
        solved, iterations = _descend(graph, config)
    after = cost(solved, config.cost)
    log.debug("cost %s %.9g to %.9g in %d iterations", config.cost, before, after, iterations)
    if after > before:
        return OptimisationResult(graph, before, before, iterations, False)
    return OptimisationResult(solved, before, after, iterations, True)


def _with_corrections(graph: PoseGraph, config: CentralConfig) -> OptimisationResult:
    """With the lengths and headings of odometry among the unknowns: found by F (U), then taken as known. Priors tell
    more of these than loops do: where there are any, they stay."""
    known = replaced(config, length_sigma=0.0, heading_sigma_deg=0.0)
    plain = optimise(graph, known)
    if graph.priors or not graph.edges:
        return plain
    unit, turning = config.cost == "U", float(np.radians(config.heading_sigma_deg))
    found = odometry_corrections(polished(plain.graph, unit)[0], config.length_sigma, turning, unit)
    if not found.factors and not found.rates:
        return plain
    better = corrected(graph, found.factors, found.rates)
    solved, iterations = _descend(better.with_poses(found.poses), known)
    before, after = cost(better, config.cost), cost(solved, config.cost)
    result = graph.with_poses(solved.poses)
    return OptimisationResult(result, before, after, plain.iterations + iterations, True, found.factors, found.rates)


def _with_positions(graph: PoseGraph, config: CentralConfig) -> OptimisationResult:
    """F with priors on points beside their nodes, or with a kernel: solved without them, then laid on them and bent.
    ``BackendError`` for the other costs, which know neither."""
    if config.cost != "F" or config.loss != "none":
        raise BackendError("priors with a lever or a bound (GPS) are used with cost F without a loss only")
    if graph.fixed:
        raise BackendError("priors with a lever or a bound (GPS) do not go with fixed nodes")
    free = two_stage(replace(graph, priors=()))
    free, _, _ = polished(free, steps=config.iterations)
    a = replace(graph, priors=()).arrays()
    row = {n: k for k, n in enumerate(a.nodes)}
    priors = OriginPriors.of(graph.priors, graph.dimension)
    edges, units = edges_of(graph.edges, a.ends, graph.dimension), np.zeros(len(a.nodes))
    fixed = np.ones(len(a.nodes), dtype=bool)
    start = np.array([graph.poses[n] for n in a.nodes])
    before = float(edges.costs(start, units).sum()) + origin_of(priors, row, start, units, False)[1]
    poses = np.array([free.poses[n] for n in a.nodes])
    label = parts(edges.ends, len(poses))
    counts = np.bincount(label[[row[n] for n in priors.nodes]], minlength=int(label.max()) + 1)
    held = int(counts.argmax())
    found = with_origin(edges, poses, units, int(np.flatnonzero(label == held)[0]), fixed, priors, row)
    if found is None:
        raise BackendError(f"{len(priors)} positions: three at least place a graph in their frame")
    after = float(edges.costs(found.poses, units).sum()) + origin_of(priors, row, found.poses, units, False)[1]
    moved = np.where(found.joined[:, None, None], found.origin.inverse().transform_poses(found.poses), found.poses)
    if after > before:
        return OptimisationResult(graph, before, before, found.steps, False)
    return OptimisationResult(graph.with_poses(a.named(moved)), before, after, found.steps, True)


def _descend(graph: PoseGraph, config: CentralConfig) -> tuple[PoseGraph, int]:
    """To the optimum of the basin the graph lies in."""
    if config.cost == "E" or config.loss != "none":
        return levenberg_marquardt(graph, config)
    refined, steps, converged = polished(graph, config.cost == "U", config.iterations)
    if converged:
        return refined, steps
    solved, iterations = levenberg_marquardt(refined, config)
    return solved, steps + iterations


def polished(graph: PoseGraph, unit_weights: bool = False, steps: int = 100) -> tuple[PoseGraph, int, bool]:
    """Run Newton steps of F (U with ``unit_weights``) to convergence; returns the graph, the number of steps, and
    whether only rounding is left."""
    a = graph.arrays()
    weights = frobenius_weights(a, "U" if unit_weights else "F", graph.dimension)
    refined = newton(a.ends, a.measured, weights, a.poses, anchors(a), steps)
    return graph.with_poses(a.named(refined.poses)), refined.steps, refined.converged


def two_stage(graph: PoseGraph, unit_weights: bool = False, newton_steps: int = 1) -> PoseGraph:
    """Solve by chordal rotations, then Gauss-Newton steps of F (U with ``unit_weights``), without an initial guess
    (Carlone et al., ICRA 2015).

    One step is the solution that distributed Gauss-Seidel converges to. Priors place each connected part as a whole.
    """
    free = replace(graph, priors=())
    a = free.arrays()
    weights = frobenius_weights(a, "U" if unit_weights else "F", graph.dimension)
    poses = two_stage_poses(a.ends, a.measured, weights, a.poses, newton_steps, anchors(a))
    if graph.priors:
        poses = _placed(a, poses, graph)
    return graph.with_poses(a.named(poses))


def _placed(a: EdgeArrays, poses: Array, graph: PoseGraph) -> Array:
    """Each connected part without fixed nodes moved rigidly to where its priors want it: the best of what one prior
    alone or all their positions together say.
    """
    row, part, poses = {n: k for k, n in enumerate(a.nodes)}, named_parts(a), poses.copy()
    held = {int(part[k]) for k in a.fixed}
    for label in sorted({int(part[row[p.node]]) for p in graph.priors} - held):
        priors = [p for p in graph.priors if part[row[p.node]] == label]
        estimates = poses[[row[p.node] for p in priors]]
        wanted = np.array([p.T_O_i for p in priors])
        step = max(1, len(priors) // 8)
        moves = [*(wanted @ se3_inverse(estimates))[::step]]
        moves.append(umeyama(wanted[:, :3, 3], estimates[:, :3, 3], with_scale=False).se3())
        best = min(moves, key=lambda T: _prior_cost(priors, T @ estimates, graph.dimension))
        poses[part == label] = best @ poses[part == label]
    return poses


def _prior_cost(priors: list[Prior], estimates: Array, dimension: int) -> float:
    poses = {p.node: T for p, T in zip(priors, estimates, strict=True)}
    return cost(PoseGraph(poses, (), dimension, tuple(priors)), "F")
