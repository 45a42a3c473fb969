"""Positions measured from outside (GPS): tables with latitude and longitude or metres east, north and up, NMEA, GPX."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_atomically

from ..errors import FrontendError
from .geodesy import enu_of, geodetic_of
from .geodetic_fixes import UP, GeodeticFixes
from .gpx import is_gpx, read_gpx
from .nmea import is_nmea, read_nmea
from .position_columns import read_position_table
from .timestamps import NS_PER_S, seconds_text

POSITIONS = "gps.csv"
BESIDE = (POSITIONS, "gps.nmea", "gps.gpx")
"""Names that are looked for beside images."""


@dataclass(frozen=True, eq=False)
class PositionFixes:
    """N fixes: ``stamps_ns`` ``(N,)`` ascending, on the images' clock; ``enu`` ``(N, 3)`` metres east, north, up of one
    place for all agents; ``sigma`` ``(N, 3)`` metres; ``antenna`` ``(3,)``: in the camera's frame, metres. ``geodetic``
    ``(N, 3)``: degrees and metres as read, where ``enu`` is not known yet; ``notes``: what of the file was left
    out; ``source``: the recording and topic that they are from."""

    stamps_ns: NDArray[np.int64]
    enu: NDArray[np.float64]
    sigma: NDArray[np.float64]
    antenna: NDArray[np.float64]
    geodetic: NDArray[np.float64] | None = None
    notes: tuple[str, ...] = ()
    source: str = ""

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

    def completed(self, sigma_m: float, antenna: NDArray[np.float64] | None, offset_s: float) -> PositionFixes:
        """With what the receiver does not tell: noise where it is NaN, of each horizontal axis, twice that of the
        altitude; the ``antenna`` where one is given; ``offset_s`` added to the times."""
        plain = np.array([sigma_m, sigma_m, UP * sigma_m])
        return replace(
            self,
            stamps_ns=self.stamps_ns + round(offset_s * NS_PER_S),
            sigma=np.where(np.isnan(self.sigma), plain, self.sigma),
            antenna=self.antenna if antenna is None else np.asarray(antenna),
        )


def read_positions(
    path: Path, sigma_m: float = 2.0, antenna: NDArray[np.float64] | None = None, offset_s: float = 0.0
) -> PositionFixes:
    """Fixes of a table with a header, of TUM lines (time x y z and a rotation that is not used), of an NMEA log, or of
    a GPX file.

    ``sigma_m``: where the file has none, at HDOP 1; ``antenna``: likewise; ``offset_s`` is added to its times.
    :class:`FrontendError` with file and line for what is no fix.
    """
    shift = round(offset_s * NS_PER_S)
    readers = ((is_nmea, read_nmea), (is_gpx, read_gpx)) if path.is_file() else ()
    read = next((read for knows, read in readers if knows(path)), None)
    fixes, lines = _of_table(path, sigma_m) if read is None else _of_log(read(path, sigma_m))
    fixes = replace(
        fixes, stamps_ns=fixes.stamps_ns + shift, antenna=fixes.antenna if antenna is None else np.asarray(antenna)
    )
    for row in np.flatnonzero(np.diff(fixes.stamps_ns) <= 0)[:1] + 1:
        raise FrontendError(f"{path}:{lines[row]}: time does not go on: {seconds_text(fixes.stamps_ns[row])} s")
    return fixes


def of_receiver(fixes: GeodeticFixes, source: str = "") -> PositionFixes:
    """Fixes in degrees, around no place yet."""
    unknown = np.full(fixes.geodetic.shape, np.nan)
    return PositionFixes(fixes.stamps_ns, unknown, fixes.sigma, np.zeros(3), fixes.geodetic, fixes.notes, source)


def _of_log(log: GeodeticFixes) -> tuple[PositionFixes, list[int]]:
    return of_receiver(log), log.lines


def _of_table(path: Path, sigma_m: float) -> tuple[PositionFixes, list[int]]:
    table = read_position_table(path)
    one, none = table.column, np.zeros(len(table.lines))
    antenna = np.array([one[f"antenna_{axis}"][0] if f"antenna_{axis}" in one else 0.0 for axis in "xyz"])
    sigma = table.sigma(path, sigma_m)
    if "lat" not in one:
        enu = np.column_stack([one["east"], one["north"], one.get("up", none)])
        return PositionFixes(table.stamps_ns, enu, sigma, antenna, None, table.notes), table.lines
    geodetic = np.column_stack([one["lat"], one["lon"], one.get("alt", none)])
    for row in np.flatnonzero((np.abs(geodetic[:, 0]) > 90) | (np.abs(geodetic[:, 1]) > 360))[:1]:
        raise FrontendError(
            f"{path}:{table.lines[row]}: latitude {geodetic[row, 0]:g}, longitude {geodetic[row, 1]:g} degrees"
        )
    unknown = np.full(geodetic.shape, np.nan)
    return PositionFixes(table.stamps_ns, unknown, sigma, antenna, geodetic, table.notes), table.lines


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


def write_geodetic(
    path: Path, stamps_ns: NDArray[np.int64], enu: NDArray[np.float64], origin: NDArray[np.float64]
) -> None:
    """Latitudes and longitudes of ``enu`` ``(N, 3)`` around ``origin`` (latitude, longitude, altitude), a line each."""
    rows = zip(stamps_ns.tolist(), geodetic_of(enu, origin).tolist(), strict=True)
    text = "".join(f"{seconds_text(t)},{lat:.10f},{lon:.10f},{alt:.4f}\n" for t, (lat, lon, alt) in rows)
    write_atomically(path, "time_s,latitude_deg,longitude_deg,altitude_m\n" + text)
