"""Compiled shading: arrays in, arrays out. Texture look-ups depend on the point of the surface and on the pixel's
footprint there, never on the view otherwise, so that all views of a place agree to the sub-pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .texture_sampling import grey_at, rgb_at

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


@kernel(fastmath=True, error_model="numpy", inline="always")
def _reflectance(linear: NDArray, value: float) -> float:
    value = min(max(value, 0.0), 255.0)
    k = int(value)
    return linear[k] + (value - k) * (linear[k + 1] - linear[k])


@kernel(fastmath=True, error_model="numpy", inline="always")
def _sky(
    texels: NDArray,
    table: NDArray,
    texture: int,
    texel_u: float,
    texel_v: float,
    colours: NDArray,
    x: float,
    y: float,
    z: float,
    ax: float,
    az: float,
    bx: float,
    bz: float,
) -> tuple[float, float, float]:
    """Radiance of the sky along (x, y, z) (any length): gradient, glow round the sun, and clouds on a plane 400 m up,
    at infinity's place. (ax, az) and (bx, bz): how x and z change from one pixel to the next."""
    length = np.sqrt(x * x + y * y + z * z)
    up = max(-y / length, 0.0)
    towards = max((x * colours[0, 0] + y * colours[0, 1] + z * colours[0, 2]) / length, 0.0)
    glow = 0.25 * towards**8 + 0.5 * towards**64
    cover = 0.0
    if texture >= 0 and up > 0.005:
        k = 400.0 / (up + 0.12) / length
        ku, kv = k / texel_u, k / texel_v
        u, v = x * ku + colours[4, 0] / texel_u, z * kv + colours[4, 1] / texel_v
        m = grey_at(texels, table, texture, u, v, ax * ku, az * kv, bx * ku, bz * kv)
        cover = min(max((m / 255.0 - 1.0 + colours[4, 2]) * 2.5, 0.0), 1.0) * min(up * 8.0, 1.0)
    a = np.sqrt(up)
    white = cover * colours[4, 3] * (0.8 + glow)
    glow *= 0.3
    r = colours[1, 0] * (1 - a) + colours[2, 0] * a + glow * colours[3, 0]
    g = colours[1, 1] * (1 - a) + colours[2, 1] * a + glow * colours[3, 1]
    b = colours[1, 2] * (1 - a) + colours[2, 2] * a + glow * colours[3, 2]
    return r * (1 - cover) + white, g * (1 - cover) + white, b * (1 - cover) + white


@kernel(fastmath=True, error_model="numpy", inline="always")
def _lamps(
    lamps: NDArray, zone_lamps: NDArray, zone: int, x: float, y: float, z: float, nx: float, ny: float, nz: float
) -> float:
    """Light of the lamps of a room at a point with normal (nx, ny, nz); wrapped round, as if much of it came from the
    walls."""
    total = 0.0
    for k in range(zone_lamps[zone], zone_lamps[zone + 1]):
        lx, ly, lz = lamps[k, 0] - x, lamps[k, 1] - y, lamps[k, 2] - z
        square = lx * lx + ly * ly + lz * lz + 0.5
        facing = (nx * lx + ny * ly + nz * lz) / np.sqrt(square)
        total += lamps[k, 3] * max(0.5 + 0.5 * facing, 0.0) / square
    return total


@kernel(fastmath=True, error_model="numpy")
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
    # Fields of a tuple are taken out once: each access inside the loop would count references, and each call copy them.
    row, material, zone, lamps, zone_lamps = s.row, s.material, s.zone, s.lamps, s.zone_lamps
    texels, table, texel_m, clamped, materials, linear = (
        s.texels,
        s.table,
        s.texel_m,
        s.clamped,
        s.materials,
        s.linear,
    )
    sun_xyz, sun_rgb, sky_rgb, ground_rgb = light.sun, light.sun_rgb, light.sky_rgb, light.ground_rgb
    horizon_rgb, lamp_rgb, haze_m, sky_texture = light.horizon_rgb, light.lamp_rgb, light.haze_m, s.sky_texture
    colours = np.zeros((5, 4))
    colours[0, :3], colours[1, :3], colours[2, :3] = sun_xyz, horizon_rgb, light.zenith_rgb
    colours[3, :3], colours[4] = sun_rgb, light.cloud
    texel_u, texel_v = texel_m[max(sky_texture, 0), 0], texel_m[max(sky_texture, 0), 1]
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
            radiance[i, 0], radiance[i, 1], radiance[i, 2] = _sky(
                texels, table, sky_texture, texel_u, texel_v, colours, dx, dy, dz, ax, az, bx, bz
            )
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
        m = material[t]
        base = materials[m, 0]
        ku, kv = 1.0 / texel_m[base, 0], 1.0 / texel_m[base, 1]
        r, g, b = rgb_at(texels, table, clamped[base], base, u * ku, v * kv, dux * ku, dvx * kv, duy * ku, dvy * kv)
        factor = 1.0
        for layer in range(1, 3):
            a = materials[m, layer]
            if a >= 0:
                ku, kv = 1.0 / texel_m[a, 0], 1.0 / texel_m[a, 1]
                factor *= grey_at(texels, table, a, u * ku, v * kv, dux * ku, dvx * kv, duy * ku, dvy * kv) / 128.0
        k = NORMAL_GRADIENT
        nx = row[t, NORMAL] + row[t, k] * x + row[t, k + 1] * y + row[t, k + 2] * w
        ny = row[t, NORMAL + 1] + row[t, k + 3] * x + row[t, k + 4] * y + row[t, k + 5] * w
        nz = row[t, NORMAL + 2] + row[t, k + 6] * x + row[t, k + 7] * y + row[t, k + 8] * w
        length = np.sqrt(max(nx * nx + ny * ny + nz * nz, 1e-12)) * (-1.0 if slope > 0 else 1.0)
        nx, ny, nz = nx / length, ny / length, nz / length
        up = 0.5 - 0.5 * ny
        sun = lamp = 0.0
        if zone[t] >= 0:
            lamp = _lamps(lamps, zone_lamps, zone[t], x + row[t, 0], y + row[t, 1], w + row[t, 2], nx, ny, nz)
        elif lit[i]:
            sun = max(nx * sun_xyz[0] + ny * sun_xyz[1] + nz * sun_xyz[2], 0.0)
        haze = z / haze_m
        clear = 1.0 / (1.0 + haze * (1.0 + 0.5 * haze))  # nearly exp(-haze), at a fraction of its cost
        er = sky_rgb[0] * up + ground_rgb[0] * (1.0 - up) + sun_rgb[0] * sun + lamp_rgb[0] * lamp
        eg = sky_rgb[1] * up + ground_rgb[1] * (1.0 - up) + sun_rgb[1] * sun + lamp_rgb[1] * lamp
        eb = sky_rgb[2] * up + ground_rgb[2] * (1.0 - up) + sun_rgb[2] * sun + lamp_rgb[2] * lamp
        radiance[i, 0] = _reflectance(linear, r * factor) * row[t, TINT] * er * clear + (1 - clear) * horizon_rgb[0]
        radiance[i, 1] = _reflectance(linear, g * factor) * row[t, TINT + 1] * eg * clear + (1 - clear) * horizon_rgb[1]
        radiance[i, 2] = _reflectance(linear, b * factor) * row[t, TINT + 2] * eb * clear + (1 - clear) * horizon_rgb[2]
