"""On how many frames errors were measured, after which alignment, with which scale, in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..common.text_table import counted

Alignment = dict[str, Any]


def alignment_text(alignment: Alignment | None) -> str:
    """``SE(3)``, or ``Sim(3), scale 3.21``."""
    return "-" if alignment is None else _kinds([alignment])


def measured_on(summary: dict[str, Any]) -> str:
    """On how many of the frames read the mean error was measured, and after which alignment; empty where neither was
    written."""
    known = _known(summary, "agents")
    if not summary.get("coverage") or not known:
        return ""
    return f"measured on {_frames(known)} of {frames_read(summary)} frames read, after {_kinds(known, 'alignment')}"


def odometry_measured_on(summary: dict[str, Any]) -> str:
    """The same of odometry's error; empty where it was not written, or no track had truth enough."""
    known, placed = _known(summary, "odometry"), _known(summary, "agents")
    if not known:
        return ""
    if any("tracks" not in a for a in known):  # of an earlier version
        return f"on the longest track of each agent ({_frames(known)} frames), after {_kinds(known, 'alignment')}"
    same = [(a and a["frames"]) for a in _all(summary, "odometry")] == [
        (a and a["frames"]) for a in _all(summary, "agents")
    ]
    on = "on the same frames" if same else f"on {_frames(known)} of these {_frames(placed)} frames"
    several = sum(a["tracks"] for a in known) > len(known)
    return f"{on}, after {_kinds(known, 'alignment of each track by itself' if several else 'alignment')}"


def keyframes_measured_on(summary: dict[str, Any]) -> list[str]:
    """The same of maps and of agents under a common alignment, which are of key-frames."""
    columns = (
        ("maps held", "each holder's", _known(summary, "maps")),
        ("connected", "each group's", _known(summary, "connected")),
    )
    return [
        f"{name} on {counted(_frames(known), 'key-frame')}, {whose} after one {_kinds(known, 'alignment')}"
        for name, whose, known in columns
        if known
    ]


def table_note(summary: dict[str, Any]) -> str:
    """What each column of the report's table of errors was measured on."""
    odometry = odometry_measured_on(summary)
    parts = [measured_on(summary) or "of all frames", *([f"odometry {odometry}"] if odometry else [])]
    return "; ".join([*parts, *keyframes_measured_on(summary)]) + ". "


def frames_read(summary: dict[str, Any]) -> int:
    """By all agents, and of sequences that no agent was made of."""
    found = [c["read"] for c in summary.get("coverage") or []]
    return sum(found) + sum(one["frames"] for one in summary.get("left_out") or [])


def _all(summary: dict[str, Any], what: str) -> list[Alignment | None]:
    return (summary.get("alignments") or {}).get(what) or []


def _known(summary: dict[str, Any], what: str) -> list[Alignment]:
    return [a for a in _all(summary, what) if a is not None]


def _frames(alignments: Sequence[Alignment]) -> int:
    return sum(int(a["frames"]) for a in alignments)


def _kinds(alignments: Sequence[Alignment], noun: str = "") -> str:
    """The kinds, with the range of scales that were estimated."""
    scales = sorted(a["scale"] for a in alignments if a["kind"] != "SE(3)")
    kinds = " or ".join(sorted({a["kind"] for a in alignments})) + (f" {noun}" if noun else "")
    if not scales:
        return kinds
    return f"{kinds}, scale {scales[0]:.4g}" + (f" to {scales[-1]:.4g}" if len(scales) > 1 else "")
