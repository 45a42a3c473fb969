"""Selections that the graph does not decide, as records of a report and as sentences."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypedDict

from maslam.backend.config import RobustConfig
from maslam.backend.pose_graph.graph import PoseGraph
from maslam.backend.pose_graph.node import robot_name
from maslam.backend.robust.undecided import undecided_edges

# Lines on the console; --json has all.
_LINES = 5


class UndecidedRecord(TypedDict):
    """``robots`` that could as well stand elsewhere against the rest; the ``kept`` edges that place them; and for each
    other place the ``rejected`` edges that would hold there. Edges by name."""

    robots: list[str]
    kept: list[str]
    rejected: list[list[str]]


def undecided_records(graph: PoseGraph, config: RobustConfig) -> list[UndecidedRecord]:
    """Of a solved graph with the weights of its selection, those with most edges first."""
    out: dict[tuple[int, ...], UndecidedRecord] = {}
    for one in undecided_edges(graph, config):
        known = out.setdefault(
            one.kept,
            UndecidedRecord(robots=[robot_name(r) for r in one.robots], kept=_named(graph, one.kept), rejected=[]),
        )
        known["rejected"].append(_named(graph, one.rejected))
    return list(out.values())


def undecided_lines(records: Sequence[UndecidedRecord]) -> list[str]:
    """For people: what is not known, and where."""
    out = []
    for one in records[:_LINES]:
        robots, kept = one["robots"], one["kept"]
        whose = f"robot {robots[0]} stands" if len(robots) == 1 else f"robots {', '.join(robots)} stand"
        most, places = max(map(len, one["rejected"])), len(one["rejected"])
        there = "another place" if places == 1 else f"{places} other places"
        edges = f"1 edge, {kept[0]}," if len(kept) == 1 else f"{len(kept)} edges, {kept[0]} …,"
        out.append(
            f"  undecided where {whose}: {edges} kept, {most} rejected for {there}; wrong edges may have been kept"
        )
    if len(records) > _LINES:
        out.append(f"  undecided in {len(records) - _LINES} more ways; --json lists them")
    return out


def _named(graph: PoseGraph, rows: Sequence[int]) -> list[str]:
    return [f"{graph.edges[k].i} - {graph.edges[k].j}" for k in rows]
