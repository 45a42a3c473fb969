"""Compiled shading: arrays in, arrays out. Texture look-ups depend on the point of the surface and on the pixel's footprint there,
never on the view otherwise, so that all views of a place agree to the sub-pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from tools.worlds.atlas import LEVELS

MAX_ANISOTROPY = 8
"""Samples at most along the long axis of a stretched pixel footprint."""


POINT, PLANE, UV, UV_GRADIENT, NORMAL, NORMAL_GRADIENT, TINT, ROW = 0, 3, 6, 8, 14, 17, 26, 29
"""Columns of a triangle's row: a point (3), the unit normal of its plane (3), uv at the point (2), their gradients over the plane (2 x 3,
per metre), the smooth normal at the point (3) and its gradients (3 x 3), tint (3). One row, so that a triangle is one memory access."""


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


@njit(cache=True, nogil=True, fastmath=True)
def _footprint(dux: float, dvx: float, duy: float, dvy: float, most: int) -> tuple[float, float, int, float]:
    """The long axis of a footprint in texels, the number of samples along it (at most ``most``) and the mip level that each needs."""
    px, py = dux * dux + dvx * dvx, duy * duy + dvy * dvy
    if px > py:
        au, av, major, minor = dux, dvx, np.sqrt(px), np.sqrt(py)
    else:
        au, av, major, minor = duy, dvy, np.sqrt(py), np.sqrt(px)
    if major <= 1.0:
        return au, av, 1, 0.0
    count = min(int(np.ceil(major / max(minor, 1.0) - 0.25)), most)
    return au, av, count, np.log2(max(major / count, 1.0))


@njit(cache=True, nogil=True, fastmath=True)
def _rgb(texels: NDArray, table: NDArray, clamped: bool, t: int, u: float, v: float, dux: float, dvx: float, duy: float, dvy: float
         ) -> tuple[float, float, float]:  # fmt: skip
    """Texture ``t`` at (u, v) texels, averaged over the parallelogram of the pixel's gradients: trilinear samples along its long axis."""
    au, av, count, lod = _footprint(dux, dvx, duy, dvy, MAX_ANISOTROPY)
    k0 = min(int(lod), LEVELS - 2)
    blend = min(lod - k0, 1.0)
    r = g = b = 0.0
    for j in range(2):
        level_weight = blend if j == 1 else 1.0 - blend
        if level_weight < 0.02:
            continue
        offset, w, h = table[t, k0 + j, 0], table[t, k0 + j, 1], table[t, k0 + j, 2]
        sx, sy = w / table[t, 0, 1], h / table[t, 0, 2]
        weight = level_weight / count
        for i in range(count):
            o = (i + 0.5) / count - 0.5
            x, y = (u + o * au) * sx - 0.5, (v + o * av) * sy - 0.5
            fx, fy = np.floor(x), np.floor(y)
            x0, y0 = int(fx), int(fy)
            fx, fy = x - fx, y - fy
            if clamped:
                xa, xb = min(max(x0, 0), w - 1), min(max(x0 + 1, 0), w - 1)
                ya, yb = min(max(y0, 0), h - 1), min(max(y0 + 1, 0), h - 1)
            else:
                xa, xb, ya, yb = x0 & (w - 1), (x0 + 1) & (w - 1), y0 & (h - 1), (y0 + 1) & (h - 1)
            aa, ab = 3 * (offset + ya * w + xa), 3 * (offset + ya * w + xb)
            ba, bb = 3 * (offset + yb * w + xa), 3 * (offset + yb * w + xb)
            w11 = fx * fy * weight
            w01, w10 = fx * weight - w11, fy * weight - w11
            w00 = weight - w01 - w10 - w11
            r += w00 * texels[aa] + w01 * texels[ab] + w10 * texels[ba] + w11 * texels[bb]
            g += w00 * texels[aa + 1] + w01 * texels[ab + 1] + w10 * texels[ba + 1] + w11 * texels[bb + 1]
            b += w00 * texels[aa + 2] + w01 * texels[ab + 2] + w10 * texels[ba + 2] + w11 * texels[bb + 2]
    total = (1.0 if blend >= 0.02 else 1.0 - blend) if blend <= 0.98 else blend
    return r / total, g / total, b / total


@njit(cache=True, nogil=True, fastmath=True)
def _grey(texels: NDArray, table: NDArray, t: int, u: float, v: float, dux: float, dvx: float, duy: float, dvy: float) -> float:
    """Like :func:`_rgb` for the first channel of a repeating texture, with fewer samples: for layers that only modulate."""
    au, av, count, lod = _footprint(dux, dvx, duy, dvy, 3)
    k0 = min(int(lod), LEVELS - 2)
    if table[t, k0, 1] <= 2:
        return float(texels[3 * table[t, LEVELS - 1, 0]])
    blend = min(lod - k0, 1.0)
    total = 0.0
    for j in range(2):
        level_weight = blend if j == 1 else 1.0 - blend
        if level_weight <= 0.0:
            continue
        offset, w, h = table[t, k0 + j, 0], table[t, k0 + j, 1], table[t, k0 + j, 2]
        sx, sy = w / table[t, 0, 1], h / table[t, 0, 2]
        weight = level_weight / count
        for i in range(count):
            o = (i + 0.5) / count - 0.5
            x, y = (u + o * au) * sx - 0.5, (v + o * av) * sy - 0.5
            fx, fy = np.floor(x), np.floor(y)
            x0, y0 = int(fx), int(fy)
            fx, fy = x - fx, y - fy
            xa, xb, ya, yb = x0 & (w - 1), (x0 + 1) & (w - 1), offset + (y0 & (h - 1)) * w, offset + ((y0 + 1) & (h - 1)) * w
            top = texels[3 * (ya + xa)] * (1 - fx) + texels[3 * (ya + xb)] * fx
            low = texels[3 * (yb + xa)] * (1 - fx) + texels[3 * (yb + xb)] * fx
            total += weight * (top * (1 - fy) + low * fy)
    return total


@njit(cache=True, nogil=True, fastmath=True)
def _reflectance(linear: NDArray, value: float) -> float:
    value = min(max(value, 0.0), 255.0)
    k = int(value)
    return linear[k] + (value - k) * (linear[k + 1] - linear[k])


@njit(cache=True, nogil=True, fastmath=True)
def _sky(s: SceneArrays, light: LightArrays, x: float, y: float, z: float, dx: NDArray, dy: NDArray) -> tuple[float, float, float]:
    """Radiance of the sky along (x, y, z) (any length): gradient, glow round the sun, and clouds on a plane 400 m up, at infinity's place."""
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
        m = _grey(s.texels, s.table, t, u, v, dx[0] * ku, dx[2] * kv, dy[0] * ku, dy[2] * kv)
        cover = min(max((m / 255.0 - 1.0 + light.cloud[2]) * 2.5, 0.0), 1.0) * min(up * 8.0, 1.0)
    a = np.sqrt(up)
    white = cover * light.cloud[3] * (0.8 + glow)
    glow *= 0.3
    r = light.horizon_rgb[0] * (1 - a) + light.zenith_rgb[0] * a + glow * light.sun_rgb[0]
    g = light.horizon_rgb[1] * (1 - a) + light.zenith_rgb[1] * a + glow * light.sun_rgb[1]
    b = light.horizon_rgb[2] * (1 - a) + light.zenith_rgb[2] * a + glow * light.sun_rgb[2]
    return r * (1 - cover) + white, g * (1 - cover) + white, b * (1 - cover) + white


@njit(cache=True, nogil=True, fastmath=True)
def pack_rays(pixels: NDArray, which: NDArray, view: NDArray, out: NDArray) -> None:
    """Rays ``(m, 6)`` float32 (origin, direction of length 1 along the optical axis) of ``pixels[which]``.

    ``view`` ``(4, 3)``: the camera's centre, the direction of pixel (0, 0), its change from one column and one row to the next.
    """
    for j in range(len(which)):
        u, v = pixels[which[j], 0], pixels[which[j], 1]
        for c in range(3):
            out[j, c] = view[0, c]
            out[j, 3 + c] = view[1, c] + u * view[2, c] + v * view[3, c]


@njit(cache=True, nogil=True, fastmath=True)
def hit_points(s: SceneArrays, first: int, view: NDArray, pixels: NDArray, triangle: NDArray, light: LightArrays,
               depth: NDArray, group: NDArray, facing: NDArray) -> None:  # fmt: skip
    """Depth (0 = sky), surface group (-1 = sky) and whether the sun could shine there, for the pixels whose triangle is one of
    ``first`` .. ``first`` + len(s.row); the others are left alone."""
    row = s.row
    for i in range(len(pixels)):
        t = triangle[i] - first
        if t < 0 or t >= len(row):
            if triangle[i] < 0:
                depth[i], group[i], facing[i] = 0.0, -1, False
            continue
        nx, ny, nz = row[t, PLANE], row[t, PLANE + 1], row[t, PLANE + 2]
        u, v = pixels[i, 0], pixels[i, 1]
        slope = nx * (view[1, 0] + u * view[2, 0] + v * view[3, 0])
        slope += ny * (view[1, 1] + u * view[2, 1] + v * view[3, 1])
        slope += nz * (view[1, 2] + u * view[2, 2] + v * view[3, 2])
        if abs(slope) < 1e-12:
            slope = 1e-12
        depth[i] = ((row[t, 0] - view[0, 0]) * nx + (row[t, 1] - view[0, 1]) * ny + (row[t, 2] - view[0, 2]) * nz) / slope
        side = -1.0 if slope > 0 else 1.0
        group[i] = s.group[t] + first
        facing[i] = s.zone[t] < 0 and side * (nx * light.sun[0] + ny * light.sun[1] + nz * light.sun[2]) > 0.0


@njit(cache=True, nogil=True, fastmath=True)
def pack_shadow_rays(rays: NDArray, depth: NDArray, which: NDArray, sun: NDArray, out: NDArray) -> None:
    """Rays ``(m, 6)`` towards the sun from the points that ``rays[k]`` ``(m, 6)`` see at ``depth[which[k]]``; they start a little before
    the surface, where the eye's ray comes from: that side of it is the one that is seen."""
    for j in range(len(which)):
        z = depth[which[j]]
        z -= 0.002 + 3e-4 * z
        for c in range(3):
            out[j, c] = rays[j, c] + z * rays[j, 3 + c] + 0.004 * sun[c]
            out[j, 3 + c] = sun[c]


@njit(cache=True, nogil=True)
def odd_pixels(value: NDArray, other: NDArray, h: int, w: int) -> NDArray:
    """Fill the odd squares of a chessboard in ``value`` ``(h * w,)`` where all neighbours agree in it and in ``other`` (whose odd squares
    count too); the indices of those that remain to be found out."""
    unknown = np.empty(h * w // 2 + h, np.int64)
    m = 0
    for y in range(h):
        for x in range((y + 1) % 2, w, 2):
            i = y * w + x
            j = i - 1 if x > 0 else i + 1
            same = True
            for k in (i - 1 if x > 0 else j, i + 1 if x + 1 < w else j, i - w if y > 0 else j, i + w if y + 1 < h else j):
                same &= value[k] == value[j] and other[k] == other[j]
            if same and other[i] == other[j]:
                value[i] = value[j]
            else:
                unknown[m] = i
                m += 1
    return unknown[:m].copy()


@njit(cache=True, nogil=True, fastmath=True)
def _lamps(s: SceneArrays, zone: int, x: float, y: float, z: float, nx: float, ny: float, nz: float) -> float:
    """Light of the lamps of a room at a point with normal (nx, ny, nz); wrapped round, as if much of it came from the walls."""
    total = 0.0
    for k in range(s.zone_lamps[zone], s.zone_lamps[zone + 1]):
        lx, ly, lz = s.lamps[k, 0] - x, s.lamps[k, 1] - y, s.lamps[k, 2] - z
        square = lx * lx + ly * ly + lz * lz + 0.5
        facing = (nx * lx + ny * ly + nz * lz) / np.sqrt(square)
        total += s.lamps[k, 3] * max(0.5 + 0.5 * facing, 0.0) / square
    return total


@njit(cache=True, nogil=True, fastmath=True)
def shade(s: SceneArrays, first: int, light: LightArrays, view: NDArray, footprint: float, pixels: NDArray, triangle: NDArray,
          depth: NDArray, lit: NDArray, radiance: NDArray) -> None:  # fmt: skip
    """Fill ``radiance`` ``(n, 3)``, linear, for the pixels whose triangle is one of ``first`` .. (and the sky's, where ``first`` is 0);
    ``footprint``: width of a sample, pixels."""
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
        r, g, b = _rgb(s.texels, s.table, s.clamped[base], base, u * ku, v * kv, dux * ku, dvx * kv, duy * ku, dvy * kv)
        factor = 1.0
        for layer in range(1, 3):
            a = s.materials[m, layer]
            if a >= 0:
                ku, kv = 1.0 / s.texel_m[a, 0], 1.0 / s.texel_m[a, 1]
                factor *= _grey(s.texels, s.table, a, u * ku, v * kv, dux * ku, dvx * kv, duy * ku, dvy * kv) / 128.0
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
        clear = np.exp(-z / light.haze_m)
        for c in range(3):
            value = r if c == 0 else (g if c == 1 else b)
            e = light.sky_rgb[c] * up + light.ground_rgb[c] * (1.0 - up) + light.sun_rgb[c] * sun + light.lamp_rgb[c] * lamp
            radiance[i, c] = _reflectance(s.linear, value * factor) * row[t, TINT + c] * e * clear + (1 - clear) * light.horizon_rgb[c]


@njit(cache=True, nogil=True, fastmath=True)
def edge_pixels(group: NDArray, depth: NDArray, lit: NDArray, h: int, w: int) -> NDArray:
    """Pixels across which the surface, its shadow or its depth breaks: indices ``(m,)`` of those that need more samples."""
    mark = np.zeros(h * w, np.bool_)
    for y in range(h):
        for x in range(w):
            i = y * w + x
            for step in range(2):
                if (step == 0 and x + 1 >= w) or (step == 1 and y + 1 >= h):
                    continue
                j = i + 1 if step == 0 else i + w
                broken = group[i] != group[j] or lit[i] != lit[j]
                if not broken and group[i] >= 0:
                    k = i - 1 if step == 0 else i - w
                    inside = x > 0 if step == 0 else y > 0
                    if inside and depth[k] > 0:
                        bend = abs(1 / depth[k] - 2 / depth[i] + 1 / depth[j])
                        broken = bend * depth[i] > 0.02
                if broken:
                    mark[i] = True
                    mark[j] = True
    return np.nonzero(mark)[0]
