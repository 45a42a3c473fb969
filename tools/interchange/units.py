"""The unit of length of each agent's results."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ..report.run_data import RunData

METRES, ARBITRARY = "metres", "arbitrary"


def unit_of(data: RunData, agent: int) -> str:
    """Metres where the agent's group has a camera that measures them, else a unit of its own."""
    group = next(group for group in data.groups if agent in group)
    return METRES if any(data.manifest.agents[a].metric for a in group) else ARBITRARY


def agent_records(data: RunData, members: Sequence[int]) -> list[dict[str, Any]]:
    """What ``export.json`` says of each agent: its name, source, frame and unit."""
    out = []
    for a in members:
        entry = data.manifest.agents[a]
        group = next(number for number, group in enumerate(data.groups) if a in group)
        out.append({"name": entry.name, "sequence": entry.sequence, "group": group, "unit": unit_of(data, a)})
    return out
