"""Settings of version 0.1 and their changes since.

A settings file of 0.1 is read, with a line that says what has another name now and what is gone; an option of 0.1 is
refused in a line that names the new word.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .errors import ToolError

log = logging.getLogger(__name__)
_NAMED = 3  # settings that the line names; the rest is counted


@dataclass(frozen=True)
class Renamed:
    """``to``: the whole name today; ``values``: words of a choice that are others today."""

    to: str
    values: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Removed:
    """``why``: what a user should know who had set it."""

    why: str


Fate = Renamed | Removed
SETTINGS_OF_0_1: dict[str, Fate] = {
    "odometry.features.min_distance_px": Removed("it had no effect"),
    "odometry.seed": Removed("it had no effect"),
    "relpose.max_scale": Removed("relpose.max_distance_ratio bounds distances, whatever the units"),
    "merge.edition_keyframes": Renamed("merge.version_keyframes"),
    "standing": Renamed("reputation"),
    "standing.honesty": Renamed("reputation.consistency"),
}
"""By the whole name in a file, ``relpose.min_inliers``; the name of a section stands for all settings below it that
have no entry of their own."""


def fate(name: str, table: Mapping[str, Fate] = SETTINGS_OF_0_1) -> Fate | None:
    """The change of the setting ``name`` of 0.1; None: unchanged, or there never was one."""
    section, rest = name, ""
    while section not in table:
        section, dot, last = section.rpartition(".")
        if not dot:
            return None
        rest = f".{last}{rest}"
    found = table[section]
    return Renamed(found.to + rest) if rest and isinstance(found, Renamed) else found


def modernised(content: dict[str, Any], origin: Path, table: Mapping[str, Fate] = SETTINGS_OF_0_1) -> dict[str, Any]:
    """``content`` of the settings file ``origin`` under today's names; logs a line where that changes anything.

    ``ToolError`` where a setting is there under both of its names.
    """
    settings = dict(_flat(content))
    fates = {name: found for name in settings if (found := fate(name, table)) is not None}
    if not fates:
        return content
    today: dict[str, Any] = {}
    for name, value in settings.items():
        match fates.get(name):
            case Removed():
                continue
            case Renamed(to, values):
                if to in settings and to != name:
                    raise ToolError(f"{origin}: '{name}' is called '{to}' today, and both are in the file")
                _put(today, to, values.get(value, value) if isinstance(value, str) else value, origin)
            case None:
                _put(today, name, value, origin)
    log.warning("%s: settings of version 0.1: %s", origin, "; ".join(_changes(fates)))
    return today


def _changes(fates: Mapping[str, Fate]) -> Iterator[str]:
    renamed = [f"{name} is now {one.to}" for name, one in fates.items() if isinstance(one, Renamed) and one.to != name]
    removed = [f"{name} is gone ({one.why})" for name, one in fates.items() if isinstance(one, Removed)]
    for lines in (renamed, removed):
        if lines:
            yield ", ".join(lines[:_NAMED]) + (f" and {len(lines) - _NAMED} more" if len(lines) > _NAMED else "")


def _flat(content: Mapping[str, Any], section: str = "") -> Iterator[tuple[str, Any]]:
    """Whole name and value of each setting; a mapping whose keys are no words is a value."""
    for key, value in content.items():
        name = f"{section}.{key}" if section else str(key)
        if isinstance(value, Mapping) and value and all(isinstance(one, str) for one in value):
            yield from _flat(value, name)
        else:
            yield name, value


def _put(content: dict[str, Any], name: str, value: Any, origin: Path) -> None:
    *sections, last = name.split(".")
    for section in sections:
        content = content.setdefault(section, {})
        if not isinstance(content, dict):
            raise ToolError(f"{origin}: {section}: expected keys and values")
    content[last] = value
