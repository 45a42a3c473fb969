"""Frames read, tracked, placed and lost, in words: for the console and the report."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from html import escape
from typing import Any

from ..common.text_table import counted, kinds_text
from .html import Section, table
from .measured import alignment_text

HEAD = ("frames read", "tracked", "placed", "tracks placed", "ATE measured on", "alignment")
_KINDS = 4  # of reasons that are named for one agent
_INTERVALS = 3  # of each kind
_FIGURE = re.compile(r"\d+(\.\d+)?")


def coverage_rows(summary: dict[str, Any]) -> list[list[str]]:
    """A row for each agent, and their sum where there are several; none of a run before coverage was written."""
    coverage = summary.get("coverage") or []
    alignments = (summary.get("alignments") or {}).get("agents") or [None] * len(coverage)
    rows = [
        [
            name,
            str(c["read"]),
            _share(c["tracked"], c["read"]),
            _share(c["placed"], c["read"]),
            f"{c['tracks_placed']} of {c['tracks']}",
            "-" if a is None else counted(a["frames"], "frame"),
            alignment_text(a),
        ]
        for name, c, a in zip(agent_names(summary)[: len(coverage)], coverage, alignments, strict=True)
    ]
    if len(rows) > 1:
        read, tracked, placed, tracks, joined = (
            sum(c[key] for c in coverage) for key in ("read", "tracked", "placed", "tracks", "tracks_placed")
        )
        measured = sum(a["frames"] for a in alignments if a is not None)
        shares = [_share(tracked, read), _share(placed, read)]
        on = counted(measured, "frame") if measured else "-"
        rows.append(["sum", str(read), *shares, f"{joined} of {tracks}", on, ""])
    return rows


def coverage_sections(summary: dict[str, Any]) -> list[Section]:
    """The report's part on coverage; none of a run before it was written."""
    rows = coverage_rows(summary)
    if not rows:
        return []
    note = (
        "Frames that were read; of those, tracked by odometry; of those, placed in the frame that the agent ended in. "
    )
    note += "All other figures are about the placed ones."
    cells = [[escape(cell) for cell in row] for row in rows]
    lost = "".join(f"<li>{escape(line)}</li>" for line in lost_lines(summary))
    body = f'<div class="scroll">{table(["agent", *HEAD], cells, total=len(rows) > 1)}</div>'
    return [Section("Coverage", note, body + (f"<ul>{lost}</ul>" if lost else "<p>No frame was lost.</p>"))]


def in_one_frame(summary: dict[str, Any]) -> tuple[int, int, list[str]]:
    """Agents that share one frame, of how many that there should be, and the names of those without any place."""
    known = summary.get("one_frame")
    if known:
        return int(known["agents"]), int(known["of"]), list(known["without"])
    return max((len(group) for group in summary["groups"]), default=0), int(summary["agents"]), []


def percent_text(percent: float) -> str:
    """``99.8 %``; what is not all is never 100 %."""
    return f"{percent if percent >= 100.0 - 1e-9 else min(percent, 99.9):.1f} %"


def lost_lines(summary: dict[str, Any]) -> list[str]:
    """What has no place, a sentence each: lost and doubtful intervals by reason, tracks that nothing joins, sequences
    without an agent."""
    lines = []
    coverage = summary.get("coverage") or []
    for name, c in zip(agent_names(summary)[: len(coverage)], coverage, strict=True):
        for what in ("lost", "doubtful"):
            lines += [f"{name}: {line}" for line in _by_reason(c.get(what) or [], what)]
        apart = c["tracks"] - c["tracks_placed"]
        if apart:
            frames = counted(c["tracked"] - c["placed"], "tracked frame")
            lines.append(f"{name}: {counted(apart, 'track')} that nothing joins, {frames} without a place")
        if c.get("missing"):
            lines.append(f"{name}: {_missing(c['missing'])}")
    for one in summary.get("left_out") or []:
        lines.append(f"sequence {one['sequence']}: no agent, {counted(one['frames'], 'frame')}: {one['reason']}")
    return lines


def agent_names(summary: dict[str, Any]) -> list[str]:
    """``agent_00`` …, with the name of its images where that is another and not the same for all."""
    coverage = summary.get("coverage") or []
    sources = {c["sequence"] for c in coverage}
    plain = [f"agent_{i:02d}" for i in range(summary["agents"])]
    if len(sources) < 2:
        return plain
    names = (c["sequence"] for c in coverage)
    return [one if one == name else f"{one} ({name})" for one, name in zip(plain, names, strict=True)]


def _by_reason(intervals: Sequence[dict[str, Any]], what: str) -> list[str]:
    """Intervals of the same kinds of reasons together, their frames by kind; where kinds are not known, those whose
    reasons differ by their figures only."""
    alike: dict[tuple[str, ...], list[dict[str, Any]]] = {}
    for one in intervals:
        alike.setdefault(tuple(sorted(one.get("kinds") or [_FIGURE.sub("…", one["reason"])])), []).append(one)
    most = sorted(alike.items(), key=lambda entry: -_frames(entry[1]))
    lines = []
    for _, members in most[:_KINDS]:
        spans = [_span(m) for m in members[:_INTERVALS]]
        more = f" and {len(members) - _INTERVALS} more" if len(members) > _INTERVALS else ""
        lines.append(f"{counted(_frames(members), 'frame')} {what} ({', '.join(spans)}{more}): {_reason(members)}")
    rest = [m for _, members in most[_KINDS:] for m in members]
    if rest:
        lines.append(f"{counted(_frames(rest), 'frame')} {what} for {len(most) - _KINDS} other reasons")
    return lines


def _reason(members: Sequence[dict[str, Any]]) -> str:
    """That of one interval in its own words; of several the sums of their frames by kind."""
    if len({m["reason"] for m in members}) == 1 and (len(members) == 1 or not members[0].get("kinds")):
        return str(members[0]["reason"])
    if all(m.get("kinds") for m in members):
        return kinds_text(sum((Counter(m["kinds"]) for m in members), Counter()))
    return f"{members[0]['reason']} (the first of {len(members)})"


def _span(interval: dict[str, Any]) -> str:
    """Frames counted from 0, and the images' names where these are others."""
    frames = f"{interval['first_frame']} to {interval['last_frame']}"
    first, last = interval.get("first_image"), interval.get("last_image")
    if not first:
        return frames
    return f"{frames} = {first}" if first == last else f"{frames} = {first} to {last}"


def _missing(holes: Sequence[dict[str, Any]]) -> str:
    count = sum(int(one["count"]) for one in holes)
    spans = [one["first"] if one["count"] == 1 else f"{one['first']} to {one['last']}" for one in holes[:_INTERVALS]]
    more = f" and {len(holes) - _INTERVALS} more gaps" if len(holes) > _INTERVALS else ""
    return f"{counted(count, 'image')} missing by the numbers in the file names: {', '.join(spans)}{more}"


def _frames(intervals: Sequence[dict[str, Any]]) -> int:
    return sum(int(one["last_frame"]) - int(one["first_frame"]) + 1 for one in intervals)


def _share(count: int, of: int) -> str:
    """A count, with its percentage where it is not all."""
    return str(count) if count >= of else f"{count} ({percent_text(100.0 * count / of)})"
