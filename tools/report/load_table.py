"""Table of what each agent carried of the team's work."""

from __future__ import annotations

from html import escape

from .html import table
from .run_data import RunData


def load_table(run: RunData) -> str:
    """Bytes in and out and turns of each agent; empty for a run before they were counted."""
    load = run.summary.get("load") or []
    if not load:
        return ""
    names = {agent.index: agent.name for agent in run.agents}
    cpu_s = run.timing.get("agents_cpu_s") or []
    head = ["agent", "bytes out", "bytes in", "solver turns", "directory turns"]
    rows = [
        [
            escape(names.get(me, f"agent {me}")),
            *(f"{one[name]:,}" for name in ("bytes_out", "bytes_in", "solver_turns", "directory_turns")),
            *([f"{cpu_s[me]:.1f} s"] if cpu_s else []),
        ]
        for me, one in enumerate(load)
    ]
    return table([*head, "CPU time"] if cpu_s else head, rows)
