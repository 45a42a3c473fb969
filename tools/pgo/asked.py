"""What the command line of ``maslam pgo`` asks for: as a request to the methods, and as it is noted beside a result."""

from __future__ import annotations

import argparse
from typing import Any

from maslam.backend.config import CentralConfig, LinkModel, RobustConfig
from maslam.backend.pose_graph.graph import PoseGraph
from maslam.backend.pose_graph.node import robot_name

from ..common.errors import UsageError
from ..common.options import build
from .methods import LOSSES, Request, own_units, solver_of, takes_unit_weights


def settings_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """What the command line asks for that reaches the result, as it is noted beside it."""
    models = {
        "solver": solver_of(arguments.method),
        "central": CentralConfig(),
        "selection": RobustConfig(),
        **({"link": LinkModel()} if arguments.matches_one_by_one else {}),
    }
    prefixes = {"selection": "robust"}
    return {
        **{name: getattr(arguments, name) for name in ("method", "robust", "weights", "agents", "monocular")},
        **{name: getattr(arguments, name) for name in ("matches_one_by_one", "skip_broken_lines", "no_certificate")},
        **{
            name: build(model, arguments, prefix=prefixes.get(name, name)).model_dump(mode="json")
            for name, model in models.items()
        },
    }


def request_of(graph: PoseGraph, arguments: argparse.Namespace) -> Request:
    """The request of the command line for this graph."""
    unit = takes_unit_weights(arguments.weights, graph)
    loss = arguments.robust if arguments.robust in LOSSES else "none"
    central = build(CentralConfig(cost="U" if unit else "F", loss=loss), arguments, prefix="central")
    solver = build(solver_of(arguments.method), arguments, prefix="solver")
    selection = build(RobustConfig(), arguments, prefix="robust")
    monocular = _monocular(graph, arguments.monocular)
    link = build(LinkModel(), arguments, prefix="link") if arguments.matches_one_by_one else None
    return Request(arguments.method, arguments.robust, unit, central, solver, selection, monocular, link)


def _monocular(graph: PoseGraph, robots: str | None) -> frozenset[int]:
    """The robots that ``--monocular`` names."""
    if robots is None:
        return frozenset()
    if robots == "all":
        return frozenset(graph.robots)
    named = {robot_name(robot): robot for robot in graph.robots}
    try:
        return own_units(graph, [named[name] if name in named else int(name) for name in robots.split(",")])
    except ValueError:
        given = robots or "''"
        raise UsageError(f"--monocular {given}: all, or numbers of robots, like 0,2") from None
