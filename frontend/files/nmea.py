"""NMEA 0183 sentences of a GPS receiver: GGA positions, dates of RMC or ZDA, noise of GST or by quality and HDOP."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from datetime import date
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from .geodetic_fixes import UP, GeodeticFixes
from .text_tables import read_bytes
from .timestamps import NS_PER_S

_SENTENCE = re.compile(r"[$!](?P<body>[A-Z0-9]{2,3}[A-Z]{3},[^*$!]*)(\*(?P<sum>[0-9A-Fa-f]{2}))?")
_CLOCK = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d+))?", re.ASCII)
_DAY_NS = 86400 * NS_PER_S
_NO_DATE = "no date in it (RMC, ZDA): times count from midnight, UTC"
_SHARE = {1: 1.0, 2: 0.5, 3: 0.5, 4: 0.01, 5: 0.1, 8: 1.0}
"""Noise of a fix by its quality, as a share of a plain one's: plain, differential, precise, RTK fixed, RTK float,
simulated. Others measure nothing: none, dead reckoning, typed in."""
_LEAST_M = 0.01


@dataclass(frozen=True)
class _Fix:
    clock_ns: int
    line: int
    place: tuple[float, float, float]
    sigma: tuple[float, float, float]


def is_nmea(path: Path) -> bool:
    """Whether the file's first sentences are NMEA."""
    with open(path, "rb") as file:
        head = file.read(4096).decode("ascii", "replace")
    return any(_SENTENCE.search(line) for line in head.splitlines()[:20])


def read_nmea(path: Path, sigma_m: float) -> GeodeticFixes:
    """The fixes of a log. ``sigma_m``: standard deviation of each horizontal axis of a plain fix at HDOP 1.

    Sentences whose checksum is wrong, and GGA without a measured position, are left out and counted.
    :class:`FrontendError` where no fix is left.
    """
    fixes: list[_Fix] = []
    dates: list[tuple[int, int]] = []  # line, nanoseconds since 1970
    noise: dict[int, tuple[float, float, float]] = {}
    left_out: Counter[tuple[str, str]] = Counter()  # what, in the singular and the plural
    text = read_bytes(path).decode("ascii", "replace")
    for line, raw in enumerate(text.splitlines(), 1):
        found = _SENTENCE.search(raw)
        if found is None:
            left_out["line without a sentence", "lines without a sentence"] += bool(raw.strip())
            continue
        if found["sum"] and reduce(xor, found["body"].encode(), 0) != int(found["sum"], 16):
            left_out["sentence with a wrong checksum", "sentences with a wrong checksum"] += 1
            continue
        fields = found["body"].split(",")
        kind = fields[0][-3:]
        try:
            if kind in ("RMC", "ZDA"):
                dates += [(line, ns) for ns in _moment(kind, fields)]
            elif kind == "GST" and all(fields[6:9]):
                noise[_clock_ns(fields[1])] = (float(fields[7]), float(fields[6]), float(fields[8]))
            elif kind == "GGA":
                fix = _fix(fields, line, sigma_m)
                fixes += [fix] if fix else []
                left_out["GGA without a measured position", "GGA without a measured position"] += fix is None
        except (ValueError, IndexError):
            raise FrontendError(f"{path}:{line}: no {kind} sentence: {raw.strip()[:60]!r}") from None
    if not fixes:
        raise FrontendError(f"{path}: no GGA sentence with a position")
    notes = [f"{count} {what[count > 1]} left out" for what, count in sorted(left_out.items()) if count]
    sigma = [noise.get(fix.clock_ns, fix.sigma) for fix in fixes]
    return GeodeticFixes(
        stamps_ns=_stamps(fixes, dates),
        geodetic=np.array([fix.place for fix in fixes]),
        sigma=np.maximum(np.array(sigma), _LEAST_M),
        lines=[fix.line for fix in fixes],
        notes=(*notes, *([] if dates else [_NO_DATE])),
    )


def _fix(fields: list[str], line: int, sigma_m: float) -> _Fix | None:
    """Of a GGA sentence; None where it has no measured position."""
    quality = int(fields[6] or 0)
    if quality not in _SHARE or not fields[2] or not fields[4]:
        return None
    # Altitudes are above the sea, the geoid's height is above the ellipsoid.
    height = float(fields[9] or 0.0) + float(fields[11] or 0.0)
    place = _degrees(fields[2], fields[3], "NS"), _degrees(fields[4], fields[5], "EW"), height
    flat = sigma_m * _SHARE[quality] * (float(fields[8]) if fields[8] else 1.0)
    if not np.isfinite([*place, flat]).all() or abs(place[0]) > 90 or abs(place[1]) > 180 or flat <= 0:
        raise ValueError
    return _Fix(_clock_ns(fields[1]), line, place, (flat, flat, UP * flat))


def _degrees(text: str, side: str, sides: str) -> float:
    """Of degrees and minutes in one number, ``4807.038``, and the side that they count to."""
    whole, minutes = divmod(float(text), 100.0)
    if side not in sides or len(side) != 1 or minutes >= 60:
        raise ValueError
    return (whole + minutes / 60.0) * (1.0 if side == sides[0] else -1.0)


def _clock_ns(text: str) -> int:
    found = _CLOCK.fullmatch(text)
    if not found:
        raise ValueError
    hours, minutes, seconds, fraction = found.groups()
    return (int(hours) * 3600 + int(minutes) * 60 + int(seconds)) * NS_PER_S + int(((fraction or "") + "0" * 9)[:9])


def _moment(kind: str, fields: list[str]) -> list[int]:
    """Date and time of day of a sentence, as nanoseconds since 1970; none where the receiver did not know it yet."""
    if kind == "RMC":
        day = fields[9]
        if not fields[1] or not day or fields[2] == "V":
            return []
        year, month, number = int(day[4:6]), int(day[2:4]), int(day[:2])
        year += 2000 if year < 80 else 1900
    else:
        if not all(fields[1:5]):
            return []
        number, month, year = (int(text) for text in fields[2:5])
    return [(date(year, month, number) - date(1970, 1, 1)).days * _DAY_NS + _clock_ns(fields[1])]


def _stamps(fixes: list[_Fix], dates: list[tuple[int, int]]) -> NDArray[np.int64]:
    """Each fix on the day that brings it nearest to the dated sentence nearest to it in the file; without any, days
    are counted from the first."""
    clocks = np.array([fix.clock_ns for fix in fixes], dtype=np.int64)
    if not dates:
        return clocks + _DAY_NS * np.concatenate([[0], np.cumsum(np.diff(clocks) < -_DAY_NS // 2)])
    lines, moments = np.array(dates, dtype=np.int64).T
    at = np.array([fix.line for fix in fixes])
    right = np.clip(np.searchsorted(lines, at), 1, max(len(lines) - 1, 1)).clip(max=len(lines) - 1)
    left = np.maximum(right - 1, 0)
    near = moments[np.where(at - lines[left] <= lines[right] - at, left, right)]
    return clocks + _DAY_NS * np.rint((near - clocks) / _DAY_NS).astype(np.int64)
