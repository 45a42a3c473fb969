"""Latitude, longitude and altitude (WGS 84), and metres east, north and up of a place."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_A_M, _E2 = 6378137.0, 6.69437999014e-3
"""Half axis, squared eccentricity."""
_TURNS = 6
"""Fixed-point steps of the latitude: each is exact to 0.7 % of the one before."""


def enu_of(geodetic: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Metres east, north and up ``(N, 3)`` of ``origin``, both in degrees and metres above the ellipsoid."""
    return np.asarray((_ecef(geodetic) - _ecef(origin[None])[0]) @ _axes(origin).T)


def geodetic_of(enu: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Latitude and longitude, degrees, and metres above the ellipsoid ``(N, 3)``: the inverse of :func:`enu_of`."""
    x, y, z = (enu @ _axes(origin) + _ecef(origin[None])[0]).T
    radius = np.hypot(x, y)
    lat = np.arctan2(z, radius * (1.0 - _E2))
    for _ in range(_TURNS):
        lat = np.arctan2(z + _E2 * _across(lat) * np.sin(lat), radius)
    # Along the ellipsoid's normal, which holds at the poles, too.
    height = radius * np.cos(lat) + z * np.sin(lat) - _A_M * np.sqrt(1.0 - _E2 * np.sin(lat) ** 2)
    return np.column_stack([np.degrees(lat), np.degrees(np.arctan2(y, x)), height])


def _axes(origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """East, north and up ``(3, 3)`` as rows, in the Earth's axes."""
    lat, lon = np.radians(origin[:2])
    east = [-np.sin(lon), np.cos(lon), 0.0]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.array([east, north, up])


def _across(lat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Radius of curvature across the meridian, metres."""
    return np.asarray(_A_M / np.sqrt(1.0 - _E2 * np.sin(lat) ** 2))


def _ecef(geodetic: NDArray[np.float64]) -> NDArray[np.float64]:
    lat, lon, h = np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1]), geodetic[:, 2]
    n = _across(lat)
    x, y = (n + h) * np.cos(lat) * np.cos(lon), (n + h) * np.cos(lat) * np.sin(lon)
    return np.column_stack([x, y, (n * (1.0 - _E2) + h) * np.sin(lat)])
