"""Graphs that do not fit, in words: for the console and the report."""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import Any

from .html import Section

_KINDS = {"odometry": "odometry", "loop": "own loop", "separator": "match"}
_NAMED = 3
_LOOSE = 3.0


def graph_lines(summary: Mapping[str, Any]) -> list[str]:
    """A warning for each group of agents whose graph does not fit, with the edges that fit worst; none where all do."""
    return [_line(graph) for graph in summary.get("graphs") or [] if not graph["fits"]]


def odometry_lines(summary: Mapping[str, Any]) -> list[str]:
    """For each group of agents, by its matches: how exact odometry is, and lengths that were mended; none where matches
    tell nothing of it."""
    return [line for graph in summary.get("graphs") or [] for line in _odometry(graph)]


def _odometry(graph: Mapping[str, Any]) -> list[str]:
    errors, lengths, out = graph.get("odometry_sigmas") or {}, graph.get("lengths") or [], []
    whose = " ".join(f"agent_{agent:02d}" for agent in graph["agents"])
    if errors:
        values = ", ".join(f"{value:.2g}" for value in errors.values())
        spans = ", ".join(str(span) for span in errors)
        out.append(f"odometry       of {whose}, by matches: errors {values} x stated over {spans} key-frames")
        if max(errors.values()) > _LOOSE:
            out.append(
                f"  more than {_LOOSE:g}: state less, --optimisation.odometry-sigma-share or -deg, or look for a cause"
            )
    if any(length != 1.0 for length in lengths):
        off = ", ".join(f"{100 * (1 / length - 1):+.2f} %" for length in lengths)
        out.append(f"  lengths      off by {off} (mended; what is common to all stays unknown)")
    turns = graph.get("turns_deg_m") or []
    if any(any(turn) for turn in turns):
        off = ", ".join(" ".join(f"{-x:+.4f}" for x in turn) for turn in turns)
        out.append(f"  headings     off by {off} degrees a metre about the camera's x, y, z (mended)")
    return out


def warning_sections(summary: Mapping[str, Any]) -> list[Section]:
    """The report's part on them; none where all graphs fit."""
    lines = "".join(f"<li>{escape(line)}</li>" for line in graph_lines(summary))
    note = (
        "Edges, named by agent:key-frame, contradict each other or are not as good as they claim. Do not rely on the "
    )
    note += "figures of these agents' map before you know why."
    return [Section("A graph that does not fit", note, f"<ul>{lines}</ul>")] if lines else []


def _line(graph: Mapping[str, Any]) -> str:
    whose = " ".join(f"agent_{agent:02d}" for agent in graph["agents"])
    times = graph["cost"] / graph["dof"]
    worst = "; ".join(_edge(edge) for edge in graph["worst"][:_NAMED])
    return (
        f"warning: the graph of {whose} does not fit: cost {graph['cost']:.4g} at {graph['dof']} degrees of freedom, "
        f"{times:.3g} x what noise makes; worst: {worst}"
    )


def _edge(edge: Mapping[str, Any]) -> str:
    first, second = edge["ends"]
    return f"{_KINDS.get(edge['kind'], edge['kind'])} {first} - {second} ({math.sqrt(edge['cost']):.3g} sigma)"
