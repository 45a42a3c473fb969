"""Compiled shading: arrays in, arrays out. Texture look-ups depend on the point of the surface and on the pixel's footprint there,
never on the view otherwise, so that all views of a place agree to the sub-pixel."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

MAX_ANISOTROPY = 10
"""Samples at most along the long axis of a stretched pixel footprint."""


class SceneArrays(NamedTuple):
    """What shading reads; per triangle: a point, unit plane normal, gradients of uv and of the smooth normal over the plane."""

    point: NDArray[np.float64]  # (n, 3)
    plane: NDArray[np.float64]  # (n, 3)
    uv: NDArray[np.float64]  # (n, 2) at the point
    uv_gradient: NDArray[np.float64]  # (n, 2, 3) per metre
    normal: NDArray[np.float32]  # (n, 3) at the point
    normal_gradient: NDArray[np.float32]  # (n, 3, 3) per metre
    material: NDArray[np.int32]
    tint: NDArray[np.float32]  # (n, 3)
    group: NDArray[np.int32]
    zone: NDArray[np.int32]
    texels: NDArray[np.uint8]
    table: NDArray[np.int64]
    texel_m: NDArray[np.float32]
    clamped: NDArray[np.bool_]
    materials: NDArray[np.int32]
    linear: NDArray[np.float32]  # (257,) display value to reflectance
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
def _texture(s: SceneArrays, t: int, u: float, v: float, dux: float, dvx: float, duy: float, dvy: float) -> tuple[float, float, float]:  # type: ignore[no-untyped-def]
    """Texture ``t`` at (u, v) metres, averaged over the parallelogram of the pixel's gradients: trilinear samples along its long axis."""
    mu, mv = s.texel_m[t, 0], s.texel_m[t, 1]
    dux, duy, dvx, dvy = dux / mu, duy / mu, dvx / mv, dvy / mv
    px, py = dux * dux + dvx * dvx, duy * duy + dvy * dvy
    if px > py:
        au, av, major, minor = dux, dvx, np.sqrt(px), np.sqrt(py)
    else:
        au, av, major, minor = duy, dvy, np.sqrt(py), np.sqrt(px)
    count = 1
    if major > 1.0:
        count = min(int(np.ceil(major / max(minor, 1.0))), MAX_ANISOTROPY)
    width = max(major / count, 1.0)
    lod = min(max(np.log2(width), 0.0), s.table.shape[1] - 1.001)
    k0 = int(lod)
    blend = lod - k0
    clamped = s.clamped[t]
    w_0, h_0 = s.table[t, 0, 1], s.table[t, 0, 2]
    u0, v0 = u / mu, v / mv
    r = g = b = 0.0
    for i in range(count):
        o = (i + 0.5) / count - 0.5
        cu, cv = u0 + o * au, v0 + o * av
        for j in range(2):
            weight = blend if j == 1 else 1.0 - blend
            if weight < 1e-3:
                continue
            offset, w, h = s.table[t, k0 + j, 0], s.table[t, k0 + j, 1], s.table[t, k0 + j, 2]
            x, y = cu * w / w_0 - 0.5, cv * h / h_0 - 0.5
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
            r += w00 * s.texels[aa] + w01 * s.texels[ab] + w10 * s.texels[ba] + w11 * s.texels[bb]
            g += w00 * s.texels[aa + 1] + w01 * s.texels[ab + 1] + w10 * s.texels[ba + 1] + w11 * s.texels[bb + 1]
            b += w00 * s.texels[aa + 2] + w01 * s.texels[ab + 2] + w10 * s.texels[ba + 2] + w11 * s.texels[bb + 2]
    return r / count, g / count, b / count


@njit(cache=True, nogil=True, fastmath=True)
def _reflectance(s: SceneArrays, value: float) -> float:  # type: ignore[no-untyped-def]
    value = min(max(value, 0.0), 255.0)
    k = int(value)
    return s.linear[k] + (value - k) * (s.linear[k + 1] - s.linear[k])


@njit(cache=True, nogil=True, fastmath=True)
def _sky(s: SceneArrays, light: LightArrays, d: NDArray, dx: NDArray, dy: NDArray, out: NDArray) -> None:  # type: ignore[no-untyped-def]
    """Radiance of the sky along ``d`` (any length): gradient, glow round the sun, and clouds on a plane 400 m up, at infinity's place."""
    length = np.sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2])
    up = max(-d[1] / length, 0.0)
    towards = max((d[0] * light.sun[0] + d[1] * light.sun[1] + d[2] * light.sun[2]) / length, 0.0)
    glow = 0.25 * towards**8 + 0.5 * towards**64
    cover = 0.0
    if s.sky_texture >= 0 and up > 0.005:
        k = 400.0 / (up + 0.12) / length
        u, v = d[0] * k + light.cloud[0], d[2] * k + light.cloud[1]
        m, _, _ = _texture(s, s.sky_texture, u, v, dx[0] * k, dx[2] * k, dy[0] * k, dy[2] * k)
        cover = min(max((m / 255.0 - 1.0 + light.cloud[2]) * 2.5, 0.0), 1.0) * min(up * 8.0, 1.0)
    a = np.sqrt(up)
    for c in range(3):
        clear = light.horizon_rgb[c] * (1 - a) + light.zenith_rgb[c] * a + glow * light.sun_rgb[c] * 0.3
        out[c] = clear * (1 - cover) + cover * light.cloud[3] * (0.8 + glow)


@njit(cache=True, nogil=True, fastmath=True)
def hit_points(s: SceneArrays, origin: NDArray, rays: NDArray, triangle: NDArray, light: LightArrays,
               depth: NDArray, shadow_rays: NDArray, shadow_of: NDArray) -> int:  # type: ignore[no-untyped-def]  # fmt: skip
    """Depth along each ray (rays have length 1 along the optical axis) and the shadow rays of all points that face the sun.

    ``rays`` ``(n, 3)``, ``triangle`` ``(n,)`` (-1 = sky); fills ``depth`` ``(n,)`` (0 = sky), ``shadow_rays`` ``(m, 6)``, ``shadow_of``
    ``(m,)`` and returns m.
    """
    m = 0
    for i in range(len(rays)):
        t = triangle[i]
        depth[i] = 0.0
        if t < 0:
            continue
        n = s.plane[t]
        slope = n[0] * rays[i, 0] + n[1] * rays[i, 1] + n[2] * rays[i, 2]
        if abs(slope) < 1e-12:
            slope = 1e-12
        z = ((s.point[t, 0] - origin[0]) * n[0] + (s.point[t, 1] - origin[1]) * n[1] + (s.point[t, 2] - origin[2]) * n[2]) / slope
        depth[i] = z
        side = -1.0 if slope > 0 else 1.0
        facing = side * (n[0] * light.sun[0] + n[1] * light.sun[1] + n[2] * light.sun[2])
        if s.zone[t] >= 0 or facing <= 0.0:
            continue
        lift = side * (0.002 + 2e-4 * z)
        for c in range(3):
            shadow_rays[m, c] = origin[c] + z * rays[i, c] + lift * n[c]
            shadow_rays[m, 3 + c] = light.sun[c]
        shadow_of[m] = i
        m += 1
    return m


@njit(cache=True, nogil=True, fastmath=True)
def _irradiance(s: SceneArrays, light: LightArrays, t: int, p: NDArray, n: NDArray, lit: bool, out: NDArray) -> None:  # type: ignore[no-untyped-def]
    zone = s.zone[t]
    up = 0.5 - 0.5 * n[1]
    for c in range(3):
        out[c] = light.sky_rgb[c] * up + light.ground_rgb[c] * (1.0 - up)
    if zone < 0:
        if lit:
            facing = max(n[0] * light.sun[0] + n[1] * light.sun[1] + n[2] * light.sun[2], 0.0)
            for c in range(3):
                out[c] += light.sun_rgb[c] * facing
        return
    total = 0.0
    for k in range(s.zone_lamps[zone], s.zone_lamps[zone + 1]):
        x, y, z = s.lamps[k, 0] - p[0], s.lamps[k, 1] - p[1], s.lamps[k, 2] - p[2]
        square = x * x + y * y + z * z + 0.15
        facing = (n[0] * x + n[1] * y + n[2] * z) / np.sqrt(square)
        total += s.lamps[k, 3] * max(0.5 + 0.5 * facing, 0.0) / square
    for c in range(3):
        out[c] += light.lamp_rgb[c] * total


@njit(cache=True, nogil=True, fastmath=True)
def shade(s: SceneArrays, light: LightArrays, origin: NDArray, rays: NDArray, triangle: NDArray, depth: NDArray, lit: NDArray,
          step_x: NDArray, step_y: NDArray, radiance: NDArray) -> None:  # type: ignore[no-untyped-def]  # fmt: skip
    """Fill ``radiance`` ``(n, 3)``, linear. ``step_x``, ``step_y`` ``(3,)``: change of a ray from one sample to the next across and down."""
    p, n, e = np.empty(3), np.empty(3), np.empty(3)
    gx, gy = np.empty(3), np.empty(3)
    for i in range(len(rays)):
        t = triangle[i]
        d = rays[i]
        if t < 0:
            _sky(s, light, d, step_x, step_y, radiance[i])
            continue
        z = depth[i]
        plane = s.plane[t]
        slope = plane[0] * d[0] + plane[1] * d[1] + plane[2] * d[2]
        if abs(slope) < 1e-9:
            slope = 1e-9
        sx = -z * (plane[0] * step_x[0] + plane[1] * step_x[1] + plane[2] * step_x[2]) / slope
        sy = -z * (plane[0] * step_y[0] + plane[1] * step_y[1] + plane[2] * step_y[2]) / slope
        for c in range(3):
            p[c] = origin[c] + z * d[c] - s.point[t, c]
            gx[c] = z * step_x[c] + sx * d[c]
            gy[c] = z * step_y[c] + sy * d[c]
        G = s.uv_gradient[t]
        u = s.uv[t, 0] + G[0, 0] * p[0] + G[0, 1] * p[1] + G[0, 2] * p[2]
        v = s.uv[t, 1] + G[1, 0] * p[0] + G[1, 1] * p[1] + G[1, 2] * p[2]
        dux = G[0, 0] * gx[0] + G[0, 1] * gx[1] + G[0, 2] * gx[2]
        duy = G[0, 0] * gy[0] + G[0, 1] * gy[1] + G[0, 2] * gy[2]
        dvx = G[1, 0] * gx[0] + G[1, 1] * gx[1] + G[1, 2] * gx[2]
        dvy = G[1, 0] * gy[0] + G[1, 1] * gy[1] + G[1, 2] * gy[2]
        m = s.material[t]
        r, g, b = _texture(s, s.materials[m, 0], u, v, dux, dvx, duy, dvy)
        factor = 1.0
        for layer in range(1, 3):
            if s.materials[m, layer] >= 0:
                a, _, _ = _texture(s, s.materials[m, layer], u, v, dux, dvx, duy, dvy)
                factor *= a / 128.0
        length = 0.0
        for c in range(3):
            N = s.normal_gradient[t]
            n[c] = s.normal[t, c] + N[c, 0] * p[0] + N[c, 1] * p[1] + N[c, 2] * p[2]
            length += n[c] * n[c]
        length = np.sqrt(max(length, 1e-12))
        if slope > 0:
            length = -length
        for c in range(3):
            n[c] /= length
            p[c] += s.point[t, c]
        _irradiance(s, light, t, p, n, lit[i], e)
        haze = 1.0 - np.exp(-z / light.haze_m)
        tint = s.tint[t]
        radiance[i, 0] = _reflectance(s, r * factor) * tint[0] * e[0] * (1 - haze) + haze * light.horizon_rgb[0]
        radiance[i, 1] = _reflectance(s, g * factor) * tint[1] * e[1] * (1 - haze) + haze * light.horizon_rgb[1]
        radiance[i, 2] = _reflectance(s, b * factor) * tint[2] * e[2] * (1 - haze) + haze * light.horizon_rgb[2]


@njit(cache=True, nogil=True, fastmath=True)
def edge_pixels(group: NDArray, triangle: NDArray, depth: NDArray, lit: NDArray, h: int, w: int) -> NDArray:  # type: ignore[no-untyped-def]
    """Pixels across which the surface, its shadow or its depth breaks: indices ``(m,)`` of those that need more samples."""
    mark = np.zeros(h * w, np.bool_)
    for y in range(h):
        for x in range(w):
            i = y * w + x
            for step in range(2):
                if (step == 0 and x + 1 >= w) or (step == 1 and y + 1 >= h):
                    continue
                j = i + 1 if step == 0 else i + w
                a, b = triangle[i], triangle[j]
                ga = group[a] if a >= 0 else -1
                gb = group[b] if b >= 0 else -1
                broken = ga != gb or lit[i] != lit[j]
                if not broken and a >= 0 and a != b:
                    k = i - 1 if step == 0 else i - w
                    inside = x > 0 if step == 0 else y > 0
                    if inside and depth[k] > 0:
                        bend = abs(1 / depth[k] - 2 / depth[i] + 1 / depth[j])
                        broken = bend * depth[i] > 0.02
                if broken:
                    mark[i] = True
                    mark[j] = True
    return np.nonzero(mark)[0]
