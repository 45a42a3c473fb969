"""Times as people write them: in seconds, milli-, micro- or nanoseconds, found by their rate, or as dates."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta, timezone
from decimal import Decimal
from itertools import pairwise
from statistics import median

import numpy as np
from numpy.typing import NDArray

from .timestamps import NS_PER_S

_DECIMAL = re.compile(r"([+-]?)(\d{1,40})(?:\.(\d*))?", re.ASCII)
_FLOAT = re.compile(r"[+-]?(?:\d{1,40}\.?\d{0,40}|\.\d{1,40})[eE][+-]?\d{1,2}", re.ASCII)
_DATE = re.compile(
    r"(\d{4})[-/]?(\d\d)[-/]?(\d\d)[ T_-](\d\d)[:-]?(\d\d)[:-]?(\d\d)(?:[.,_](\d{1,9}))?(?:Z|([+-])(\d\d):?(\d\d))?",
    re.ASCII,
)
_DAY_FIRST = re.compile(r"(\d\d)\.(\d\d)\.(\d{4})(?=[ T])", re.ASCII)
_CLOCK = re.compile(r"(\d{1,2}):(\d\d):(\d\d)(?:[.,](\d{1,9}))?", re.ASCII)
_DAY_S = 86400
_UNIX_S = (6e8, 5e9)  # 1989 to 2128: what is Unix time in one unit is so in no other
_POSSIBLE_HZ = (0.01, 1000.0)  # of a camera
_USUAL_HZ = (0.5, 500.0)  # a factor of 1000: exactly one unit brings any rate here
_DOUBTFUL_HZ = 200.0  # above this the next unit, at a thousandth, is as likely


@dataclass(frozen=True)
class TimeUnit:
    """``ns`` nanoseconds; ``name`` in the plural."""

    name: str
    ns: int


SECONDS = TimeUnit("seconds", NS_PER_S)
UNITS = (SECONDS, TimeUnit("milliseconds", 1_000_000), TimeUnit("microseconds", 1_000), TimeUnit("nanoseconds", 1))
_WORDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), UNITS[0]),
    **dict.fromkeys(("ms", "msec", "millis", "millisec", "milliseconds"), UNITS[1]),
    **dict.fromkeys(("us", "usec", "micros", "microsec", "microseconds"), UNITS[2]),
    **dict.fromkeys(("ns", "nsec", "nanos", "nanosec", "nanoseconds"), UNITS[3]),
}


class NotATime(ValueError):
    """Text ``index`` of those given is no time."""

    def __init__(self, index: int) -> None:
        super().__init__(f"text {index} is no time")
        self.index = index


@dataclass(frozen=True)
class Times:
    """``stamps_ns`` ``(N,)`` int64; ``doubt``: how the unit was taken where it is not certain, else empty; ``unit``:
    None of dates."""

    stamps_ns: NDArray[np.int64]
    doubt: str = ""
    unit: TimeUnit | None = None


def parse_times(texts: Sequence[str], unit: TimeUnit | None = None) -> Times:
    """Nanoseconds of times that are all written alike: as dates, or as numbers in ``unit``; None: the one that they
    must be in.

    Present-day Unix times tell their unit by their size; others by their rate, which a camera can have in one unit
    only, nearly always. Digits count as written, not as a float64 holds them. :class:`NotATime` for the first text
    that is none, and for times beyond 64 bits of nanoseconds.
    """
    if texts and is_time_of_day(texts[0]):
        return Times(_of_day(texts), "times of day without a date: counted from the first midnight")
    if texts and is_date(texts[0]):
        return Times(_bounded([date_ns(text, i) for i, text in enumerate(texts)]))
    numbers = [_billionths(text, i) for i, text in enumerate(texts)]
    doubt = ""
    if unit is None:
        unit, doubt = _unit_of(numbers)
    return Times(_bounded([number * unit.ns // NS_PER_S for number in numbers]), doubt, unit)


def _of_day(texts: Sequence[str]) -> NDArray[np.int64]:
    """Nanoseconds since the first midnight; where they begin anew, another day has begun."""
    stamps: list[int] = []
    days = 0
    for i, text in enumerate(texts):
        found = _CLOCK.fullmatch(text)
        if not found or int(found[1]) > 23 or max(int(found[2]), int(found[3])) > 59:
            raise NotATime(i)
        seconds = (int(found[1]) * 60 + int(found[2])) * 60 + int(found[3])
        stamp = (days * _DAY_S + seconds) * NS_PER_S + int(((found[4] or "") + "0" * 9)[:9])
        if stamps and stamp < stamps[-1] - _DAY_S * NS_PER_S // 2:
            days, stamp = days + 1, stamp + _DAY_S * NS_PER_S
        stamps.append(stamp)
    return np.array(stamps, dtype=np.int64)


def date_ns(text: str, index: int = 0) -> int:
    """Nanoseconds since 1970 of ``2011-09-26 13:02:25.964389445``, ``20110926_130225_964``, ``26.09.2011 13:02:25``
    and the like; UTC where no zone is named."""
    found = _DATE.fullmatch(_DAY_FIRST.sub(r"\3-\2-\1", text))
    if not found:
        raise NotATime(index)
    *parts, fraction, sign, hours, minutes = found.groups()
    zone = (
        UTC
        if sign is None
        else timezone((1 if sign == "+" else -1) * timedelta(hours=int(hours), minutes=int(minutes)))
    )
    try:
        moment = datetime(*map(int, parts), tzinfo=zone)  # type: ignore[arg-type,misc]
    except ValueError:
        raise NotATime(index) from None
    since = moment - datetime(1970, 1, 1, tzinfo=UTC)
    return (since.days * _DAY_S + since.seconds) * NS_PER_S + int(((fraction or "") + "0" * 9)[:9])


def is_date(text: str) -> bool:
    """Whether the whole text is a date with a time of day."""
    return _DATE.fullmatch(_DAY_FIRST.sub(r"\3-\2-\1", text)) is not None


def is_time_of_day(text: str) -> bool:
    """Whether the whole text is hours, minutes and seconds."""
    return _CLOCK.fullmatch(text) is not None


def unit_of_heading(heading: str) -> TimeUnit | None:
    """The unit that a column's heading names: ``timestamp [ns]``, ``time(s)``, ``t_us``; None where it names none."""
    words = [word for word in re.split(r"[^a-z]+", heading.lower()) if word]
    return next((_WORDS[word] for word in reversed(words) if word in _WORDS), None)


def _billionths(text: str, index: int) -> int:
    """A number times 10^9, cut off below that."""
    found = _DECIMAL.fullmatch(text)
    if found:
        sign, whole, fraction = found.groups()
        number = int(whole) * NS_PER_S + int(((fraction or "") + "0" * 9)[:9])
        return -number if sign == "-" else number
    if not _FLOAT.fullmatch(text) or abs(float(text)) >= 2**63:
        raise NotATime(index)
    return int(Decimal(text) * NS_PER_S)


def _bounded(stamps_ns: list[int]) -> NDArray[np.int64]:
    for i, stamp in enumerate(stamps_ns):
        if abs(stamp) >= 2**63:
            raise NotATime(i)
    return np.array(stamps_ns, dtype=np.int64)


def _unit_of(numbers: list[int]) -> tuple[TimeUnit, str]:
    """The unit of times given as numbers of 10^-9, and what makes it doubtful. Rows may be out of order."""
    if sum(after < before for before, after in pairwise(numbers)) * 4 > len(numbers):
        numbers = sorted(numbers)
    steps = [after - before for before, after in pairwise(numbers) if after > before]
    step = median(steps) / NS_PER_S if steps else 0.0
    rates = {unit: NS_PER_S / (step * unit.ns) if step else 0.0 for unit in UNITS}
    unix = [unit for unit in UNITS if numbers and is_unix_s(numbers[0] * unit.ns / NS_PER_S**2)]
    possible = [unit for unit in UNITS if _POSSIBLE_HZ[0] <= rates[unit] <= _POSSIBLE_HZ[1]]
    by_size = [unit for unit in unix if unit in possible or not possible]
    if by_size:
        return by_size[0], ""
    usual = next((unit for unit in possible if _USUAL_HZ[0] <= rates[unit] < _USUAL_HZ[1]), None)
    if usual is None or (usual is SECONDS and not _counts(numbers, step)):
        return SECONDS, ""
    if usual is SECONDS:
        return SECONDS, "times count 1, 2, 3: seconds are taken, one image a second; are they numbers of images?"
    coarser = UNITS[UNITS.index(usual) - 1]
    unit = SECONDS if coarser is SECONDS and rates[usual] > _DOUBTFUL_HZ else usual
    other = usual if unit is coarser else coarser
    return unit, (
        f"times are taken as {unit.name} by their rate: {rates[unit]:.4g} images per second; "
        f"as {other.name} there would be {rates[other]:.4g}"
    )


def is_unix_s(seconds: float) -> bool:
    """Whether seconds since 1970 are of our days."""
    return _UNIX_S[0] <= seconds < _UNIX_S[1]


def _counts(numbers: list[int], step: float) -> bool:
    """Whether numbers go up by one, from 0 or 1."""
    return len(numbers) > 2 and step == 1.0 and numbers[0] in (0, NS_PER_S) and not any(n % NS_PER_S for n in numbers)
