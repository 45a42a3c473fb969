"""``maslam pgo``: optimise pose graphs from g2o files, centrally or by robots that exchange separator poses."""

from __future__ import annotations

import argparse
import json
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tools.errors import ToolError, UsageError
from tools.options import DEST, add_model_options, build, option_name

if TYPE_CHECKING:
    from backend.graph import PoseGraph

METHODS = ("central", "dgs", "jor", "sor")
SUMMARY = "summary.json"


@dataclass(frozen=True)
class PgoReport:
    """What an optimisation did. Costs by convention (docs/backend.md); bytes are 0 for the central method.

    ``certified`` and ``gap`` (share by which the cost may be above the global optimum) are None: not computed.
    ``rotation_sweeps`` and ``pose_sweeps`` are None for the central method; ``iterations`` is their sum, or the
    central solver's.
    """

    method: str
    robust: str
    minimised: str
    cost: dict[str, float]
    initial_cost: dict[str, float]
    certified: bool | None
    gap: float | None
    iterations: int
    rotation_sweeps: int | None
    pose_sweeps: int | None
    payload_bytes: int
    wire_bytes: int
    messages: int
    seconds: float
    robots: int
    poses: int
    edges: int
    separator_edges: int
    rejected_edges: int
    unreached_poses: int

    def lines(self) -> list[str]:
        """For people."""
        head = f"{self.method}: {self.robots} robots, {self.poses} poses, {self.edges} edges"
        out = [f"{head}, {self.separator_edges} between robots"]
        for name in self.cost:
            mark = "  (minimised)" if name == self.minimised else ""
            out.append(f"  {name}  {self.initial_cost[name]:.6g} -> {self.cost[name]:.9g}{mark}")
        if self.rotation_sweeps is None:
            out.append(f"  {self.iterations} iterations, {self.seconds:.2f} s")
        else:
            sweeps = f"{self.rotation_sweeps} rotation and {self.pose_sweeps} pose sweeps"
            traffic = f"{self.payload_bytes} bytes of separator poses, {self.wire_bytes} in {self.messages} messages"
            out.append(f"  {sweeps}, {traffic}, {self.seconds:.2f} s")
        if self.unreached_poses:
            out.append(f"  {self.unreached_poses} poses are joined to the anchor by no edge and stay")
        return out


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """``FILES… OUT``, the method, and everything its solver can be told."""
    from backend.config import CentralConfig, SolverConfig

    parser.add_argument(
        "files", metavar="FILES", type=Path, nargs="+", help="a g2o file, one file a robot, or a folder of them"
    )
    parser.add_argument("out", metavar="OUT", type=Path, help="a .g2o file, or a folder for one file a robot")
    parser.add_argument(
        "--method", choices=METHODS, default="sor", help="central (gtsam) or distributed (default: sor)"
    )
    parser.add_argument(
        "--weights",
        choices=("auto", "information", "unit"),
        default="auto",
        help="of edges: the files' information (cost F), 1 (cost U), or auto: 1 where every matrix is the identity",
    )
    parser.add_argument(
        "--robust",
        choices=("none", "huber", "cauchy"),
        default="none",
        help="loss on loops and separators (central only)",
    )
    parser.add_argument("--agents", type=int, metavar="N", help="cut a single graph into N robots of consecutive poses")
    parser.add_argument(
        "--skip-broken-lines", action="store_true", help="name broken lines and go on, instead of failing"
    )
    parser.add_argument("--json", action="store_true", help="print the report as one JSON object")
    add_model_options(parser, SolverConfig(), "solver")
    add_model_options(parser, CentralConfig(), "central")


def main(arguments: argparse.Namespace) -> None:
    """The command."""
    from backend.g2o import read_g2o

    if arguments.robust != "none" and arguments.method != "central":
        raise UsageError(f"--robust {arguments.robust} works with --method central, not {arguments.method}")
    for path, instead in ((f"{DEST}solver.method", "--method"), (f"{DEST}central.loss", "--robust")):
        if hasattr(arguments, path):
            raise UsageError(f"{option_name(path.removeprefix(DEST))} is chosen by {instead}")
    skipped: list[str] | None = [] if arguments.skip_broken_lines else None
    graph = read_g2o(_expand(arguments.files), skipped)
    for line in skipped or []:
        print(f"maslam: skipped: {line}", file=sys.stderr)
    if arguments.agents is not None:
        graph = graph.partitioned(arguments.agents)
    solved, report = optimise_graph(graph, arguments)
    _write(arguments.out, solved, report)
    print(json.dumps(asdict(report)) if arguments.json else "\n".join([*report.lines(), f"  {arguments.out}"]))


def optimise_graph(graph: PoseGraph, arguments: argparse.Namespace) -> tuple[PoseGraph, PgoReport]:
    """Run the method that ``arguments`` name; returns the graph with its own information and the report."""
    unit = arguments.weights == "unit" or (arguments.weights == "auto" and _is_unweighted(graph))
    start = time.perf_counter()
    found = (_central if arguments.method == "central" else _distributed)(graph, unit, arguments)
    seconds = time.perf_counter() - start
    solved = graph.with_poses(found.pop("poses"))
    report = PgoReport(
        method=arguments.method,
        robust=arguments.robust,
        cost=_costs(solved),
        initial_cost=_costs(graph),
        certified=None,
        gap=None,
        seconds=round(seconds, 3),
        robots=len(graph.robots),
        poses=len(graph.poses),
        edges=len(graph.edges),
        separator_edges=sum(e.is_separator for e in graph.edges),
        rejected_edges=0,
        **found,
    )
    if not all(map(math.isfinite, report.cost.values())):
        raise ToolError("the optimised graph's cost is not finite")
    return solved, report


def _central(graph: PoseGraph, unit: bool, arguments: argparse.Namespace) -> dict[str, Any]:
    from backend.central import optimise
    from backend.config import CentralConfig

    base = CentralConfig(cost="U" if unit else "F", loss=arguments.robust)
    config = build(base, arguments, prefix="central")
    result = optimise(graph, config)
    return {
        "poses": result.graph.poses,
        "minimised": config.cost,
        "iterations": result.iterations,
        "rotation_sweeps": None,
        "pose_sweeps": None,
        "payload_bytes": 0,
        "wire_bytes": 0,
        "messages": 0,
        "unreached_poses": 0,
    }


def _distributed(graph: PoseGraph, unit: bool, arguments: argparse.Namespace) -> dict[str, Any]:
    from backend.config import SolverConfig
    from backend.distributed.exchange import optimise_distributed

    config = build(SolverConfig(method=arguments.method), arguments, prefix="solver")
    result = optimise_distributed(graph.with_unit_weights() if unit else graph, config)
    outcome = result.outcomes[min(result.outcomes)]
    return {
        "poses": result.graph.poses,
        "minimised": "U" if unit else "F",
        "iterations": outcome.rotation_sweeps + outcome.pose_sweeps,
        "rotation_sweeps": outcome.rotation_sweeps,
        "pose_sweeps": outcome.pose_sweeps,
        "payload_bytes": result.traffic.payload_bytes,
        "wire_bytes": result.traffic.wire_bytes,
        "messages": result.traffic.messages,
        "unreached_poses": sum(len(o.unreached) for o in result.outcomes.values()),
    }


def _is_unweighted(graph: PoseGraph) -> bool:
    import numpy as np

    return all(np.array_equal(e.information, np.eye(6)) for e in graph.edges)


def _costs(graph: PoseGraph) -> dict[str, float]:
    from backend.costs import cost

    return {"F": cost(graph, "F"), "U": cost(graph, "U"), "E": cost(graph, "E")}


def _expand(paths: Sequence[Path]) -> list[Path]:
    """Files as given; a folder stands for its g2o files, by number."""
    out: list[Path] = []
    for path in paths:
        if path.is_dir():
            inside = sorted(path.glob("*.g2o"), key=lambda p: (len(p.stem), p.stem))
            if not inside:
                raise ToolError(f"{path}: no .g2o file in this folder")
            out += inside
        else:
            out.append(path)
    return out


def _write(out: Path, graph: PoseGraph, report: PgoReport) -> None:
    """One file, or a folder with one file a robot and the report; a file appears only when it is whole."""
    from backend.g2o import write_g2o

    alone = len(graph.robots) == 1
    if out.suffix == ".g2o":
        out.parent.mkdir(parents=True, exist_ok=True)
        parts = {out: graph}
    else:
        out.mkdir(parents=True, exist_ok=True)
        parts = {out / f"{r}.g2o": graph if alone else graph.of_robot(r) for r in graph.robots}
    for path, part in parts.items():
        temporary = path.with_name(path.name + ".part")
        write_g2o(temporary, part, plain_ids=alone)
        os.replace(temporary, path)
    if out.suffix != ".g2o":
        temporary = out / (SUMMARY + ".part")
        temporary.write_text(json.dumps(asdict(report), indent=2) + "\n", encoding="utf-8")
        os.replace(temporary, out / SUMMARY)
