"""Robust selections that nothing in a group's graph decides, in words: for the console and the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from .html import Section

# Lines; summary.json has all.
_LINES = 5


def undecided_warnings(summary: Mapping[str, Any]) -> list[str]:
    """A warning for each group of agents that could as well stand elsewhere, by the last optimisations; none where
    matches decide."""
    found = (summary.get("optimisations") or {}).get("undecided") or []
    lines = [_line(one) for one in found[:_LINES]]
    more = len(found) - len(lines)
    if more:
        lines.append(f"warning: undecided in {more} more ways: optimisations.undecided in summary.json")
    return lines


def undecided_sections(summary: Mapping[str, Any]) -> list[Section]:
    """The report's part on them; none where matches decide."""
    lines = "".join(f"<li>{escape(line)}</li>" for line in undecided_warnings(summary))
    note = "About as many matches speak for another place of these agents as for the one that they were given. Do not "
    note += "rely on where they stand before more matches decide it."
    return [Section("Matches that nothing decides between", note, f"<ul>{lines}</ul>")] if lines else []


def _line(one: Mapping[str, Any]) -> str:
    agents = [f"agent_{agent:02d}" for agent in one["agents"]]
    whose = f"{' '.join(agents)} {'stands' if len(agents) == 1 else 'stand'}"
    return (
        f"warning: undecided where {whose}: {_named(one['kept'])} kept, {_named(one['rejected'])} rejected; "
        "wrong ones may have been kept"
    )


def _named(matches: Sequence[str]) -> str:
    return f"1 match ({matches[0]})" if len(matches) == 1 else f"{len(matches)} matches ({matches[0]}, …)"
