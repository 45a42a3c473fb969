"""Compiled geometry of a picture: rays of pixels, the points they meet, and where neighbouring pixels part."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .shading_kernels import PLANE, LightArrays, SceneArrays


@kernel(fastmath=True, error_model="numpy")
def pack_rays(pixels: NDArray, which: NDArray, view: NDArray, out: NDArray) -> None:
    """Rays ``(m, 6)`` float32 (origin, direction of length 1 along the optical axis) of ``pixels[which]``.

    ``view`` ``(4, 3)``: the camera's centre, the direction of pixel (0, 0), its change from one column and one row to
    the next.
    """
    for j in range(len(which)):
        u, v = pixels[which[j], 0], pixels[which[j], 1]
        for c in range(3):
            out[j, c] = view[0, c]
            out[j, 3 + c] = view[1, c] + u * view[2, c] + v * view[3, c]


@kernel(fastmath=True, error_model="numpy")
def hit_points(
    s: SceneArrays,
    first: int,
    view: NDArray,
    pixels: NDArray,
    triangle: NDArray,
    light: LightArrays,
    depth: NDArray,
    group: NDArray,
    facing: NDArray,
) -> None:
    """Depth (0 = sky), surface group (-1 = sky) and whether the sun could shine there, for the pixels whose triangle
    is one of ``first`` .. ``first`` + len(s.row); the others are left alone."""
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
        depth[i] = (
            (row[t, 0] - view[0, 0]) * nx + (row[t, 1] - view[0, 1]) * ny + (row[t, 2] - view[0, 2]) * nz
        ) / slope
        side = -1.0 if slope > 0 else 1.0
        group[i] = s.group[t] + first
        facing[i] = s.zone[t] < 0 and side * (nx * light.sun[0] + ny * light.sun[1] + nz * light.sun[2]) > 0.0


@kernel(fastmath=True, error_model="numpy")
def pack_shadow_rays(rays: NDArray, depth: NDArray, which: NDArray, sun: NDArray, out: NDArray) -> None:
    """Rays ``(m, 6)`` towards the sun from the points that ``rays[k]`` ``(m, 6)`` see at ``depth[which[k]]``; they
    start a little before the surface, where the eye's ray comes from: that side of it is the one that is seen."""
    for j in range(len(which)):
        z = depth[which[j]]
        z -= 0.002 + 3e-4 * z
        for c in range(3):
            out[j, c] = rays[j, c] + z * rays[j, 3 + c] + 0.004 * sun[c]
            out[j, 3 + c] = sun[c]


@kernel
def odd_pixels(value: NDArray, other: NDArray, h: int, w: int) -> NDArray:
    """Fill the odd squares of a chessboard in ``value`` ``(h * w,)`` where all neighbours agree in it and in ``other``
    (whose odd squares count too); the indices of those that remain to be found out."""
    unknown = np.empty(h * w // 2 + h, np.int64)
    m = 0
    for y in range(h):
        for x in range((y + 1) % 2, w, 2):
            i = y * w + x
            j = i - 1 if x > 0 else i + 1
            same = True
            for k in (
                i - 1 if x > 0 else j,
                i + 1 if x + 1 < w else j,
                i - w if y > 0 else j,
                i + w if y + 1 < h else j,
            ):
                same &= value[k] == value[j] and other[k] == other[j]
            if same and other[i] == other[j]:
                value[i] = value[j]
            else:
                unknown[m] = i
                m += 1
    return unknown[:m].copy()


@kernel(fastmath=True, error_model="numpy")
def edge_pixels(group: NDArray, depth: NDArray, lit: NDArray, radiance: NDArray, h: int, w: int) -> NDArray:
    """Pixels across which the surface, its shadow or its depth breaks, and with it the colour: indices ``(m,)`` of
    those that need more samples."""
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
                contrast = 0.0
                if broken:
                    for c in range(3):
                        total = radiance[i, c] + radiance[j, c]
                        contrast = max(contrast, abs(radiance[i, c] - radiance[j, c]) / max(total, 1e-9))
                if contrast > 0.02:
                    mark[i] = True
                    mark[j] = True
    return np.nonzero(mark)[0]
