"""The known names nearest to an unknown one: "did you mean"."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher

UNKNOWN_NAME = "unknown_name"
"""Type of the ``PydanticCustomError`` by which a model's own check says that there is no such name."""
MOST = 3  # names proposed
_ALIKE = 0.6  # of the last parts of two names: share of letters in common, in order
_AS_GOOD = 0.15  # names that are alike by so much less than the best one are proposed beside it
_ALL_SHOWN = 12  # known names that are listed where none is near


def nearest(name: str, known: Iterable[str]) -> list[str]:
    """At most ``MOST`` of the ``known`` names, the likeliest first; empty where none is like ``name``.

    The last parts of names with dots must be alike; the sections before them say which is likelier: ``min-flow`` is
    near ``keyframes.min-flow``.
    """
    scores: dict[str, float] = {}
    for one in sorted(set(known)):
        last = _alike(_last(name), _last(one))
        if last >= _ALIKE:
            scores[one] = last + 0.5 * _alike(name, one)
    least = max(scores.values(), default=0.0) - _AS_GOOD
    return sorted((one for one in scores if scores[one] >= least), key=lambda one: -scores[one])[:MOST]


def hint(name: str, known: Iterable[str]) -> str:
    """``"; did you mean 'a' or 'b'?"``, nothing where no name is near: for a line that lists the known ones itself."""
    near = nearest(name, known)
    return f"; did you mean {' or '.join(repr(one) for one in near)}?" if near else ""


def did_you_mean(name: str, known: Iterable[str], what: str = "") -> str:
    """``"; did you mean 'a' or 'b'?"``; where no name is near, ``"; there are a, b, c"`` if they are few, else
    ``what``.
    """
    names = list(known)
    near = hint(name, names)
    if near:
        return near
    return f"; there are {', '.join(names)}" if 0 < len(names) <= _ALL_SHOWN else what


def _last(name: str) -> str:
    return name.rpartition(".")[2].lstrip("-")


def _alike(a: str, b: str) -> float:
    return SequenceMatcher(None, a, b, autojunk=False).ratio()
