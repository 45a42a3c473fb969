"""The nearest known names to one that nobody knows: "did you mean"."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

MOST = 3  # names proposed
_ALL_SHOWN = 12  # known names that are listed where none is near


def nearest(name: str, known: Iterable[str]) -> list[str]:
    """At most ``MOST`` of the ``known`` names, the likeliest first; empty where none is like ``name``.

    Names with dots are compared as a whole and by their ends: ``min-flow`` is near ``keyframes.min-flow``.
    """
    names = sorted(set(known))
    last = name.rpartition(".")[2].lstrip("-")
    same_end = [one for one in names if one.endswith(f".{name.lstrip('-')}")]
    alike = difflib.get_close_matches(name, names, MOST, cutoff=0.7)
    ends: dict[str, list[str]] = {}
    for one in names:
        ends.setdefault(one.rpartition(".")[2].lstrip("-"), []).append(one)
    by_end = [one for end in difflib.get_close_matches(last, ends, MOST, cutoff=0.8) for one in ends[end]]
    return list(dict.fromkeys([*same_end, *alike, *by_end]))[:MOST]


def did_you_mean(name: str, known: Iterable[str], what: str = "") -> str:
    """``"; did you mean 'a' or 'b'?"``; where no name is near, ``"; there are a, b, c"`` if they are few, else
    ``what``.
    """
    names = list(known)
    near = nearest(name, names)
    if near:
        return f"; did you mean {' or '.join(repr(one) for one in near)}?"
    return f"; there are {', '.join(names)}" if 0 < len(names) <= _ALL_SHOWN else what
