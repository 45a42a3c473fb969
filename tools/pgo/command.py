"""``maslam pgo``: optimise pose graphs from g2o files, centrally or by robots that exchange what they must."""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..common.errors import ToolError, UsageError
from ..common.options import DEST, add_model_options, leaves, option_name
from ..common.parser import at_least_one
from .report import PgoReport

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from maslam.backend.pose_graph.graph import NodeId, PoseGraph

    from .methods import Solution

_ROUNDING = 1e-4
_METHODS = """\
methods
  central      one computer: chordal start, then Newton's method (F, U) or Levenberg-Marquardt (E)
  dgs jor sor  two-stage distributed Gauss-Seidel, Jacobi, over-relaxed; what is minimised is 0.2 to 0.6 % off
  quick        sor with the schedule that ends within 1 % in the fewest bytes on the published sets of 2 to 25 robots;
               on long loops and large teams far above that
  rbcd         block-coordinate descent towards the optimum, in agreed rounds; rbcd-async: late, lost, repeated messages
  multifrontal exact elimination along an agreed order, to the optimum on any shape; no robot sees more than its own
               part and poses that are shared; bytes grow with the square of these, too many are refused
  two-level    sweeps with a coarse level: within a thousandth of the optimum, nobody solves for all; few bytes at any
               number of robots
  elected      one robot gathers the condensed graph, solves it, and sends poses back: the optimum in the fewest bytes
monocular
  one camera's unit of length drifts: each pose has one, found along with it (--monocular). A g2o line is rigid (SE3):
  its translation is in the unit of its first pose, and loops leave the units open. The result is rigid again, in one
  unit throughout: that of the other robots, or of the first pose; the units stand in OUT/units.csv
robust
  pcm          pairwise consistency: the largest set of loops and separators that agree with each other
  gnc          graduated non-convexity: weights found along with the solution; pcm+gnc: one after the other
  huber cauchy losses, central only
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``FILES… OUT``, the method, and all settings of its solver."""
    from maslam.backend.config import CentralConfig, LinkModel, RobustConfig, SolverConfig

    from .methods import METHODS, ROBUST, WEIGHTS

    parser.epilog = _METHODS
    parser.add_argument(
        "files", metavar="FILES", type=Path, nargs="+", help="a g2o file, one file per robot, or a folder of them"
    )
    parser.add_argument("out", metavar="OUT", type=Path, help="a .g2o file, or a folder for one file per robot")
    parser.add_argument(
        "--method",
        choices=METHODS,
        help="see below (default: elected; central with huber or cauchy, or where FIX lines hold several vertices)",
    )
    parser.add_argument("--robust", choices=ROBUST, default="none", help="see below (default: %(default)s)")
    parser.add_argument(
        "--weights",
        choices=WEIGHTS,
        default="auto",
        help="of edges: the files' information (cost F), 1 (cost U), or auto: 1 where every matrix is the identity "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--agents",
        type=at_least_one,
        metavar="N",
        help="cut a single graph into N robots of consecutive poses (default: the robots of the files)",
    )
    parser.add_argument(
        "--monocular",
        metavar="ROBOTS",
        help="robots with one camera, whose unit of length is their own and drifts: all, or numbers, 0,2 "
        "(default: none; see below)",
    )
    parser.add_argument(
        "--matches-one-by-one",
        action="store_true",
        help="method elected: give the robots their matches in the order of the later pose, each as an update of what "
        "they have, and report what it costs beside solving anew (links: --link.delay-s, --link.rate-kbit)",
    )
    parser.add_argument(
        "--skip-broken-lines", action="store_true", help="name broken lines and go on, instead of failing"
    )
    parser.add_argument("--overwrite", action="store_true", help="replace graphs that OUT names")
    parser.add_argument("--no-certificate", action="store_true", help="without the proof of global optimality")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="cost against bytes, all methods (.png, .svg, .pdf)")
    parser.add_argument("--json", action="store_true", help="print the report as one JSON object")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_model_options(parser, SolverConfig(), "solver")
    add_model_options(parser, CentralConfig(), "central")
    add_model_options(parser, RobustConfig(), "robust")
    add_model_options(parser, LinkModel(), "link")


def main(arguments: argparse.Namespace) -> None:
    """The command; :class:`ToolError` where robots refused the result: what was asked is not done then."""
    from maslam.backend.config import LinkModel
    from maslam.backend.pose_graph.fixed import not_held_text
    from maslam.backend.pose_graph.g2o import read_g2o

    from ..common.figures import check_picture
    from .asked import settings_of
    from .files import check_free, expand, names_of, write
    from .methods import CENTRAL, check, default_method

    by_default = arguments.method is None
    if by_default:
        arguments.method = default_method(arguments.robust)
    one_by_one = arguments.matches_one_by_one
    check(arguments.method, arguments.robust, arguments.monocular is not None, one_by_one)
    for setting, _ in [] if one_by_one else leaves(LinkModel, "link"):
        if hasattr(arguments, DEST + setting):
            raise UsageError(f"{option_name(setting)} is of --matches-one-by-one")
    if one_by_one and arguments.plot is not None:
        raise UsageError("--plot compares methods; leave out --matches-one-by-one, or --plot")
    if arguments.monocular is not None and arguments.plot is not None:
        raise UsageError("--plot compares methods on rigid graphs; leave out --monocular, or --plot")
    for path, instead in (("solver.method", "--method"), ("solver.robust", "--robust"), ("central.loss", "--robust")):
        if hasattr(arguments, DEST + path):
            raise UsageError(f"{option_name(path)} is chosen by {instead}")
    inputs = expand(arguments.files)
    check_picture(arguments.plot)
    skipped: list[str] | None = [] if arguments.skip_broken_lines else None
    notes: list[str] = []
    graph = read_g2o(inputs, skipped, notes)
    lost = not_held_text(graph, arguments.method) if arguments.method != CENTRAL or arguments.monocular else []
    if lost and by_default and not one_by_one and arguments.monocular is None:
        arguments.method = CENTRAL
        lost = ["solved by central, which holds all vertices of FIX lines"]
    notes += lost
    settings = settings_of(arguments)
    check_free(arguments.out, inputs, settings, arguments.overwrite)
    for line in skipped or []:
        print(f"maslam: skipped: {line}", file=sys.stderr)
    if arguments.agents is not None:
        graph = graph.partitioned(arguments.agents)
    solved, report, units = optimise_graph(graph, arguments, notes)
    report = replace(report, files=names_of(inputs), settings=settings)
    if report.refused is None:
        write(arguments.out, solved, report, units)
    if arguments.plot is not None:
        plot(graph, arguments)
    where = f"  {arguments.out}" if report.refused is None else "  nothing is written"
    print(json.dumps(asdict(report)) if arguments.json else "\n".join([*report.lines(), where]))
    if report.refused is not None:
        other = "central" if arguments.method != "central" else "rbcd"
        raise ToolError(
            f"{arguments.out}: not written: the solver refused its own result ({report.refused}); --method {other} "
            "solves it another way"
        )


def optimise_graph(
    graph: PoseGraph, arguments: argparse.Namespace, notes: Sequence[str] = ()
) -> tuple[PoseGraph, PgoReport, Mapping[NodeId, float]]:
    """Run the method that ``arguments`` name; returns the graph with its own information, in one unit of length, the
    report, and the poses' units where they were found. ``notes`` of the reading go into the report."""
    from maslam.backend.central.graph_report import report as look_at
    from maslam.backend.central.odometry import corrected
    from maslam.backend.pose_graph.fixed import laid_on_fixed, not_held
    from maslam.backend.pose_graph.node import robot_name

    from ..common.progress import counter, progress_on
    from .asked import request_of
    from .methods import CENTRAL, SELECTIONS, caps_reached, solve
    from .undecided import undecided_records

    request = request_of(graph, arguments)
    start = time.perf_counter()
    holds = arguments.method == CENTRAL and not request.monocular
    working = graph if holds else replace(graph, fixed=frozenset())
    if request.link is None:
        found = solve(working, request)
    else:
        with progress_on(quiet=arguments.quiet) as progress:
            found = solve(working, request, counter(progress, "matches"))
    if graph.fixed and not holds:
        found = replace(found, poses=laid_on_fixed(graph, found.poses))
    seconds = time.perf_counter() - start
    solved = graph.in_one_unit(found.poses, found.units) if found.units else graph.with_poses(found.poses)
    if found.lengths or found.turns:
        solved = corrected(solved, found.lengths, found.turns)
    apart = frozenset(not_held(graph))  # more than a free graph's optimum can hold: it is no bound
    if not holds:
        solved, apart = replace(solved, fixed=graph.fixed - apart), frozenset()
    believed = solved.with_weights(found.weights)
    unproved = found.units or apart or (arguments.no_certificate and not found.refused)
    proof = (None, None) if unproved else _proof(believed, found)
    certified, gap = (None, None) if arguments.no_certificate else proof
    sizes = [found.units[n] for n in found.units if n.robot in request.monocular]
    report = PgoReport(
        method=arguments.method,
        robust=arguments.robust,
        minimised=found.minimised,
        cost=_costs(believed),
        initial_cost=_costs(graph.with_weights(found.weights)),
        certified=certified,
        gap=gap,
        iterations=found.iterations,
        rotation_sweeps=found.rotation_sweeps,
        pose_sweeps=found.pose_sweeps,
        payload_bytes=found.payload_bytes,
        wire_bytes=found.wire_bytes,
        messages=found.messages,
        seconds=round(seconds, 3),
        robots=len(graph.robots),
        poses=len(graph.poses),
        edges=len(graph.edges),
        separator_edges=sum(e.is_separator for e in graph.edges),
        rejected_edges=len(found.rejected),
        unreached_poses=found.unreached_poses,
        rejected=found.rejected,
        undecided=undecided_records(believed, request.selection) if request.robust in SELECTIONS else [],
        warnings=[
            *notes,
            *look_at(graph).lines(),
            *_without_landmarks(graph, solved),
            *([] if proof[0] else caps_reached(request, found)),
        ],
        refused=None if _nothing_to_do(found, *proof) else found.refused,
        updates=found.updates,
        monocular=sorted(request.monocular),
        lengths={robot_name(robot): found.lengths[robot] for robot in sorted(found.lengths)},
        turns_deg_m={robot_name(r): np.degrees(found.turns[r]).tolist() for r in sorted(found.turns)},
        units={"smallest": min(sizes), "largest": max(sizes)} if sizes else None,
    )
    if not all(map(math.isfinite, report.cost.values())):
        raise ToolError("the optimised graph's cost is not finite")
    return solved, report, found.units


def _without_landmarks(graph: PoseGraph, solved: PoseGraph) -> list[str]:
    """A sentence where landmarks that were read are not written."""
    lost = bool(graph.landmarks) and not solved.landmarks
    return ["landmarks are left out of the result: they are measured in units of the poses that see them"] * lost


def _nothing_to_do(found: Solution, certified: bool | None, gap: float | None) -> bool:
    """Whether the poses that robots kept are the optimum's, up to the rounding of what they send: a result that is no
    better is no failure."""
    from maslam.backend.distributed.elected import NO_SURE_GAIN

    if certified or (gap is not None and gap < _ROUNDING) or (found.refused or "").startswith(NO_SURE_GAIN):
        return True
    return found.cost_before is not None and found.cost_before < 1e-12


def plot(graph: PoseGraph, arguments: argparse.Namespace) -> None:
    """Cost against bytes for all methods, without robust selection."""
    from maslam.backend.central.optimise import optimise
    from maslam.backend.config import CentralConfig

    from ..common.progress import counter, progress_on
    from .asked import request_of
    from .curves import curves
    from .picture import draw_convergence

    graph = replace(graph, fixed=frozenset())
    request = replace(request_of(graph, arguments), robust="none")
    optimum = optimise(graph, CentralConfig(cost="U" if request.unit else "F")).cost_after
    with progress_on(quiet=arguments.quiet) as progress:
        made = curves(graph, request, optimum, tick=counter(progress, "methods"))
        title = f"{len(graph.robots)} robots, {len(graph.poses)} poses, {len(graph.edges)} edges"
        draw_convergence(made, title, arguments.plot)
        progress.say(f"wrote {arguments.plot}")


def _proof(graph: PoseGraph, found: Solution) -> tuple[bool | None, float | None]:
    from maslam.backend.central.certificate import certify

    if found.minimised == "E":
        return None, None
    certificate = certify(graph, found.minimised)  # type: ignore[arg-type]
    return certificate.certified, certificate.gap if math.isfinite(certificate.gap) else None


def _costs(graph: PoseGraph) -> dict[str, float]:
    from maslam.backend.central.costs import cost

    return {"F": cost(graph, "F"), "U": cost(graph, "U"), "E": cost(graph, "E")}
