"""Cost against bytes: where each method would stand had it stopped after so many sweeps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from maslam._replaced import replaced
from maslam.backend.central.costs import cost
from maslam.backend.errors import BackendError
from maslam.backend.pose_graph.graph import PoseGraph

from .methods import CENTRAL, METHODS, TWO_STAGE, Request, solve, solver_of

_SWEEPS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 28, 40, 56, 80, 112, 160, 224)


@dataclass(frozen=True)
class Curve:
    """``payload``, ``wire``: bytes; ``gaps``: cost over the optimum, minus one; one of each for every stop. ``end``:
    whether the last point is where the method stops by itself."""

    method: str
    payload: tuple[int, ...]
    wire: tuple[int, ...]
    gaps: tuple[float, ...]
    end: bool


def curves(
    graph: PoseGraph,
    request: Request,
    optimum: float,
    methods: Sequence[str] = METHODS,
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> list[Curve]:
    """A curve for each distributed method; ``optimum``: the least cost there is, in the convention minimised."""
    chosen, made = [method for method in methods if method != CENTRAL], []
    for done, method in enumerate(chosen):
        tick(done, len(chosen))
        made.append(_curve(graph, replace(request, method=method), optimum))
    tick(len(chosen), len(chosen))
    return made


def _curve(graph: PoseGraph, request: Request, optimum: float) -> Curve:
    points, end = [], False
    for limit, stopped in _stops(request):
        try:
            found = solve(graph, stopped)
        except BackendError:
            if limit is None:
                raise
            continue  # stopped so early that not every robot has received from a neighbour
        reached = cost(graph.with_poses(found.poses), found.minimised)  # type: ignore[arg-type]
        points.append((found.payload_bytes, found.wire_bytes, max(reached / optimum - 1.0, 0.0)))
        end = limit is None or found.iterations < limit
        if end:
            break
    payload, wire, gaps = zip(*points, strict=True) if points else ((), (), ())
    return Curve(request.method, payload, wire, gaps, end)


def _stops(request: Request) -> Iterator[tuple[int | None, Request]]:
    """The method with growing numbers of sweeps (0: it never ends by itself), those without sweeps once (None)."""
    config = replaced(request.solver, method=request.method)
    if request.method == "quick":
        config = solver_of("quick")
    if request.method not in (*TWO_STAGE, "rbcd"):
        yield None, replace(request, solver=config)
        return
    for sweeps in _SWEEPS:
        if request.method in TWO_STAGE:
            fixed = {"rotation_threshold": 0.0, "pose_threshold": 0.0}
            limits = {"rotation_sweeps": max(1, sweeps // 2), "pose_sweeps": sweeps}
            yield 0, replace(request, solver=replaced(config, **fixed, **limits))
        else:
            yield sweeps, replace(request, solver=replaced(config, descent_sweeps=sweeps))
