"""Tables of positions with a heading: which column is what, and rows that hold no position."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from .geodetic_fixes import UP
from .headed_table import decimal_points
from .position_units import in_metres_and_degrees
from .text_tables import read_bytes
from .time_units import TimeUnit, date_ns, is_date, unit_of_heading
from .timestamps import NS_PER_S, decimal_ns
from .two_part_times import find_two_parts

_AXES = {"east": "e|east|x|lon", "north": "n|north|y|lat", "up": "u|up|z|alt"}
_CELLS = {"east": "0|00|xx|ee|e|east|x", "north": "4|11|yy|nn|n|north|y", "up": "8|22|zz|uu|u|up|z"}
_NAMES = {
    # A message's own time goes before the one at which it was written down.
    "stamp": r"header_stamp(_(ns|time))?",
    "stamp_s": r"header_stamp_(sec|secs)",
    "stamp_ns": r"header_stamp_(nsec|nsecs|nanosec)",
    "time": r"(t|time|timestamp|stamp|sec|seconds|utc|date|datetime)(_\w*)?",
    "lat": r"lat(itude)?(_\w*|e7)?",
    "lon": r"(lon|lng|longitude)(_\w*|e7)?",
    "alt": r"(alt|altitude|height|ele|elevation)(_\w*)?",
    "east": r"(e|east|x|easting)(_[mck]?m)?",
    "north": r"(n|north|y|northing)(_[mck]?m)?",
    "up": r"(u|up|z)(_[mck]?m)?",
    **{f"sigma_{axis}": rf"(sigma|std)_({word})(_[mck]?m)?" for axis, word in _AXES.items()},
    **{f"variance_{axis}": rf"(position_)?(cov|covariance|var|variance)_?({w})(_m2)?" for axis, w in _CELLS.items()},
    "sigma_flat": r"(sigma|std)_h(orizontal)?(_[mck]?m)?|horizontal_?accuracy(_[mck]?m)?|h_?acc(_[mck]?m)?|eph",
    "sigma_height": r"(sigma|std)_v(ertical)?(_[mck]?m)?|vertical_?accuracy(_[mck]?m)?|v_?acc(_[mck]?m)?|epv",
    "sigma": r"(sigma|std|accuracy)(_[mck]?m)?",
    "hdop": r"hdop",
    "known": r"position_covariance_type|covariance_type",
    "status": r"(status_)?status|fix_status",
    "quality": r"(fix_)?quality|fix_type",
    "antenna_x": r"antenna_x(_[mck]?m)?",
    "antenna_y": r"antenna_y(_[mck]?m)?",
    "antenna_z": r"antenna_z(_[mck]?m)?",
}
MEANT = "columns with a header: time, then lat lon alt (degrees, metres) or east north up (metres), and sigma if known"
_UNITS = ((1e17, 1.0), (1e14, 1e3), (1e11, 1e6))
"""Sizes from which a time of today's clock is in nano-, micro- or milliseconds, and nanoseconds a unit."""
_TIMES = ("time", "stamp", "stamp_s", "stamp_ns")
_HEAD = 2000  # characters in which a file says what it is


@dataclass(frozen=True, eq=False)
class PositionTable:
    """N rows: ``stamps_ns`` ``(N,)``, the numbers of each known column by its name, the ``lines`` they stand on;
    ``notes``: what was left out."""

    stamps_ns: NDArray[np.int64]
    column: dict[str, NDArray[np.float64]]
    lines: list[int]
    notes: tuple[str, ...]

    def sigma(self, path: Path, sigma_m: float) -> NDArray[np.float64]:
        """Standard deviations ``(N, 3)`` of east, north and up, metres: from variances, else deviations of each axis,
        of the plane and the height, of all axes, or ``sigma_m`` times HDOP. :class:`FrontendError` with the line where
        one is not above 0."""
        one = self.column
        plain = np.full(len(self.lines), sigma_m) * one.get("hdop", np.ones(len(self.lines)))
        flat = one.get("sigma_flat", one.get("sigma", plain))
        doubled = "sigma_height" not in one and ("hdop" in one or "sigma_flat" in one) and "sigma" not in one
        high = one.get("sigma_height", UP * flat if doubled else one.get("sigma", plain))
        out = np.column_stack([one.get(f"sigma_{a}", d) for a, d in (("east", flat), ("north", flat), ("up", high))])
        given = [one.get(f"variance_{axis}") for axis in _AXES]
        if all(variance is not None for variance in given):
            variance = np.column_stack([v for v in given if v is not None])
            known = one.get("known", (variance != 0).any(axis=1)) != 0
            self._check(path, "variance", "m2", np.where(known[:, None], variance, 1.0))
            out = np.where(known[:, None], np.sqrt(np.where(known[:, None], variance, 1.0)), out)
        self._check(path, "standard deviation", "m", out)
        return np.asarray(out)

    def _check(self, path: Path, what: str, unit: str, values: NDArray[np.float64]) -> None:
        for row in np.flatnonzero(~((values > 0) & np.isfinite(values)).all(axis=1))[:1]:
            raise FrontendError(
                f"{path}:{self.lines[row]}: a {what} of {values[row].min():g} {unit}; above 0 {unit} is meant"
            )


def read_position_table(path: Path) -> PositionTable:
    """The rows of a table with a heading, or of TUM lines. :class:`FrontendError` with file and line for what is no
    such table."""
    names, headings, rows, lines = _rows(path)
    if not names or not set(_TIMES) & set(names) or not _has_place(names):
        raise FrontendError(f"{path}: no positions: {MEANT}")
    kept, left_out = [], Counter[str]()
    for row, line in zip(rows, lines, strict=True):
        why = _without_position(path, dict(zip(names, row, strict=True)), line)
        left_out[why] += bool(why)
        kept += [] if why else [(row, line)]
    if not kept:
        raise FrontendError(f"{path}: no positions in this file")
    chosen, lines = [row for row, _ in kept], [line for _, line in kept]
    columns = {name: [row[k] for row in chosen] for k, name in enumerate(names) if name}
    called = {name: heading for name, heading in zip(names, headings, strict=True) if name}
    stamps = _stamps(path, columns, {name: unit_of_heading(called[name]) for name in called}, lines)
    written = {name: texts for name, texts in columns.items() if name not in _TIMES}
    numbers, said = in_metres_and_degrees(written, called)
    notes = tuple(f"{count} row{'s' * (count > 1)} {why} left out" for why, count in sorted(left_out.items()) if count)
    return PositionTable(stamps, numbers, lines, (*notes, *said))


def _has_place(names: list[str]) -> bool:
    return {"lat", "lon"} <= set(names) or {"east", "north"} <= set(names)


def _rows(path: Path) -> tuple[list[str], list[str], list[list[str]], list[int]]:
    """Names of the columns ("" where not known), their headings, the fields of each row, and line numbers."""
    names: list[str] = []
    called: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    mark: str | None = None  # by the first line
    text = read_bytes(path).removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
    if text.lstrip().startswith("<"):
        form = "KML" if "<kml" in text[:_HEAD].lower() else "XML"
        raise FrontendError(f"{path}: a {form} file, which is not read; write its points as a table: {MEANT}")
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip(" \t,;"):
            continue
        mark = _mark(line) if mark is None else mark
        fields = _fields(line, mark)
        if not rows and not _is_number(fields[0]) and not is_date(fields[0]):
            headings = fields if fields[0] not in ("#", "%") else fields[1:]
            found = _named(path, number, headings)
            if set(_TIMES) & set(found):
                names, called = found, headings
            continue
        if not names and len(fields) == 8:
            names = ["time", "east", "north", "up", "", "", "", ""]
            called = [""] * 8
        if not names:
            raise FrontendError(f"{path}:{number}: no header that names the columns; {MEANT}")
        if len(fields) != len(names):
            raise FrontendError(f"{path}:{number}: not {len(names)} numbers: {line.strip()[:60]!r}")
        rows.append(fields)
        lines.append(number)
    return names, called, rows, lines


def _mark(heading: str) -> str:
    """What alone separates fields, where commas are decimal ones: in a heading they then separate nothing; else ""."""
    return next((mark for mark in (";", "\t") if mark in heading and "," not in heading), "")


def _fields(line: str, mark: str) -> list[str]:
    if mark:
        return decimal_points([field.strip().strip("\"'") for field in line.split(mark)])
    return [f.strip().strip("\"'") for f in re.split(r"[,;]", line)] if re.search("[,;]", line) else line.split()


def _named(path: Path, line: int, headings: list[str]) -> list[str]:
    """What each column is, "" where that is not known or another one says it better."""
    names = [_name_of(heading) for heading in headings]
    parts = find_two_parts([heading.lower() for heading in headings])
    if parts is not None and parts.unit.ns == 1 and "stamp" not in names:
        names[parts.seconds], names[parts.rest] = "stamp_s", "stamp_ns"
    if "stamp" in names or {"stamp_s", "stamp_ns"} <= set(names):
        names = ["" if name == "time" else name for name in names]
    for name in filter(None, names):
        if names.count(name) > 1 and name != "time":
            same = [heading for heading, one in zip(headings, names, strict=True) if one == name]
            raise FrontendError(f"{path}:{line}: columns {' and '.join(same)} both say {name}; leave one")
    if names.count("time") > 1:  # "time" goes before "date", "sec" before "utc", and so on: the first one counts
        first = names.index("time")
        names = ["" if name == "time" and k != first else name for k, name in enumerate(names)]
    return names


def _name_of(heading: str) -> str:
    plain = heading.lower().removeprefix("%").removeprefix("#").removeprefix("field.").strip()
    plain = re.split(r"\s*[(\[](?!\d)", plain)[0]  # units, but not the number of a cell
    plain = re.sub(r"[^a-z0-9]+", "_", plain).strip("_")
    return next((name for name, pattern in _NAMES.items() if re.fullmatch(pattern, plain)), "")


def _without_position(path: Path, row: dict[str, str], line: int) -> str:
    """Why a row holds no position, empty where it holds one; :class:`FrontendError` for what is no number."""
    for name, text in row.items():
        if name and not (_is_number(text) or (name == "time" and is_date(text)) or text.lower() in ("nan", "")):
            raise FrontendError(f"{path}:{line}: not {len(row)} numbers: {name} is {text[:40]!r}")
    status, quality = row.get("status", ""), row.get("quality", "")
    if (_is_number(status) and float(status) < 0) or (_is_number(quality) and float(quality) == 0):
        return "without a fix"
    if any(not _is_number(row[name]) for name in ("lat", "lon", "alt", "east", "north", "up") if name in row):
        return "without a position"
    for name, text in row.items():
        if name and not _is_number(text) and not is_date(text) and name not in ("status", "quality"):
            raise FrontendError(f"{path}:{line}: not {len(row)} numbers: {name} is {text[:40]!r}")
    return ""


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _stamps(
    path: Path, columns: dict[str, list[str]], units: dict[str, TimeUnit | None], lines: list[int]
) -> NDArray[np.int64]:
    try:
        if "stamp" not in columns and {"stamp_s", "stamp_ns"} <= set(columns):
            parts = zip(columns["stamp_s"], columns["stamp_ns"], strict=True)
            return np.array([int(s) * NS_PER_S + int(ns) for s, ns in parts], dtype=np.int64)
        name = next(name for name in ("stamp", "time", "stamp_s") if name in columns)
        texts = columns[name]
        if is_date(texts[0]):
            return np.array([date_ns(text) for text in texts], dtype=np.int64)
        unit: float | None = next((ns for size, ns in _UNITS if abs(float(texts[0])) >= size), None)
        named = units.get(name)
        unit = float(named.ns) if unit is None and named is not None and named.ns != NS_PER_S else unit
        if unit is None:
            return np.array([decimal_ns(text) for text in texts], dtype=np.int64)
        return np.array([round(int(text) * unit) if text.isdigit() else round(float(text) * unit) for text in texts])
    except (ValueError, OverflowError):
        shown = next(iter(chain.from_iterable(columns[name][:1] for name in _TIMES if name in columns)), "")
        raise FrontendError(f"{path}:{lines[0]}: times that are no seconds: {shown[:40]!r}") from None
