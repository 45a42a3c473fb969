"""Pose graphs: read, optimise in one place or between robots, write."""

from __future__ import annotations

import logging
from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal, overload

from maslam._suggestions import hint
from maslam.backend.central import optimise as central
from maslam.backend.central.optimise import OptimisationResult
from maslam.backend.config import CentralConfig, RobustConfig
from maslam.backend.distributed import exchange
from maslam.backend.distributed.exchange import GroupResult
from maslam.backend.pose_graph import g2o
from maslam.backend.pose_graph.fixed import laid_on_fixed, not_held, not_held_text
from maslam.backend.pose_graph.graph import PoseGraph
from maslam.backend.robust.select import RobustMethod, RobustResult, optimise_robustly
from maslam.tools.common.errors import UnknownName
from maslam.tools.pgo.files import expand
from maslam.tools.pgo.methods import CENTRAL, METHODS, ROBUST, WEIGHTS, own_units, solver_of, takes_unit_weights

from .common import PathLike, Settings, changed, nested, on_one_thread

log = logging.getLogger(__name__)
Cost = Literal["auto", "F", "U", "E"]
Weights = Literal["auto", "information", "unit"]
Loss = Literal["none", "huber", "cauchy"]
Method = Literal["dgs", "jor", "sor", "quick", "rbcd", "rbcd-async", "multifrontal", "two-level", "elected"]


def read_g2o(paths: PathLike | Sequence[PathLike]) -> PoseGraph:
    """Read one graph from a g2o file, or from a set with one file a robot.

    Args:
        paths: a file, a folder of ``.g2o`` files, or several of both. Two- and three-dimensional graphs are read; ids
            may be plain numbers or gtsam symbols.

    Returns:
        Poses ``T_O_i`` ``(4, 4)`` by ``NodeId(robot, index)``, metres, and edges ``T_i_j`` with their information
        ``(6, 6)``, translation first.

    Raises:
        MaslamError: a file that is missing, or a line that makes no sense, by its number.
    """
    several = [paths] if isinstance(paths, str | Path) else list(paths)
    return g2o.read_g2o(expand([Path(path) for path in several]))


def write_g2o(path: PathLike, graph: PoseGraph, *, plain_ids: bool = False) -> None:
    """Write a graph as one g2o file, whole or not at all.

    Args:
        path: the file.
        graph: the graph.
        plain_ids: number nodes 0, 1, … instead of by gtsam symbols, which say the robot.

    Raises:
        MaslamError: plain ids for several robots.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    g2o.write_g2o(path, graph, plain_ids)


@overload
def optimise(
    graph: PoseGraph, *, cost: Cost = "auto", robust: Loss = "none", settings: Settings | None = None
) -> OptimisationResult: ...


@overload
def optimise(
    graph: PoseGraph, *, cost: Cost = "auto", robust: RobustMethod, settings: Settings | None = None
) -> RobustResult: ...


@on_one_thread
def optimise(
    graph: PoseGraph, *, cost: Cost = "auto", robust: Loss | RobustMethod = "none", settings: Settings | None = None
) -> OptimisationResult | RobustResult:
    """Optimise all poses in one place, as ``maslam pgo --method central`` does; the cost of the edges that are believed
    never ends higher than it began.

    Args:
        graph: the graph; fixed nodes keep their poses. In each connected part without any the first node stays where
            it is, unless priors say where it lies.
        cost: F: chordal, by the edges' information (SE-Sync's); U: the same with unit weights; E: geodesic (gtsam's);
            auto: U where every edge's information is the identity, else F.
        robust: what is done about wrong loops and edges between robots. ``pcm``: only the largest set that agrees
            with each other is used (pairwise consistency); ``gnc``: weights are found along with the solution
            (graduated non-convexity); ``pcm+gnc``: one after the other; ``huber``, ``cauchy``: all are used, under a
            robust loss; ``none``: all are believed.
        settings: of ``maslam.backend.config.CentralConfig``, ``{"iterations": 50}``; ``robust.…``: of
            ``RobustConfig``, which selection goes by, ``{"robust.confidence": 0.99}``.

    Returns:
        ``graph``, ``cost_before``, ``cost_after``, ``iterations``, ``improved``; where edges were selected (``pcm``,
        ``gnc``): ``weights`` ``(m,)`` of the edges, 0 to 1, and ``rejected``, with the reason, instead of ``improved``.

    Raises:
        MaslamError: an unknown setting, or no such ``robust``.
    """
    _check_known("robust", robust, ROBUST)
    if cost == "auto":
        cost = "U" if graph.is_unweighted else "F"
    given = nested(settings)
    selection = changed(RobustConfig(), given.pop("robust", {}))
    if robust == "none" or robust == "huber" or robust == "cauchy":
        return central.optimise(graph, changed(CentralConfig(cost=cost, loss=robust), given))
    return optimise_robustly(graph, robust, changed(CentralConfig(cost=cost), given), selection)


@on_one_thread
def optimise_distributed(
    graph: PoseGraph,
    *,
    method: Method = "elected",
    weights: Weights = "auto",
    settings: Settings | None = None,
    monocular: Collection[int] = (),
) -> GroupResult:
    """Optimise the graph of several robots, each of which knows only its own poses and edges, by message alone.

    Args:
        graph: nodes named by robot; ``graph.partitioned(n)`` cuts one robot's graph into ``n``. One fixed node of each
            connected part without priors keeps its pose; others do not, which is logged.
        method: ``dgs``, ``jor``, ``sor``: two-stage sweeps; ``quick``: fewest bytes, within 1 % on the published sets
            of 2 to 25 robots, far off on long loops; ``rbcd``: block-coordinate descent towards the optimum;
            ``rbcd-async``: the same without rounds; ``multifrontal``: exact elimination along an agreed order, to the
            optimum on any shape; ``two-level``: sweeps with a coarse level, within a thousandth of it in few bytes at
            any number of robots; ``elected``: one robot solves for all, to the optimum in the fewest bytes.
        weights: of the edges: ``information``: as the graph says (cost F); ``unit``: 1 (cost U); ``auto``: 1 where
            every edge's information is the identity.
        settings: of ``maslam.backend.config.SolverConfig``, ``{"descent_sweeps": 100}``.
        monocular: robots whose unit of length is their own and drifts: each of their nodes has a unit, found along with
            its pose (similarities); an edge's translation is in the unit of its first node, and its ``scale`` is the
            size of the second one's in it, up to ``scale_sigma``: of loops that were read from a file, unknown.
            ``elected`` and ``multifrontal`` reach the optimum; sweeps take many rounds to it.

    Returns:
        ``graph``, with its own information, in one unit throughout; ``units`` of the nodes in it; ``outcomes`` by
        robot; ``traffic``: messages, payload and wire bytes.

    Raises:
        MaslamError: an unknown method or setting, a graph that has no odometry, no such robot.
    """
    _check_known("method", method, [name for name in METHODS if name != CENTRAL])
    _check_known("weights", weights, WEIGHTS)
    unit = takes_unit_weights(weights, graph)
    config = changed(solver_of(method), nested(settings))
    weighted = graph.with_unit_weights() if unit else graph
    for line in not_held_text(graph, method):
        log.warning("%s", line)
    free = replace(weighted, fixed=frozenset())
    found = exchange.optimise_distributed(free, config, own_units(graph, monocular))
    poses = laid_on_fixed(graph, found.graph.poses) if graph.fixed else found.graph.poses
    kept = graph.fixed - frozenset(not_held(graph))
    return replace(found, graph=replace(graph.in_one_unit(poses, found.units), fixed=kept))


def _check_known(what: str, name: str, there: Sequence[str]) -> None:
    if name not in there:
        raise UnknownName(f"{what}: there is no {name!r}, only {', '.join(there)}{hint(name, there)}")
