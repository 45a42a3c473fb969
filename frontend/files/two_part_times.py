"""Times in two columns, as ROS writes them: whole seconds, and what is beyond them in a unit of its own."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .time_units import UNITS, NotATime, TimeUnit
from .timestamps import NS_PER_S

_FIRST_PART = re.compile(r"(sec|secs|seconds)(?![a-z])")
_PART_OF_ONE = re.compile(r"(nano|micro|milli|[num])\s?s(ec|econd)")
_SECOND_PARTS = {
    UNITS[3]: re.compile(r"(nsecs?|nanosecs?|nanoseconds)(?![a-z])"),
    UNITS[2]: re.compile(r"(usecs?|microsecs?|microseconds)(?![a-z])"),
    UNITS[1]: re.compile(r"(msecs?|millisecs?|milliseconds)(?![a-z])"),
}
_WHOLE = re.compile(r"(\d{1,12})(?:\.0*)?", re.ASCII)
_MOST_S = 2**33


@dataclass(frozen=True)
class TwoParts:
    """Columns of whole ``seconds`` and of the ``rest``, which is in ``unit``."""

    seconds: int
    rest: int
    unit: TimeUnit


def find_two_parts(headings: Sequence[str]) -> TwoParts | None:
    """The first columns that ``headings`` in lower case, such as ``header.stamp.sec`` and ``header.stamp.nanosec``,
    name so; None without both."""
    first = next((i for i, h in enumerate(headings) if _FIRST_PART.search(h) and not _PART_OF_ONE.search(h)), None)
    if first is None:
        return None
    for unit, words in _SECOND_PARTS.items():
        second = next((i for i, heading in enumerate(headings) if words.search(heading)), None)
        if second is not None:
            return TwoParts(first, second, unit)
    return None


def stamps_of_parts(rows: Sequence[Sequence[str]], parts: TwoParts) -> NDArray[np.int64]:
    """Nanoseconds ``(N,)`` of the cells of each row. :class:`NotATime` for the first one with anything but whole
    numbers in these columns, or with a second or more in the rest."""
    stamps = []
    for i, cells in enumerate(rows):
        whole, rest = (_WHOLE.fullmatch(cells[column].strip()) for column in (parts.seconds, parts.rest))
        if not whole or not rest or int(whole[1]) >= _MOST_S or int(rest[1]) * parts.unit.ns >= NS_PER_S:
            raise NotATime(i)
        stamps.append(int(whole[1]) * NS_PER_S + int(rest[1]) * parts.unit.ns)
    return np.array(stamps, dtype=np.int64)
