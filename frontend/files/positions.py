"""Positions measured from outside (GPS): files with latitude and longitude, or metres east, north and up."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically

from ..errors import FrontendError
from .text_tables import read_bytes
from .timestamps import NS_PER_S, decimal_ns, seconds_text

POSITIONS = "gps.csv"
_A_M, _E2 = 6378137.0, 6.69437999014e-3
"""WGS 84: half axis, squared eccentricity."""
_NAMES = {
    "time": r"#?\s*(t|time|timestamp|stamp|time_s|timestamp_s|sec|seconds)(\b.*)?",
    "lat": r"lat(itude)?(\b.*|_deg)?",
    "lon": r"(lon|lng|longitude)(\b.*|_deg)?",
    "alt": r"(alt|altitude|height|ele|elevation)(\b.*|_m)?",
    "east": r"(e|east|x|easting)(\b.*|_m)?",
    "north": r"(n|north|y|northing)(\b.*|_m)?",
    "up": r"(u|up|z)(\b.*|_m)?",
    "sigma_east": r"(sigma|std)_(e|east|x)(_m)?",
    "sigma_north": r"(sigma|std)_(n|north|y)(_m)?",
    "sigma_up": r"(sigma|std)_(u|up|z|alt)(_m)?",
    "sigma": r"(sigma|std|accuracy)(_m)?",
    "antenna_x": "antenna_x(_m)?",
    "antenna_y": "antenna_y(_m)?",
    "antenna_z": "antenna_z(_m)?",
}
_MEANT = "columns with a header: time, then lat lon alt (degrees, metres) or east north up (metres), and sigma if known"
_UNITS = ((1e17, 1.0), (1e14, 1e3), (1e11, 1e6))
"""Sizes from which a time of today's clock is in nano-, micro- or milliseconds, and nanoseconds a unit."""


@dataclass(frozen=True, eq=False)
class PositionFixes:
    """N fixes: ``stamps_ns`` ``(N,)`` ascending, on the images' clock; ``enu`` ``(N, 3)`` metres east, north, up of one
    place for all agents; ``sigma`` ``(N, 3)`` metres; ``antenna`` ``(3,)``: in the camera's frame, metres. ``geodetic``
    ``(N, 3)``: degrees and metres as read, where ``enu`` is not known yet."""

    stamps_ns: NDArray[np.int64]
    enu: NDArray[np.float64]
    sigma: NDArray[np.float64]
    antenna: NDArray[np.float64]
    geodetic: NDArray[np.float64] | None = None

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def between(self, first_ns: int, last_ns: int, start_ns: int = 0) -> PositionFixes:
        """Those of a span of time, counted from ``start_ns``."""
        inside = (self.stamps_ns >= first_ns) & (self.stamps_ns <= last_ns)
        rest = self.enu[inside], self.sigma[inside]
        return PositionFixes(self.stamps_ns[inside] - start_ns, *rest, self.antenna)

    def around(self, origin: NDArray[np.float64]) -> PositionFixes:
        """With ``enu`` from degrees, around ``origin`` (latitude, longitude, altitude)."""
        if self.geodetic is None:
            return self
        return replace(self, enu=enu_of(self.geodetic, origin), geodetic=None)


def read_positions(
    path: Path, sigma_m: float = 2.0, antenna: NDArray[np.float64] | None = None, offset_s: float = 0.0
) -> PositionFixes:
    """Fixes of a file with a header; or TUM lines (time x y z and a rotation that is not used).

    ``sigma_m``: where the file has none; ``antenna``: likewise; ``offset_s`` is added to its times.
    :class:`FrontendError` with file and line for what is no fix.
    """
    names, rows, lines = _rows(path)
    if "time" not in names or not ({"lat", "lon"} <= set(names) or {"east", "north"} <= set(names)):
        raise FrontendError(f"{path}: no positions: {_MEANT}")
    values = np.array([[float(field) for field in row] for row in rows]).reshape(len(rows), len(names))
    if not len(values):
        raise FrontendError(f"{path}: no positions in this file")
    column = {name: values[:, k] for k, name in enumerate(names) if name}
    none = np.zeros(len(values))
    stamps = _stamps(path, [row[names.index("time")] for row in rows], lines) + round(offset_s * NS_PER_S)
    for row in np.flatnonzero(np.diff(stamps) <= 0)[:1] + 1:
        raise FrontendError(f"{path}:{lines[row]}: time does not go on: {seconds_text(stamps[row])} s")
    common = column.get("sigma", np.full(len(values), sigma_m))
    sigma = np.column_stack([column.get(f"sigma_{axis}", common) for axis in ("east", "north", "up")])
    for row in np.flatnonzero(~(sigma > 0).all(axis=1))[:1]:
        raise FrontendError(f"{path}:{lines[row]}: a standard deviation of {sigma[row].min():g} m; above 0 m is meant")
    given = np.array([column[f"antenna_{axis}"][0] if f"antenna_{axis}" in column else 0.0 for axis in "xyz"])
    place = given if antenna is None else antenna
    if "lat" not in names:
        enu = np.column_stack([column["east"], column["north"], column.get("up", none)])
        return PositionFixes(stamps, enu, sigma, place)
    geodetic = np.column_stack([column["lat"], column["lon"], column.get("alt", none)])
    for row in np.flatnonzero((np.abs(geodetic[:, 0]) > 90) | (np.abs(geodetic[:, 1]) > 360))[:1]:
        raise FrontendError(
            f"{path}:{lines[row]}: latitude {geodetic[row, 0]:g}, longitude {geodetic[row, 1]:g} degrees"
        )
    return PositionFixes(stamps, np.full((len(values), 3), np.nan), sigma, place, geodetic)


def write_positions(path: Path, fixes: PositionFixes) -> None:
    """As :func:`read_positions` reads it, in metres."""
    head = "time_s,east_m,north_m,up_m,sigma_east_m,sigma_north_m,sigma_up_m,antenna_x_m,antenna_y_m,antenna_z_m\n"
    antenna = ",".join(map(repr, fixes.antenna.tolist()))
    rows = np.column_stack([fixes.enu, fixes.sigma]).tolist()
    lines = [
        f"{seconds_text(t)},{','.join(map(repr, row))},{antenna}\n"
        for t, row in zip(fixes.stamps_ns.tolist(), rows, strict=True)
    ]
    write_atomically(path, head + "".join(lines))


def enu_of(geodetic: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres east, north and up ``(N, 3)`` of ``origin``, both in degrees and metres above the ellipsoid (WGS 84)."""
    d = _ecef(geodetic) - _ecef(origin[None])[0]
    lat, lon = np.radians(origin[:2])
    east = [-np.sin(lon), np.cos(lon), 0.0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.asarray(d @ np.array([east, north, up]).T)


def _ecef(geodetic: NDArray[np.float64]) -> NDArray[np.float64]:
    lat, lon, h = np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1]), geodetic[:, 2]
    n = _A_M / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    x, y = (n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon)
    return np.column_stack([x, y, (n * (1.0 - _E2) + h) * np.sin(lat)])


def _rows(path: Path) -> tuple[list[str], list[list[str]], list[int]]:
    """Names of the columns ("" where not known), the fields of each row, and line numbers."""
    names: list[str] = []
    rows: list[list[str]] = []
    lines: list[int] = []
    text = read_bytes(path).removeprefix(b"\xef\xbb\xbf").decode("utf-8", "replace")
    for number, line in enumerate(text.splitlines(), 1):
        fields = [f.strip() for f in re.split(r"[,;]", line)] if re.search("[,;]", line) else line.split()
        if not any(fields):
            continue
        if not rows and not _is_number(fields[0]):
            named = [_named(f) for f in (fields if fields[0] != "#" else fields[1:])]
            names = named if "time" in named else names
            continue
        if not names and len(fields) == 8:
            names = ["time", "east", "north", "up", "", "", "", ""]
        if not names:
            raise FrontendError(f"{path}:{number}: no header that names the columns; {_MEANT}")
        if len(fields) != len(names) or not all(_is_number(f) for f, n in zip(fields, names, strict=True) if n):
            raise FrontendError(f"{path}:{number}: not {len(names)} numbers: {line.strip()[:60]!r}")
        rows.append([f if n else "0" for f, n in zip(fields, names, strict=True)])
        lines.append(number)
    return names, rows, lines


def _named(field: str) -> str:
    plain = field.strip().strip("\"'").lower().split(" [")[0].split(" (")[0]
    return next((name for name, pattern in _NAMES.items() if re.fullmatch(pattern, plain)), "")


def _is_number(text: str) -> bool:
    try:
        return bool(np.isfinite(float(text)))
    except ValueError:
        return False


def _stamps(path: Path, texts: list[str], lines: list[int]) -> NDArray[np.int64]:
    unit = next((ns for size, ns in _UNITS if abs(float(texts[0])) >= size), None)
    try:
        if unit is None:
            return np.array([decimal_ns(text) for text in texts], dtype=np.int64)
        return np.array([round(int(text) * unit) if text.isdigit() else round(float(text) * unit) for text in texts])
    except (ValueError, OverflowError):
        raise FrontendError(f"{path}:{lines[0]}: times that are no seconds") from None
