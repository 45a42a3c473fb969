"""``maslam bench pgo``: what distributed optimisation costs as the number of robots grows."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from maslam.backend.central.costs import cost
from maslam.backend.central.optimise import optimise
from maslam.backend.config import CentralConfig, RobustConfig
from maslam.backend.distributed.exchange import joined_robots
from maslam.backend.pose_graph.graph import PoseGraph

from ..common.errors import UsageError
from ..common.text_table import aligned
from ..pgo.city import city
from ..pgo.methods import Request, solve, solver_of


@dataclass(frozen=True)
class PgoMeasurement:
    """One method on one city. ``gap``: cost F over the central optimum's, minus one; bytes per robot and in all;
    ``cpu_s`` of all robots together, one after the other."""

    method: str
    robots: int
    poses: int
    edges: int
    separators: int
    gap: float
    iterations: int
    payload_bytes: int
    wire_bytes: int
    cpu_s: float
    central_s: float


def measure(
    sizes: Sequence[int],
    poses: int,
    methods: Sequence[str],
    seed: int = 0,
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> list[PgoMeasurement]:
    """Every method on a city of each number of robots, ``poses`` each."""
    out: list[PgoMeasurement] = []
    tick(0, len(sizes) * len(methods))
    for robots in sizes:
        graph, _ = city(robots, poses, seed)
        _check_joined(graph, seed)
        start = time.process_time()
        optimum = optimise(graph, CentralConfig()).cost_after
        central_s = time.process_time() - start
        for method in methods:
            request = Request(method, "none", False, CentralConfig(), solver_of(method), RobustConfig())
            start = time.process_time()
            found = solve(graph, request)
            cpu_s = time.process_time() - start
            excess = cost(graph.with_poses(found.poses), "F") - optimum
            gap = excess / optimum if optimum > 0 else 0.0  # without a loop every measurement can be met
            out.append(
                PgoMeasurement(
                    method,
                    robots,
                    len(graph.poses),
                    len(graph.edges),
                    sum(e.is_separator for e in graph.edges),
                    gap,
                    found.iterations,
                    found.payload_bytes,
                    found.wire_bytes,
                    cpu_s,
                    central_s,
                )
            )
            tick(len(out), len(sizes) * len(methods))
    return out


def _check_joined(graph: PoseGraph, seed: int) -> None:
    """UsageError where groups never met: bytes and gap would measure who met whom, not the method."""
    groups = joined_robots(graph)
    if len(groups) > 1:
        robots, met = len(graph.robots), groups[0]
        others = sum(n.robot not in met for n in graph.nodes)
        raise UsageError(
            f"seed {seed}, {robots} robots of {len(graph.poses) // robots} poses: {others} poses met no robot that "
            "knows the first one; take more --poses or another --seed"
        )


def table(results: Sequence[PgoMeasurement]) -> str:
    """For people."""
    heads = ["method", "robots", "poses", "separators", "above optimum", "iterations", "payload kB"]
    heads += ["kB a robot", "wire kB", "CPU s", "central s"]
    rows = [
        [
            r.method,
            str(r.robots),
            str(r.poses),
            str(r.separators),
            f"{100 * r.gap:.4f} %",
            str(r.iterations),
            f"{r.payload_bytes / 1e3:.0f}",
            f"{r.wire_bytes / 1e3 / r.robots:.1f}",
            f"{r.wire_bytes / 1e3:.0f}",
            f"{r.cpu_s:.1f}",
            f"{r.central_s:.1f}",
        ]
        for r in results
    ]
    return "\n".join(aligned([heads, *rows]))


def as_json(results: Sequence[PgoMeasurement]) -> str:
    """One list."""
    return json.dumps([asdict(r) for r in results], indent=1)


def draw(results: Sequence[PgoMeasurement], path: Path) -> None:
    """Bytes a robot, processor time a robot, and the gap, against the number of robots."""
    from ..common.figures import colour_of, dress, saved_figure

    panels: list[tuple[str, Callable[[PgoMeasurement], float]]] = [
        ("kB sent per robot", lambda r: r.wire_bytes / 1e3 / r.robots),
        ("processor seconds a robot", lambda r: r.cpu_s / r.robots),
        ("above the optimum, share", lambda r: max(r.gap, 1e-8)),
    ]
    with saved_figure(path, (11.5, 3.6)) as figure:
        for k, (label, value) in enumerate(panels):
            axes = figure.add_subplot(1, len(panels), k + 1)
            for number, method in enumerate(dict.fromkeys(r.method for r in results)):
                chosen = [r for r in results if r.method == method]
                x, y = [r.robots for r in chosen], [value(r) for r in chosen]
                axes.plot(x, y, "-o", ms=4, lw=1.6, color=colour_of(number), label=method)
            axes.set_xscale("log")
            axes.set_yscale("log")
            sizes = sorted({r.robots for r in results})
            axes.set_xticks(sizes, labels=[str(size) for size in sizes])
            axes.set_xticks([], minor=True)
            dress(axes, "", "robots", label)
        figure.axes[0].legend()
