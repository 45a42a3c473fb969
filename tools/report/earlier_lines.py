"""What became of the map of an earlier run, in lines of text."""

from __future__ import annotations

from typing import Any

from ..common.text_table import counted


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


def _mean(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None
