"""GPX tracks of a phone or a satellite receiver: points with latitude, longitude, elevation and time."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ..errors import FrontendError
from .geodetic_fixes import UP, GeodeticFixes
from .text_tables import read_bytes
from .time_units import NotATime, date_ns

_GPX = re.compile(rb"<([\w.-]+:)?gpx[\s>]", re.IGNORECASE)
_HEAD = 4096  # bytes in which a file says what it is
_KINDS = ("trkpt", "rtept", "wpt")
"""Points of tracks, of routes, single ones: the first kind of which some have times is read."""
_PARTS = ("ele", "time", "hdop", "fix")


def is_gpx(path: Path) -> bool:
    """Whether the file begins as GPX does."""
    with open(path, "rb") as file:
        return _GPX.search(file.read(_HEAD)) is not None


def read_gpx(path: Path, sigma_m: float) -> GeodeticFixes:
    """The points of all tracks, in order of time. ``sigma_m``: standard deviation of each horizontal axis at HDOP 1.

    Points without a time or a fix, and such with the time of another, are left out and counted. Elevations are taken as
    they are, 0 where no point has one. :class:`FrontendError` with the line for what is no number, and where no point
    is left.
    """
    points = _GpxPoints(path)
    kind = next((kind for kind in _KINDS if any("time" in point for point in points.of[kind])), None)
    if kind is None:
        count = sum(map(len, points.of.values()))
        why = f"none of its {count} points has a time" if count else "no points in it"
        raise FrontendError(f"{path}: a GPX file, but {why}: positions need the time at which they were measured")
    found = points.of[kind]
    timed = [point for point in found if "time" in point and point.get("fix") != "none"]
    high = any("ele" in point for point in timed)
    used = [point for point in timed if "ele" in point or not high]
    if not used:
        raise FrontendError(f"{path}: a GPX file without a position")
    rows = [_numbers(path, point) for point in used]
    stamps = np.array([_stamp(path, point) for point in used], dtype=np.int64)
    order = np.argsort(stamps, kind="stable")
    first = np.diff(stamps[order], prepend=stamps[order][:1] - 1) > 0
    kept = order[first]
    values = np.array(rows)[kept]
    flat = sigma_m * values[:, 3]
    left_out = [
        (len(found) - len(timed), "without a time or a fix"),
        (len(timed) - len(used), "without an elevation"),
        (int((~first).sum()), "with the time of another"),
    ]
    notes = [f"{count} point{'s' * (count > 1)} {what} left out" for count, what in left_out if count]
    notes += ["no elevations in it: 0 is taken"] * (not high)
    lines = [int(used[k]["line"]) for k in kept.tolist()]
    return GeodeticFixes(stamps[kept], values[:, :3], np.column_stack([flat, flat, UP * flat]), lines, tuple(notes))


class _GpxPoints:
    """Points of a file as they are written: ``lat``, ``lon``, ``ele``, ``time``, ``hdop``, ``fix`` and the ``line`` of
    each, by kind."""

    def __init__(self, path: Path) -> None:
        """:class:`FrontendError` for what is no XML, and for entities of its own."""
        self.of: dict[str, list[dict[str, str]]] = {kind: [] for kind in _KINDS}
        self._path = path
        self._inside: dict[str, str] | None = None
        self._text: list[str] | None = None
        self._parser = expat.ParserCreate()
        self._parser.StartElementHandler = self._start
        self._parser.EndElementHandler = self._end
        self._parser.CharacterDataHandler = self._more
        self._parser.EntityDeclHandler = self._entity
        try:
            self._parser.Parse(read_bytes(path), True)
        except expat.ExpatError as error:
            raise FrontendError(f"{path}:{error.lineno}: not GPX: {expat.ErrorString(error.code)}") from None

    def _start(self, name: str, attributes: Mapping[str, str]) -> None:
        name = name.rpartition(":")[2]
        if name in _KINDS:
            self._inside = {"line": str(self._parser.CurrentLineNumber)}
            self._inside |= {key: attributes[key] for key in ("lat", "lon") if key in attributes}
            self.of[name].append(self._inside)
        self._text = [] if self._inside is not None and name in _PARTS else None

    def _more(self, text: str) -> None:
        if self._text is not None:
            self._text.append(text)

    def _end(self, name: str) -> None:
        name = name.rpartition(":")[2]
        if self._inside is not None and self._text is not None and name in _PARTS:
            self._inside.setdefault(name, "".join(self._text).strip())
        self._inside = None if name in _KINDS else self._inside
        self._text = None

    def _entity(self, *_: object) -> None:
        raise FrontendError(f"{self._path}:{self._parser.CurrentLineNumber}: XML entities of its own are not read")


def _numbers(path: Path, point: Mapping[str, str]) -> tuple[float, float, float, float]:
    """Latitude, longitude, elevation and HDOP."""
    values = []
    for name, default in (("lat", ""), ("lon", ""), ("ele", "0"), ("hdop", "1")):
        text = point.get(name, default)
        try:
            values.append(float(text))
        except ValueError:
            raise FrontendError(f"{path}:{point['line']}: {name} is no number: {text[:40]!r}") from None
    lat, lon, ele, hdop = values
    if not (np.isfinite(values).all() and abs(lat) <= 90 and abs(lon) <= 360):
        raise FrontendError(f"{path}:{point['line']}: latitude {lat:g}, longitude {lon:g} degrees, elevation {ele:g} m")
    if hdop <= 0:
        raise FrontendError(f"{path}:{point['line']}: hdop of {hdop:g}; above 0 is meant")
    return lat, lon, ele, hdop


def _stamp(path: Path, point: Mapping[str, str]) -> int:
    try:
        return date_ns(point["time"])
    except NotATime:
        raise FrontendError(f"{path}:{point['line']}: not a time: {point['time'][:40]!r}") from None
