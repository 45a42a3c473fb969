"""Entry point of robust optimisation: select edges, optimise with them, report the rejected ones with the reason."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from maslam._replaced import replaced

from ..central.costs import cost
from ..central.optimise import optimise
from ..config import CentralConfig, RobustConfig
from ..errors import BackendError
from ..geometry import Array
from ..pose_graph.graph import EdgeKind, NodeId, PoseGraph
from .gnc import Graduated, graduate, squared_residuals
from .pcm import Consistency, consistent_edges
from .prediction import predicted_distances
from .undecided import Undecided, undecided_edges
from .voting import voted_edges

RobustMethod = Literal["pcm", "gnc", "pcm+gnc"]
# Parts that are turned over to the rejected edges, at most, one after the other.
_TURNS = 5


@dataclass(frozen=True)
class RejectedEdge:
    """``index`` in the graph's edges; ``residual`` against the solution, in standard deviations, the noise factor
    taken into account.
    """

    index: int
    i: NodeId
    j: NodeId
    residual: float
    reason: str


@dataclass(frozen=True, eq=False)
class RobustResult:
    """``graph``: optimised, its edges carrying ``weights`` ``(m,)``, which may be given a later run to begin anew.

    ``cost_before`` and ``cost_after`` of the edges that are believed. ``noise``: factor by which standard deviations
    exceed the stated ones. ``exact``: PCM's sets are known to be the largest (True where PCM took no part).
    ``undecided``: where as many edges would hold if other ones were right.
    """

    graph: PoseGraph
    weights: Array
    rejected: tuple[RejectedEdge, ...]
    noise: float
    cost_before: float
    cost_after: float
    iterations: int
    exact: bool
    undecided: tuple[Undecided, ...] = ()


def optimise_robustly(
    graph: PoseGraph, method: RobustMethod, central: CentralConfig | None = None, config: RobustConfig | None = None
) -> RobustResult:
    """Optimise with the edges that robust selection accepts; odometry is always accepted.

    Weights that ``graph`` has already are not used: every edge can come back.
    """
    central, config = central or CentralConfig(), config or RobustConfig()
    if central.length_sigma > 0:
        raise BackendError(f"selection by {method} takes lengths as they are: leave out length_sigma, or the selection")
    whole = graph.with_weights(np.ones(len(graph.edges)))
    # The cycles also tell the noise, which GNC by itself finds less well: it sees residuals only of what it believes.
    cycles = consistent_edges(whole, config)
    found = cycles if "pcm" in method else None
    accepted = found.accepted if found else np.ones(len(graph.edges), dtype=bool)
    noise = cycles.noise
    if "gnc" in method:
        # Between two trajectories wrong edges that agree may outnumber the right ones: over all of them they do not.
        between, agree = voted_edges(whole, cycles.accepted, noise, config)
        accepted = np.where(between, agree, accepted)
    if found is not None:
        accepted = accepted & ~_contradicted(whole, found, central, config)
    start = optimise(whole.with_weights(accepted), central).graph
    weights, iterations = accepted.astype(np.float64), 1
    if "gnc" in method:
        graduated = _outvoted(graduate(start, accepted, noise, central, config), central, config)
        weights, noise, iterations = graduated.weights, graduated.noise, iterations + graduated.iterations
        start = graduated.graph
    believed = start.with_weights(weights)
    result = optimise(believed, replaced(central, start="given"))
    if central.start == "chordal":
        other = optimise(believed, central)
        result = other if other.cost_after < result.cost_after else result
    residuals = np.sqrt(squared_residuals(result.graph, central)) / noise.factor
    return RobustResult(
        graph=result.graph,
        weights=weights,
        rejected=_rejected(result.graph, weights, residuals, found, method),
        noise=noise.factor,
        cost_before=cost(replace(result.graph, poses=graph.poses), central.cost),
        cost_after=result.cost_after,
        iterations=iterations,
        exact=found is None or found.exact,
        undecided=undecided_edges(result.graph, config),
    )


def _outvoted(found: Graduated, central: CentralConfig, config: RobustConfig) -> Graduated:
    """Selected again with the rejected edges of a part in place of the kept ones where they are more, as long as that
    keeps more edges: pieces that have drifted far are placed by too few, and the vote knows no solution."""
    for _ in range(_TURNS):
        kept = found.weights > 0.5
        better = None
        for rival in undecided_edges(found.graph, config):
            if len(rival.rejected) > len(rival.kept) and better is None:
                candidates = kept.copy()
                candidates[list(rival.kept)], candidates[list(rival.rejected)] = False, True
                start = optimise(found.graph.with_weights(candidates), replaced(central, loss="none")).graph
                other = graduate(start, candidates, found.noise, central, config)
                better = other if (other.weights > 0.5).sum() > kept.sum() else None
        if better is None:
            break
        found = replace(better, iterations=found.iterations + better.iterations)
    return found


def _contradicted(
    graph: PoseGraph, found: Consistency, central: CentralConfig, config: RobustConfig
) -> NDArray[np.bool_]:
    """Mask ``(m,)`` of the edges that PCM could not test and that the others contradict."""
    lone = np.array([e.kind is not EdgeKind.ODOMETRY for e in graph.edges], dtype=bool) & (found.tested == 0)
    out = np.zeros(len(graph.edges), dtype=bool)
    rows = np.flatnonzero(lone)
    if len(rows):
        solution = optimise(graph.with_weights(found.accepted & ~lone), central).graph
        distances = predicted_distances(solution, rows, central)
        limit = found.noise.limit(1.0 - config.confidence)
        out[rows] = np.isfinite(distances) & (distances > limit)
    return out


def _rejected(
    graph: PoseGraph, weights: Array, residuals: Array, found: Consistency | None, method: RobustMethod
) -> tuple[RejectedEdge, ...]:
    out = []
    for k, (e, residual) in enumerate(zip(graph.edges, residuals.tolist(), strict=True)):
        if weights[k] > 0.5 or e.kind is EdgeKind.ODOMETRY:
            continue
        reason = f"residual {residual:.1f} standard deviations"
        if found is not None and not found.accepted[k]:
            agrees = f"agrees with {found.agreeing[k]} of {found.tested[k]} others"
            reason = agrees if method == "pcm" else f"{agrees}, {reason}"
        out.append(RejectedEdge(k, e.i, e.j, residual, reason))
    return tuple(out)
