"""Settings of an earlier result in the folder for a new one: where they are others, it is not replaced unasked."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from .errors import EarlierResultError

_SHOWN = 4
CURE = "choose another folder, or replace it with --overwrite"


def refuse_changed(out: Path, what: str, earlier: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    """:class:`EarlierResultError` where ``out``, which holds ``what`` (for people), was made with ``earlier`` settings
    other than those of ``now``. A setting that an earlier version did not have has its default."""
    changed = _changed(earlier, now)
    if changed:
        more = f" and {len(changed) - _SHOWN} more" if len(changed) > _SHOWN else ""
        raise EarlierResultError(
            f"{out}: holds {what} with other settings ({', '.join(changed[:_SHOWN])}{more}); {CURE}"
        )


def _changed(earlier: Mapping[str, Any], now: Mapping[str, Any], before: str = "") -> list[str]:
    """Dotted names of what differs."""
    out = []
    for name, value in now.items():
        if name not in earlier:
            continue
        there = earlier[name]
        if isinstance(value, Mapping) and isinstance(there, Mapping):
            out += _changed(there, value, f"{before}{name}.")
        elif there != value:
            out.append(f"{before}{name}")
    return out
