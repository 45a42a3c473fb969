"""What became of the map of an earlier run: lines of text, and the report's part on it."""

from __future__ import annotations

from typing import Any

from ..common.text_table import counted
from .html import Section, table


def earlier_lines(summary: dict[str, Any]) -> list[str]:
    """Of a run's ``summary.json``: in whose frame the later agents stand; none for a run onto no earlier one."""
    found = summary.get("earlier")
    if not found:
        return []
    first, here = found["agents"], found["in_frame"]
    names = ", ".join(f"agent_{a:02d}" for a in here) or "none"
    lines = [
        f"earlier map    {counted(first, 'agent')}, in the frame of agent_{found['frame'][0]:02d}; of the "
        f"{summary['agents'] - first} later ones in it: {names}"
    ]
    before, now = (_mean(found[key][:first]) for key in ("before_rmse_m", "ate_rmse_m"))
    if before is not None and now is not None:
        lines.append(f"  {'its error':<13}{before:.3f} m before, {now:.3f} m now (RMSE, mean of its agents)")
    if (later := _mean([found["ate_rmse_m"][a] for a in here])) is not None:
        lines.append(f"  {'in its frame':<13}{later:.3f} m (RMSE, mean of the later agents, under the map's alignment)")
    return lines


def earlier_sections(summary: dict[str, Any]) -> list[Section]:
    """The report's part on it; none for a run onto no earlier one."""
    found = summary.get("earlier")
    if not found:
        return []
    unit = "m" if summary["scale"] == "metric" else "of its unit"
    moved = "" if found["moved"] is None else f" Its key-frames have moved by {found['moved']:.3f} {unit} (RMS)."
    note = (
        f"The first {counted(found['agents'], 'agent')} are those of the earlier run. Errors of key-frames (RMSE) "
        f"where the earlier agents alone say how the map lies on the truth.{moved}"
    )
    rows = [
        [
            f"agent_{agent:02d}",
            "earlier" if agent < found["agents"] else "later",
            "–" if agent >= found["agents"] else _metres(found["before_rmse_m"][agent]),
            _metres(error),
            "" if agent < found["agents"] else "stands in it" if agent in found["in_frame"] else "not joined",
        ]
        for agent, error in enumerate(found["ate_rmse_m"])
    ]
    head = ["agent", "run", "error before", "error now", "earlier map"]
    return [Section("The earlier run's map", note, f'<div class="scroll">{table(head, rows, 2)}</div>')]


def _metres(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f} m"


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
