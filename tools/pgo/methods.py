"""One method on one graph: central or by message, with or without robust selection, and what it took."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from maslam._replaced import replaced
from maslam.backend.central.minimum import minimum
from maslam.backend.central.optimise import optimise
from maslam.backend.central.similarity_edges import edges_of
from maslam.backend.components import parts
from maslam.backend.config import CentralConfig, LinkModel, RobustConfig, SolverConfig
from maslam.backend.distributed.exchange import optimise_distributed
from maslam.backend.distributed.incremental.one_by_one import matches_one_by_one
from maslam.backend.distributed.methods import check_priors
from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.geometry import Array
from maslam.backend.pose_graph.graph import NodeId, PoseGraph
from maslam.backend.pose_graph.node import robot_name, symbol_name
from maslam.backend.robust.noise import Noise
from maslam.backend.robust.pcm import bytes_of_cycles, consistent_edges
from maslam.backend.robust.select import optimise_robustly

from ..common.errors import UnknownName, UsageError
from .updates import figures

CENTRAL = "central"
TWO_STAGE = ("dgs", "jor", "sor")
TO_THE_OPTIMUM = ("rbcd", "rbcd-async", "multifrontal", "two-level", "elected")
METHODS = (CENTRAL, *TWO_STAGE, "quick", *TO_THE_OPTIMUM)
LOSSES = ("huber", "cauchy")
SELECTING = (CENTRAL, "rbcd", "elected")
"""Methods that know ``gnc``."""
SELECTIONS = ("pcm", "gnc", "pcm+gnc")
ROBUST = ("none", *LOSSES, *SELECTIONS)
WEIGHTS = ("auto", "information", "unit")


@dataclass(frozen=True)
class Request:
    """``unit``: minimise U instead of what ``central.cost`` or F says; ``monocular``: robots whose nodes have units of
    length of their own. ``link``: matches come one by one, over such links."""

    method: str
    robust: str
    unit: bool
    central: CentralConfig
    solver: SolverConfig
    selection: RobustConfig
    monocular: frozenset[int] = frozenset()
    link: LinkModel | None = None


@dataclass(frozen=True, eq=False)
class Solution:
    """``weights`` ``(m,)``: of the edges, 0 where rejected; ``rejected``: records of those; ``units``: of the nodes, in
    the common one, where they were variables; ``updates``: of matches one by one, what these cost; ``lengths``: what
    odometry of these robots is to be multiplied by; ``turns`` ``(3,)``: by how much more it is to turn, rad/m."""

    poses: Mapping[NodeId, Array]
    weights: Array
    rejected: list[dict[str, object]]
    minimised: str
    iterations: int
    rotation_sweeps: int | None = None
    pose_sweeps: int | None = None
    payload_bytes: int = 0
    wire_bytes: int = 0
    messages: int = 0
    unreached_poses: int = 0
    units: Mapping[NodeId, float] = field(default_factory=dict)
    lengths: Mapping[int, float] = field(default_factory=dict)
    turns: Mapping[int, Array] = field(default_factory=dict)
    refused: str | None = None
    cost_before: float | None = None
    capped: bool = False
    updates: dict[str, object] | None = None


def default_method(robust: str) -> str:
    """The one that reaches the optimum on any graph, in the fewest bytes, and what selects edges by itself."""
    return CENTRAL if robust in LOSSES else "elected"


def own_units(graph: PoseGraph, monocular: Collection[int]) -> frozenset[int]:
    """These robots, all of which the graph must have."""
    strangers = sorted(set(monocular) - set(graph.robots))
    if strangers:
        raise UnknownName(f"monocular: there is no robot {strangers[0]}, only {', '.join(map(str, graph.robots))}")
    return frozenset(monocular)


def solver_of(method: str) -> SolverConfig:
    """The solver's settings that the name of a method stands for, before any option changes them."""
    if method == CENTRAL:
        return SolverConfig()
    return SolverConfig.quick() if method == "quick" else SolverConfig.model_validate({"method": method})


def takes_unit_weights(weights: str, graph: PoseGraph) -> bool:
    """Whether cost U is minimised: ``weights`` is ``unit``, ``information``, or ``auto`` (by what the graph says)."""
    return weights == "unit" or (weights == "auto" and graph.is_unweighted)


def check(method: str, robust: str, monocular: bool = False, one_by_one: bool = False) -> None:
    """Refuse what does not go together."""
    if one_by_one and (method != "elected" or robust != "none"):
        instead = f"--robust {robust}" if robust != "none" else f"--method {method}"
        raise UsageError(f"--matches-one-by-one works with --method elected and no robust selection, not {instead}")
    if monocular and robust != "none":
        raise UsageError(f"--robust {robust} judges rigid graphs only; leave out --monocular, or --robust")
    if robust in LOSSES and method != CENTRAL:
        raise UsageError(f"--robust {robust} works with --method central, not {method}")
    if "gnc" in robust and method not in SELECTING:
        ways = f"{', '.join(SELECTING[:-1])} or {SELECTING[-1]}"
        raise UsageError(f"--robust {robust} works with --method {ways}, not {method}; pcm works with all")


def solve(graph: PoseGraph, request: Request, tick: Callable[[int, int], None] = lambda done, total: None) -> Solution:
    """Run the method; ``tick`` is called with what is done, and of how much, where matches come one by one."""
    check(request.method, request.robust, bool(request.monocular), request.link is not None)
    if graph.priors and request.method != CENTRAL:
        check_priors(request.method)
    for name, config in (("central", request.central), ("solver", request.solver)):
        if config.heading_sigma_deg > 0 and config.length_sigma <= 0:
            raise UsageError(f"--{name}.heading-sigma-deg is found beside lengths: give --{name}.length-sigma too")
    if request.central.length_sigma > 0 and (request.method != CENTRAL or request.monocular):
        raise UsageError(
            "--central.length-sigma works with --method central without --monocular; --solver.length-sigma with elected"
        )
    if request.solver.length_sigma > 0 and request.method != "elected":
        raise UsageError(f"--solver.length-sigma works with --method elected, not {request.method}")
    if request.solver.length_sigma > 0 and (request.robust != "none" or request.link is not None):
        other = "--matches-one-by-one" if request.link is not None else f"--robust {request.robust}"
        raise UsageError(f"--solver.length-sigma does not go with {other}, which takes lengths as they are")
    if request.monocular and request.method == CENTRAL:
        return _with_units(graph, request)
    if request.link is not None:
        if request.solver.elected_longest > 1:
            raise UsageError(
                f"--solver.elected-longest {request.solver.elected_longest} leaves out poses that later matches need; "
                "with --matches-one-by-one leave it at 1"
            )
        return solve_one_by_one(graph, request, request.link, tick)
    return (_central if request.method == CENTRAL else _distributed)(graph, request)


def caps_reached(request: Request, found: Solution) -> list[str]:
    """Whether the method ended because it was not allowed to go on, in a sentence."""
    solver = request.solver
    cap: tuple[int, str, str] | None = None
    if request.method == CENTRAL and request.robust not in SELECTIONS:
        if found.iterations >= request.central.iterations:
            cap = (request.central.iterations, "iterations", "--central.iterations")
    elif request.method in ("rbcd", "rbcd-async"):
        if found.capped:
            cap = (solver.descent_sweeps, "sweeps", "--solver.descent-sweeps")
    elif request.method in TWO_STAGE and (found.pose_sweeps or 0) >= solver.pose_sweeps * solver.newton_steps:
        cap = (solver.pose_sweeps, "sweeps of a step", "--solver.pose-sweeps")
    if found.capped and cap is None:
        return [
            "it stopped on the way, at the most passes allowed or where they lead nowhere: the cost may still fall; "
            "elected ends at the optimum"
        ]
    if cap is None:
        return []
    better = "" if request.method == CENTRAL else "; elected and multifrontal end at the optimum"
    return [f"the most {cap[1]} allowed were made, {cap[0]}: the cost may still fall ({cap[2]}){better}"]


def _central(graph: PoseGraph, request: Request) -> Solution:
    config = request.central
    if request.robust in SELECTIONS:
        found = optimise_robustly(graph, request.robust, config, request.selection)  # type: ignore[arg-type]
        rejected = [_record(graph, e.i, e.j, e.residual, e.reason) for e in found.rejected]
        return Solution(found.graph.poses, found.weights, rejected, config.cost, found.iterations)
    result = optimise(graph, config)
    weights = np.ones(len(graph.edges))
    return Solution(
        result.graph.poses, weights, [], config.cost, result.iterations, lengths=result.lengths, turns=result.turns
    )


def _with_units(graph: PoseGraph, request: Request) -> Solution:
    """F with the units of the nodes among its unknowns, in one place. Of each connected part a metric robot's first
    node stays, else the first."""
    working = graph.with_unit_weights() if request.unit else graph
    nodes = list(working.nodes)
    ends = working.arrays().ends[: len(working.edges)]
    edges = edges_of(working.edges, ends, working.dimension)
    poses = np.stack([working.poses[n] for n in nodes])
    metric = np.array([n.robot not in request.monocular for n in nodes])
    label = parts(ends, len(nodes))
    order = np.lexsort((np.arange(len(nodes)), ~metric, label))
    held = order[np.unique(label[order], return_index=True)[1]]
    fixed = metric.copy()
    fixed[held] = True
    found = minimum(edges, poses, np.zeros(len(nodes)), sorted(held.tolist()), fixed)
    return Solution(
        poses=dict(zip(nodes, found.poses, strict=True)),
        weights=np.ones(len(graph.edges)),
        rejected=[],
        minimised="U" if request.unit else "F",
        iterations=found.steps,
        units=dict(zip(nodes, np.exp(found.log_units).tolist(), strict=True)),
    )


def solve_one_by_one(graph: PoseGraph, request: Request, link: LinkModel, tick: Callable[[int, int], None]) -> Solution:
    """The elected method with matches that come one by one; bytes are those of the first solution and all updates."""
    working = graph.with_unit_weights() if request.unit else graph
    found = matches_one_by_one(working, request.solver, link, request.monocular, tick)
    every = (found.first, *found.updates)
    return Solution(
        poses={n: found.graph.poses[n] for n in graph.nodes},
        weights=np.ones(len(graph.edges)),
        rejected=[],
        minimised="U" if request.unit else "F",
        iterations=len(every),
        payload_bytes=sum(one.payload_bytes for one in every),
        wire_bytes=sum(one.bytes_sent for one in every),
        messages=sum(one.messages for one in every),
        units=found.units if request.monocular else {},
        updates=figures(found, link),
    )


def _distributed(graph: PoseGraph, request: Request) -> Solution:
    weights, rejected, of_cycles = np.ones(len(graph.edges)), [], 0
    config = request.solver
    if config.gnc_confidence == SolverConfig().gnc_confidence:
        # The quantile of central selection, unless another one was asked for.
        config = replaced(config, gnc_confidence=request.selection.confidence)
    by_elected = request.method == "elected" and "gnc" in request.robust
    if by_elected:
        # The elected robot has the whole graph, its cycles and its noise.
        if request.selection != RobustConfig(confidence=request.selection.confidence):
            raise UsageError("an elected robot selects by --robust.confidence alone; the others work with central")
        config = replaced(config, robust="gnc")
    elif request.robust != "none":
        # From odometry alone, which two robots tell each other once.
        consistent = consistent_edges(graph, request.selection)
        of_cycles = bytes_of_cycles(graph)
    if "gnc" in request.robust and not by_elected:
        # The bound on a right edge's residual that the cycles tell, as a factor over the stated one.
        beyond = 1.0 - config.gnc_confidence
        bound, stated = consistent.noise.limit(beyond), Noise.stated(graph.dimension).limit(beyond)
        noise = max((bound / stated) ** 0.5, config.gnc_noise)
        config = replaced(config, robust="gnc", gnc_noise=noise)
    if "pcm" in request.robust and not by_elected:
        believed = consistent.accepted
        if "gnc" in request.robust:
            # Between robots the vote of all decides: of two robots alone a wrong group may be the larger one.
            believed = believed | np.array([e.is_separator for e in graph.edges], dtype=bool)
        weights = believed.astype(np.float64)
        rejected = [
            _record(graph, e.i, e.j, None, f"agrees with {consistent.agreeing[k]} of {consistent.tested[k]} others")
            for k, e in enumerate(graph.edges)
            if not believed[k]
        ]
    kept = [k for k, weight in enumerate(weights) if weight > 0]
    working = replace(graph, edges=tuple(graph.edges[k] for k in kept))
    weighted = working.with_unit_weights() if request.unit else working
    result = optimise_distributed(weighted, config, request.monocular)
    for k, verdict in zip(kept, result.judged, strict=True):
        if verdict is not None and verdict.rejected:
            weights[k] = 0.0
            sigmas = f"residual {verdict.residual:.1f} standard deviations"
            rejected.append(_record(graph, verdict.i, verdict.j, verdict.residual, sigmas))
    outcomes, traffic = list(result.outcomes.values()), result.traffic
    return Solution(
        poses=result.graph.poses,
        weights=weights,
        rejected=rejected,
        minimised="U" if request.unit else "F",
        iterations=max(o.rotation_sweeps + o.pose_sweeps for o in outcomes),
        rotation_sweeps=max(o.rotation_sweeps for o in outcomes),
        pose_sweeps=max(o.pose_sweeps for o in outcomes),
        payload_bytes=traffic.payload_bytes + of_cycles,
        wire_bytes=traffic.wire_bytes + of_cycles,
        messages=traffic.messages,
        unreached_poses=sum(len(o.unreached) for o in outcomes),
        units=result.units if request.monocular else {},
        lengths=result.lengths,
        turns=result.turns,
        refused=_refused(result.outcomes),
        capped=any(o.capped for o in outcomes),
        cost_before=_largest([o.cost_before for o in outcomes]),
    )


def _largest(costs: list[float]) -> float | None:
    """None where robots did not begin, and know none."""
    known = [cost for cost in costs if np.isfinite(cost)]
    return max(known, default=None)


def _refused(outcomes: Mapping[int, SolverOutcome]) -> str | None:
    """Which robots kept their poses, and why; None where none did."""
    whose: dict[str, list[str]] = {}
    for robot, outcome in outcomes.items():
        if not outcome.accepted:
            whose.setdefault(outcome.reason, []).append(robot_name(robot))
    if len(whose) == 1 and sum(map(len, whose.values())) == len(outcomes):
        return next(iter(whose))
    parts = (f"robot{'s'[len(robots) == 1 :]} {', '.join(robots)}: {why}" for why, robots in whose.items())
    return "; ".join(parts) or None


def _record(graph: PoseGraph, i: NodeId, j: NodeId, residual: float | None, reason: str) -> dict[str, object]:
    """Nodes of one robot's symbols (x0, x1, …) are named by them."""
    name = symbol_name if graph.symbols and len(graph.robots) == 1 else str
    return {"i": name(i), "j": name(j), "residual": residual, "reason": reason}
