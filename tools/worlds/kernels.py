"""Compiled shading: arrays in, arrays out. Texture look-ups depend on the point of the surface and on the pixel's
footprint there, never on the view otherwise, so that all views of a place agree to the sub-pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tools.worlds.sampling import grey_at, rgb_at

POINT, PLANE, UV, UV_GRADIENT, NORMAL, NORMAL_GRADIENT, TINT, ROW = 0, 3, 6, 8, 14, 17, 26, 29
"""Columns of a triangle's row: a point (3), the unit normal of its plane (3), uv at the point (2), their gradients
over the plane (2 x 3, per metre), the smooth normal at the point (3) and its gradients (3 x 3), tint (3). One row, so
that a triangle is one memory access."""


class SceneArrays(NamedTuple):
    """What shading reads: ``row`` ``(n, ROW)`` and integers of each triangle, the textures, the lamps."""

    row: NDArray[np.float64]
    material: NDArray[np.int32]
    group: NDArray[np.int32]
    zone: NDArray[np.int32]
    texels: NDArray[np.uint8]
    table: NDArray[np.int64]
    texel_m: NDArray[np.float64]
    clamped: NDArray[np.bool_]
    materials: NDArray[np.int32]
    linear: NDArray[np.float64]  # (257,) display value to reflectance
    lamps: NDArray[np.float64]  # (l, 4): x, y, z, power
    zone_lamps: NDArray[np.int64]  # (zones + 1,) first lamp of each zone
    sky_texture: int


class LightArrays(NamedTuple):
    """A light as numbers; colours are linear irradiance factors."""

    sun: NDArray[np.float64]  # (3,) towards the sun
    sun_rgb: NDArray[np.float64]
    sky_rgb: NDArray[np.float64]
    ground_rgb: NDArray[np.float64]
    horizon_rgb: NDArray[np.float64]
    zenith_rgb: NDArray[np.float64]
    lamp_rgb: NDArray[np.float64]
    cloud: NDArray[np.float64]  # offset x, offset z, cover 0..1, brightness
    haze_m: float


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _reflectance(linear: NDArray, value: float) -> float:
    value = min(max(value, 0.0), 255.0)
    k = int(value)
    return linear[k] + (value - k) * (linear[k + 1] - linear[k])


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _sky(
    s: SceneArrays, light: LightArrays, x: float, y: float, z: float, dx: NDArray, dy: NDArray
) -> tuple[float, float, float]:
    """Radiance of the sky along (x, y, z) (any length): gradient, glow round the sun, and clouds on a plane 400 m up,
    at infinity's place."""
    length = np.sqrt(x * x + y * y + z * z)
    up = max(-y / length, 0.0)
    towards = max((x * light.sun[0] + y * light.sun[1] + z * light.sun[2]) / length, 0.0)
    glow = 0.25 * towards**8 + 0.5 * towards**64
    cover = 0.0
    if s.sky_texture >= 0 and up > 0.005:
        k = 400.0 / (up + 0.12) / length
        t = s.sky_texture
        ku, kv = k / s.texel_m[t, 0], k / s.texel_m[t, 1]
        u, v = x * ku + light.cloud[0] / s.texel_m[t, 0], z * kv + light.cloud[1] / s.texel_m[t, 1]
        m = grey_at(s.texels, s.table, t, u, v, dx[0] * ku, dx[2] * kv, dy[0] * ku, dy[2] * kv)
        cover = min(max((m / 255.0 - 1.0 + light.cloud[2]) * 2.5, 0.0), 1.0) * min(up * 8.0, 1.0)
    a = np.sqrt(up)
    white = cover * light.cloud[3] * (0.8 + glow)
    glow *= 0.3
    r = light.horizon_rgb[0] * (1 - a) + light.zenith_rgb[0] * a + glow * light.sun_rgb[0]
    g = light.horizon_rgb[1] * (1 - a) + light.zenith_rgb[1] * a + glow * light.sun_rgb[1]
    b = light.horizon_rgb[2] * (1 - a) + light.zenith_rgb[2] * a + glow * light.sun_rgb[2]
    return r * (1 - cover) + white, g * (1 - cover) + white, b * (1 - cover) + white


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _lamps(s: SceneArrays, zone: int, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Light of the lamps of a room at a point with normal (nx, ny, nz); wrapped round, as if much of it came from the
    walls."""
    total = 0.0
    for k in range(s.zone_lamps[zone], s.zone_lamps[zone + 1]):
        lx, ly, lz = s.lamps[k, 0] - x, s.lamps[k, 1] - y, s.lamps[k, 2] - z
        square = lx * lx + ly * ly + lz * lz + 0.5
        facing = (nx * lx + ny * ly + nz * lz) / np.sqrt(square)
        total += s.lamps[k, 3] * max(0.5 + 0.5 * facing, 0.0) / square
    return total


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def shade(
    s: SceneArrays,
    first: int,
    light: LightArrays,
    view: NDArray,
    footprint: float,
    pixels: NDArray,
    triangle: NDArray,
    depth: NDArray,
    lit: NDArray,
    radiance: NDArray,
) -> None:
    """Fill ``radiance`` ``(n, 3)``, linear, for the pixels whose triangle is one of ``first`` .. (and the sky's, where
    ``first`` is 0); ``footprint``: width of a sample, pixels."""
    row = s.row
    step_x, step_y = view[2] * footprint, view[3] * footprint
    ax, ay, az, bx, by, bz = step_x[0], step_x[1], step_x[2], step_y[0], step_y[1], step_y[2]
    for i in range(len(pixels)):
        t = triangle[i] - first
        if (t < 0 and (first > 0 or triangle[i] >= 0)) or t >= len(row):
            continue
        p, q = pixels[i, 0], pixels[i, 1]
        dx = view[1, 0] + p * view[2, 0] + q * view[3, 0]
        dy = view[1, 1] + p * view[2, 1] + q * view[3, 1]
        dz = view[1, 2] + p * view[2, 2] + q * view[3, 2]
        if t < 0:
            radiance[i, 0], radiance[i, 1], radiance[i, 2] = _sky(s, light, dx, dy, dz, step_x, step_y)
            continue
        z = depth[i]
        nx, ny, nz = row[t, PLANE], row[t, PLANE + 1], row[t, PLANE + 2]
        slope = nx * dx + ny * dy + nz * dz
        if abs(slope) < 1e-9:
            slope = 1e-9
        sx = -z * (nx * ax + ny * ay + nz * az) / slope
        sy = -z * (nx * bx + ny * by + nz * bz) / slope
        # The point relative to the triangle's, and how it moves over the plane from one pixel to the next.
        x, y, w = view[0, 0] + z * dx - row[t, 0], view[0, 1] + z * dy - row[t, 1], view[0, 2] + z * dz - row[t, 2]
        gxx, gxy, gxz = z * ax + sx * dx, z * ay + sx * dy, z * az + sx * dz
        gyx, gyy, gyz = z * bx + sy * dx, z * by + sy * dy, z * bz + sy * dz
        g0, g1, g2 = row[t, UV_GRADIENT], row[t, UV_GRADIENT + 1], row[t, UV_GRADIENT + 2]
        h0, h1, h2 = row[t, UV_GRADIENT + 3], row[t, UV_GRADIENT + 4], row[t, UV_GRADIENT + 5]
        u = row[t, UV] + g0 * x + g1 * y + g2 * w
        v = row[t, UV + 1] + h0 * x + h1 * y + h2 * w
        dux, duy = g0 * gxx + g1 * gxy + g2 * gxz, g0 * gyx + g1 * gyy + g2 * gyz
        dvx, dvy = h0 * gxx + h1 * gxy + h2 * gxz, h0 * gyx + h1 * gyy + h2 * gyz
        m = s.material[t]
        base = s.materials[m, 0]
        ku, kv = 1.0 / s.texel_m[base, 0], 1.0 / s.texel_m[base, 1]
        r, g, b = rgb_at(
            s.texels, s.table, s.clamped[base], base, u * ku, v * kv, dux * ku, dvx * kv, duy * ku, dvy * kv
        )
        factor = 1.0
        for layer in range(1, 3):
            a = s.materials[m, layer]
            if a >= 0:
                ku, kv = 1.0 / s.texel_m[a, 0], 1.0 / s.texel_m[a, 1]
                factor *= grey_at(s.texels, s.table, a, u * ku, v * kv, dux * ku, dvx * kv, duy * ku, dvy * kv) / 128.0
        k = NORMAL_GRADIENT
        nx = row[t, NORMAL] + row[t, k] * x + row[t, k + 1] * y + row[t, k + 2] * w
        ny = row[t, NORMAL + 1] + row[t, k + 3] * x + row[t, k + 4] * y + row[t, k + 5] * w
        nz = row[t, NORMAL + 2] + row[t, k + 6] * x + row[t, k + 7] * y + row[t, k + 8] * w
        length = np.sqrt(max(nx * nx + ny * ny + nz * nz, 1e-12)) * (-1.0 if slope > 0 else 1.0)
        nx, ny, nz = nx / length, ny / length, nz / length
        up = 0.5 - 0.5 * ny
        sun = lamp = 0.0
        if s.zone[t] >= 0:
            lamp = _lamps(s, s.zone[t], x + row[t, 0], y + row[t, 1], w + row[t, 2], nx, ny, nz)
        elif lit[i]:
            sun = max(nx * light.sun[0] + ny * light.sun[1] + nz * light.sun[2], 0.0)
        haze = z / light.haze_m
        clear = 1.0 / (1.0 + haze * (1.0 + 0.5 * haze))  # nearly exp(-haze), at a fraction of its cost
        er = (
            light.sky_rgb[0] * up + light.ground_rgb[0] * (1.0 - up) + light.sun_rgb[0] * sun + light.lamp_rgb[0] * lamp
        )
        eg = (
            light.sky_rgb[1] * up + light.ground_rgb[1] * (1.0 - up) + light.sun_rgb[1] * sun + light.lamp_rgb[1] * lamp
        )
        eb = (
            light.sky_rgb[2] * up + light.ground_rgb[2] * (1.0 - up) + light.sun_rgb[2] * sun + light.lamp_rgb[2] * lamp
        )
        radiance[i, 0] = (
            _reflectance(s.linear, r * factor) * row[t, TINT] * er * clear + (1 - clear) * light.horizon_rgb[0]
        )
        radiance[i, 1] = (
            _reflectance(s.linear, g * factor) * row[t, TINT + 1] * eg * clear + (1 - clear) * light.horizon_rgb[1]
        )
        radiance[i, 2] = (
            _reflectance(s.linear, b * factor) * row[t, TINT + 2] * eb * clear + (1 - clear) * light.horizon_rgb[2]
        )
