"""How the maps lie on the positions measured from outside (GPS), in lines of text."""

from __future__ import annotations

from typing import Any

from ..common.text_table import counted


def position_lines(summary: dict[str, Any]) -> list[str]:
    """Of a run's ``summary.json``: one line a group of agents, none where no agent had positions."""
    positions = summary.get("positions")
    if not positions:
        return []
    unused = "" if positions["used"] else "; not used in optimisation"
    return [f"positions      {_line(group)}{unused}" for group in positions["groups"]]


def _line(group: dict[str, Any]) -> str:
    who = ", ".join(f"agent_{number:02d}" for number in group["agents"])
    count = counted(group["positions"], "position")
    if group["reason"]:
        return f"{who}: {count}, no place among them: {group['reason']}"
    far = f", {group['far_off']} of them far off" if group["far_off"] else ""
    flat, high = group["rms_horizontal_m"], group["rms_vertical_m"]
    return f"{who}: {count}{far}, {flat:.2f} m horizontal and {high:.2f} m vertical (rms); trajectory_enu.tum"
