"""Compiled texture look-ups: filtered over the pixel's footprint, so that texture neither aliases nor swims."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from ..scene.texture_atlas import LEVELS

MAX_ANISOTROPY = 6
"""Samples at most along the long axis of a stretched pixel footprint."""


@kernel(fastmath=True, error_model="numpy", inline="always")
def _footprint(dux: float, dvx: float, duy: float, dvy: float, most: int) -> tuple[float, float, int, float]:
    """The long axis of a footprint in texels, the number of samples along it (at most ``most``) and the mip level that
    each needs."""
    px, py = dux * dux + dvx * dvx, duy * duy + dvy * dvy
    if px > py:
        au, av, major, minor = dux, dvx, np.sqrt(px), np.sqrt(py)
    else:
        au, av, major, minor = duy, dvy, np.sqrt(py), np.sqrt(px)
    if major <= 1.0:
        return au, av, 1, 0.0
    count = min(int(np.ceil(major / max(minor, 1.0) - 0.25)), most)
    # A float's bits, read as an integer, are its logarithm but for a bow of 0.09: enough to choose a level, and cheap.
    lod = np.float32(max(major / count, 1.0)).view(np.int32) * (1.0 / 8388608.0) - 127.0
    # Levels are blended over the middle half of the way between them only: elsewhere one look-up serves for two.
    whole = np.floor(lod)
    return au, av, count, whole + min(max(2.0 * (lod - whole) - 0.5, 0.0), 1.0)


@kernel(fastmath=True, error_model="numpy", inline="always")
def rgb_at(
    texels: NDArray,
    table: NDArray,
    clamped: bool,
    t: int,
    u: float,
    v: float,
    dux: float,
    dvx: float,
    duy: float,
    dvy: float,
) -> tuple[float, float, float]:
    """Texture ``t`` at (u, v) texels, averaged over the parallelogram of the pixel's gradients: trilinear samples
    along its long axis."""
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
            # Unsigned: a signed index costs a test for counting from the end.
            aa, ab = np.uintp(3 * (offset + ya * w + xa)), np.uintp(3 * (offset + ya * w + xb))
            ba, bb = np.uintp(3 * (offset + yb * w + xa)), np.uintp(3 * (offset + yb * w + xb))
            w11 = fx * fy * weight
            w01, w10 = fx * weight - w11, fy * weight - w11
            w00 = weight - w01 - w10 - w11
            r += w00 * texels[aa] + w01 * texels[ab] + w10 * texels[ba] + w11 * texels[bb]
            g += (
                w00 * texels[aa + np.uintp(1)]
                + w01 * texels[ab + np.uintp(1)]
                + w10 * texels[ba + np.uintp(1)]
                + w11 * texels[bb + np.uintp(1)]
            )
            b += (
                w00 * texels[aa + np.uintp(2)]
                + w01 * texels[ab + np.uintp(2)]
                + w10 * texels[ba + np.uintp(2)]
                + w11 * texels[bb + np.uintp(2)]
            )
    total = (1.0 if blend >= 0.02 else 1.0 - blend) if blend <= 0.98 else blend
    return r / total, g / total, b / total


@kernel(fastmath=True, error_model="numpy", inline="always")
def grey_at(
    texels: NDArray, table: NDArray, t: int, u: float, v: float, dux: float, dvx: float, duy: float, dvy: float
) -> float:
    """Like :func:`rgb_at` for the first channel of a repeating texture, with fewer samples: for layers that only
    modulate."""
    au, av, count, lod = _footprint(dux, dvx, duy, dvy, 2)
    k0 = min(int(lod), LEVELS - 2)
    if table[t, k0, 1] <= 8:
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
            xa, xb, ya, yb = (
                x0 & (w - 1),
                (x0 + 1) & (w - 1),
                offset + (y0 & (h - 1)) * w,
                offset + ((y0 + 1) & (h - 1)) * w,
            )
            top = texels[np.uintp(3 * (ya + xa))] * (1 - fx) + texels[np.uintp(3 * (ya + xb))] * fx
            low = texels[np.uintp(3 * (yb + xa))] * (1 - fx) + texels[np.uintp(3 * (yb + xb))] * fx
            total += weight * (top * (1 - fy) + low * fy)
    return total
