"""Times in the names of image files: which part of a name is one, in which unit, and in which order the files come."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..files.time_units import UNITS, NotATime, date_ns, is_unix_s, parse_times
from ..files.timestamps import NS_PER_S

_UNIX = re.compile(r"(?<!\d)(?:(\d{10})[._-](\d{1,9})|(\d{13}|\d{16}|\d{19})|(\d{10}))(?!\d)", re.ASCII)
_DATE = re.compile(r"(?<!\d)\d{4}-?\d\d-?\d\d[ T_-]\d\d[:-]?\d\d[:-]?\d\d(?:[.,_]\d{1,9})?(?!\d)", re.ASCII)
_SECONDS = re.compile(r"\d+\.\d+", re.ASCII)
_WHOLE = re.compile(r"\d{1,18}", re.ASCII)
_UNIT_OF_DIGITS = {13: UNITS[1], 16: UNITS[2], 19: UNITS[3], 10: UNITS[0]}
_COUNTED = 5000
"""Names that are numbers in smaller steps count images; in larger ones they are microseconds or nanoseconds."""
_EVEN = 0.5
"""Share of the unevenness of its steps that a reading of the names leaves: the right one leaves far less."""


@dataclass(frozen=True)
class NamedTimes:
    """``stamps_ns`` ``(N,)``, in the order of the names; ``doubt``: what to know about how they were read."""

    stamps_ns: NDArray[np.int64]
    doubt: str = ""


def times_of_names(stems: Sequence[str]) -> NamedTimes | None:
    """The times that all names (without suffix) hold, else None: numbers of images are no times.

    Read are seconds with decimals, Unix times in seconds and nanoseconds (``1700000000_033333333``), whole ones in any
    unit, dates with a time of day, each with other text around it; and whole numbers in large steps.
    """
    if not stems:
        return None
    try:
        return _seconds(stems) or _dates(stems) or _unix(stems) or _whole(stems)
    except NotATime:
        return None


def _seconds(stems: Sequence[str]) -> NamedTimes | None:
    if not all(_SECONDS.fullmatch(stem) for stem in stems):
        return None
    return _with_fractions([tuple(stem.split(".")) for stem in stems], stems)


def _dates(stems: Sequence[str]) -> NamedTimes | None:
    found = [_DATE.findall(stem) for stem in stems]
    if any(len(one) != 1 for one in found):
        return None
    try:
        stamps = np.array([date_ns(one[0]) for one in found], dtype=np.int64)
    except NotATime:
        return None
    return NamedTimes(stamps) if len(set(stamps.tolist())) == len(stems) else None  # days alone are no times


def _unix(stems: Sequence[str]) -> NamedTimes | None:
    found = [_UNIX.findall(stem) for stem in stems]
    if any(len(one) != 1 for one in found):
        return None
    if all(one[0][0] and is_unix_s(int(one[0][0])) for one in found):
        return _with_fractions([(one[0][0], one[0][1]) for one in found], stems)
    texts = [one[0][2] or one[0][3] for one in found]
    units = {_UNIT_OF_DIGITS.get(len(text)) for text in texts}
    unit = units.pop() if len(units) == 1 else None
    if unit is None or len(set(texts)) < len(texts):
        return None
    stamps = parse_times(texts, unit).stamps_ns
    return NamedTimes(stamps) if all(is_unix_s(stamp / NS_PER_S) for stamp in stamps.tolist()) else None


def _whole(stems: Sequence[str]) -> NamedTimes | None:
    """Whole numbers that go up by thousands: of what counts so, one unit alone is a camera's."""
    if len(stems) < 3 or not all(_WHOLE.fullmatch(stem) for stem in stems):
        return None
    numbers = np.sort(np.array([int(stem) for stem in stems], dtype=np.int64))
    if np.median(np.diff(numbers)) < _COUNTED:
        return None
    texts = [str(number) for number in numbers.tolist()]
    read = parse_times(texts)
    rows = np.searchsorted(numbers, np.array([int(stem) for stem in stems], dtype=np.int64))
    return NamedTimes(read.stamps_ns[rows], read.doubt and f"names are taken as times: {read.doubt}")


def _with_fractions(parts: Sequence[tuple[str, ...]], stems: Sequence[str]) -> NamedTimes:
    """Seconds and what stands behind the point: decimals, or nanoseconds whose zeros in front were left out. Where
    lengths differ both can be meant; the steps of a camera are even in one reading only."""
    decimals = np.array([int(s) * NS_PER_S + int((f + "0" * 9)[:9]) for s, f in parts], dtype=np.int64)
    lengths = [len(fraction) for _, fraction in parts]
    if len(set(lengths)) == 1 or max(lengths) != 9:
        return NamedTimes(decimals)
    counted = np.array([int(s) * NS_PER_S + int(f) for s, f in parts], dtype=np.int64)
    if _unevenness(counted) >= _EVEN * _unevenness(decimals):
        return NamedTimes(decimals)
    short = int(np.argmin(lengths))
    return NamedTimes(
        counted,
        f"names are read as seconds and nanoseconds without leading zeros ({stems[short]} is "
        f"{int(parts[short][1]) / 1e9:.9f} s after {parts[short][0]} s): as decimals they would jump",
    )


def _unevenness(stamps_ns: NDArray[np.int64]) -> float:
    """Mean difference of the steps, in order of time, from their median, as a share of it."""
    steps = np.diff(np.sort(stamps_ns)).astype(np.float64)
    usual = float(np.median(steps)) if len(steps) else 0.0
    return float(np.abs(steps - usual).mean() / usual) if usual > 0 else np.inf
