"""Alignment of the surfaces of RGB-D key-frames: whole depth images constrain relative poses.

Key-points are few and lie where there is texture; in a pan they hardly distinguish a rotation from a sideways
translation. Whole surfaces do: point-to-plane distances of one key-frame's depth to another's, associated by projection
(Chen and Medioni 1992, Rusinkiewicz and Levoy 2001). They enter the window's bundle adjustment as they are linearised,
``(6, 6)`` information and gradient of a pair's relative pose, so that a single plane constrains nothing along itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel
from maslam.backend.geometry import product, se3_inverse

from .linear_algebra import times3, times3_transposed, weighted_gram

Array = NDArray[np.float64]
Ints = NDArray[np.int64]
Depth = NDArray[np.float32]

_SAME_SURFACE = 0.03
"""Depths in a block that differ by less than this share are one surface."""
_FLAT = 0.015
"""A normal's neighbours may lie this share of the depth off a straight line: no normals across edges and on corners."""
_STEEP = 0.08
"""Change of depth, as a share, between the outer neighbours of a normal: beyond, the surface is seen too slantingly."""
_REACH = 1
"""Places between a normal's place and its neighbours."""
_MIN_COSINE = 0.85
"""Between the normals of associated places."""
_GATE_M, _GATE_SHARE = 0.03, 0.03
"""Associated places differ in depth by at most this much and this share of it."""
_ROBUST = 2.5
"""Residual, in standard deviations, at which a place counts a quarter."""
_FLOOR_M = 0.0007
_STRIDE = 2
"""Every so many-th row and column of places is looked for in the other surface, and counts for those left out."""
_MIN_SHARE, _MIN_PLACES = 0.35, 50
"""Of the places of one surface, those that must be found in the other."""


@dataclass(frozen=True)
class Surface:
    """``(h, w, 6)`` float32: point and unit normal (towards the camera) of each block of the image, in the camera
    frame, metres; NaN where there is none. ``block``: its side, pixels."""

    places: Depth
    block: int


@dataclass(frozen=True)
class DepthAlignment:
    """M pairs of key-frames, linearised at ``T_A_B`` ``(M, 4, 4)``: ``pairs`` ``(M, 2)`` their places in the window;
    ``information`` ``(M, 6, 6)`` and ``gradient`` ``(M, 6)`` by a left update of ``T_A_B`` (translation first);
    ``cost`` ``(M,)`` there."""

    pairs: Ints
    T_A_B: Array
    information: Array
    gradient: Array
    cost: Array

    @classmethod
    def none(cls) -> DepthAlignment:
        """Without a pair."""
        nothing = np.zeros((0, 4, 4)), np.zeros((0, 6, 6)), np.zeros((0, 6)), np.zeros(0)
        return cls(np.zeros((0, 2), dtype=np.int64), *nothing)

    def cost_at(self, poses: Array) -> float:
        """Cost of the linearised pairs at ``poses`` ``(K, 4, 4)``, ``T_C_W``."""
        if not len(self.pairs):  # without depth images the kernels are not even compiled
            return 0.0
        return float(_alignment_cost(poses, self.pairs, self.T_A_B, self.information, self.gradient, self.cost))

    def add_to(self, U: Array, b_c: Array, poses: Array, slot: Ints) -> None:
        """Add the pairs to the poses' normal equations ``U``, ``b_c`` (6 unknowns for each ``slot`` >= 0)."""
        if len(self.pairs):
            _add_alignment(poses, slot, self.pairs, self.T_A_B, self.information, self.gradient, U, b_c)


def surface(depth_m: Depth, cam: Array, max_depth_m: float, columns: int) -> Surface:
    """Points and normals of a depth image ``(H, W)``, metres, 0 = unknown, up to ``max_depth_m``; about ``columns``
    blocks wide. ``cam``: fx, fy, cx, cy, pixels."""
    block = max(1, round(depth_m.shape[1] / columns))
    places = np.full((depth_m.shape[0] // block, depth_m.shape[1] // block, 6), np.nan, dtype=np.float32)
    _average(np.ascontiguousarray(depth_m, dtype=np.float32), cam, block, max_depth_m, places)
    _normals(places)
    return Surface(places, block)


def align_surfaces(
    surfaces: list[Surface | None],
    poses: Array,
    pairs: list[tuple[int, int]],
    cam: Array,
    sigma_m: float,
    correlated: float,
) -> DepthAlignment:
    """Linearise each pair that overlaps, at ``poses`` ``(K, 4, 4)`` (``T_C_W``). ``sigma_m``: depth noise at 1 m;
    ``correlated``: so many neighbouring places err alike, their information counts as that of one."""
    found: list[tuple[tuple[int, int], Array, Array, Array, float]] = []
    for a, b in pairs:
        one, other = surfaces[a], surfaces[b]
        if one is None or other is None or one.places.shape != other.places.shape:
            continue
        T_A_B = product(poses[a], se3_inverse(poses[b]))
        H, g, cost, hits, tried = _point_to_plane(one.places, other.places, T_A_B, cam, one.block, sigma_m)
        if hits >= max(_MIN_PLACES, _MIN_SHARE * tried):
            found.append(((a, b), T_A_B, H / correlated, g / correlated, cost / correlated))
    if not found:
        return DepthAlignment.none()
    joined, transforms, matrices, gradients, costs = zip(*found, strict=True)
    return DepthAlignment(
        np.array(joined, dtype=np.int64), np.stack(transforms), np.stack(matrices), np.stack(gradients), np.array(costs)
    )


@kernel
def _average(depth: Depth, cam: Array, block: int, max_depth: float, out: Depth) -> None:
    """The mean of what lies on the same surface as a block's middle."""
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            middle = depth[y * block + block // 2, x * block + block // 2]
            if not 0.0 < middle <= max_depth:
                continue
            n, u, v, z = 0, 0.0, 0.0, 0.0
            for row in range(y * block, (y + 1) * block):
                for column in range(x * block, (x + 1) * block):
                    if abs(depth[row, column] - middle) < _SAME_SURFACE * middle:
                        n, u, v, z = n + 1, u + column, v + row, z + depth[row, column]
            if 2 * n >= block * block:
                z /= n
                out[y, x, 0] = (u / n - cam[2]) / cam[0] * z
                out[y, x, 1] = (v / n - cam[3]) / cam[1] * z
                out[y, x, 2] = z


@kernel
def _normals(places: Depth) -> None:
    """From the neighbours of each place, written into columns 3 to 5; NaN on edges."""
    k = _REACH
    for y in range(k, places.shape[0] - k):
        for x in range(k, places.shape[1] - k):
            p, left, right = places[y, x], places[y, x - k], places[y, x + k]
            up, down = places[y - k, x], places[y + k, x]
            across, along = right[2] - left[2], down[2] - up[2]
            if not (abs(across) < _STEEP * p[2] and abs(along) < _STEEP * p[2]):
                continue
            bend, fold = right[2] + left[2] - 2.0 * p[2], up[2] + down[2] - 2.0 * p[2]
            if not (abs(bend) < _FLAT * p[2] and abs(fold) < _FLAT * p[2]):
                continue
            a0, a1, d0, d1 = right[0] - left[0], right[1] - left[1], down[0] - up[0], down[1] - up[1]
            n0, n1, n2 = d1 * across - along * a1, along * a0 - d0 * across, d0 * a1 - d1 * a0
            length = np.sqrt(n0 * n0 + n1 * n1 + n2 * n2)
            p[3], p[4], p[5] = n0 / length, n1 / length, n2 / length


@kernel
def _point_to_plane(
    one: Depth, other: Depth, T: Array, cam: Array, block: int, sigma_m: float
) -> tuple[Array, Array, float, int, int]:
    """Information, gradient and cost of ``T`` (``T_A_B``); places of ``other`` found in ``one``, and
    those looked for."""
    H, g, J = np.zeros((6, 6)), np.zeros(6), np.zeros(6)
    cost, hits, tried = 0.0, 0, 0
    height, width, _ = one.shape
    half = 0.5 * (block - 1)
    for row in range(_STRIDE // 2, height, _STRIDE):
        for column in range(_STRIDE // 2, width, _STRIDE):
            p = other[row, column]
            if np.isnan(p[3]):
                continue
            tried += 1
            X = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
            Y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
            Z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
            if Z < 0.1:
                continue
            u = round((cam[0] * X / Z + cam[2] - half) / block)
            v = round((cam[1] * Y / Z + cam[3] - half) / block)
            if not (0 <= u < width and 0 <= v < height):
                continue
            q = one[v, u]
            n0, n1, n2 = q[3], q[4], q[5]
            if not abs(Z - q[2]) <= _GATE_M + _GATE_SHARE * Z:
                continue
            m0 = T[0, 0] * p[3] + T[0, 1] * p[4] + T[0, 2] * p[5]
            m1 = T[1, 0] * p[3] + T[1, 1] * p[4] + T[1, 2] * p[5]
            m2 = T[2, 0] * p[3] + T[2, 1] * p[4] + T[2, 2] * p[5]
            if not m0 * n0 + m1 * n1 + m2 * n2 >= _MIN_COSINE:
                continue
            r = n0 * (X - q[0]) + n1 * (Y - q[1]) + n2 * (Z - q[2])
            s = sigma_m * np.sqrt((q[2] * q[2] * n2) ** 2 + (p[2] * p[2] * p[5]) ** 2) + _FLOOR_M
            e = r / (s * _ROBUST)
            w = (_STRIDE / (s * (1.0 + e * e))) ** 2
            J[0], J[1], J[2] = n0, n1, n2
            J[3], J[4], J[5] = Y * n2 - Z * n1, Z * n0 - X * n2, X * n1 - Y * n0
            for a in range(6):
                g[a] += w * J[a] * r
                for c in range(6):
                    H[a, c] += w * J[a] * J[c]
            cost += w * r * r
            hits += 1
    return H, g, cost, hits, tried


@kernel
def _moved(T_A: Array, T_B: Array, T_A_B: Array) -> tuple[Array, Array]:
    """The relative pose now, ``(4, 4)``, and its left update ``(6,)`` since ``T_A_B``, to second order."""
    R = times3_transposed(T_A, T_B)
    E = times3_transposed(R, T_A_B)
    now, s, x = np.zeros((4, 4)), np.zeros(3), np.zeros(6)
    now[3, 3] = 1.0
    for i in range(3):
        t = T_A[i, 3] - (R[i, 0] * T_B[0, 3] + R[i, 1] * T_B[1, 3] + R[i, 2] * T_B[2, 3])
        s[i] = t - (E[i, 0] * T_A_B[0, 3] + E[i, 1] * T_A_B[1, 3] + E[i, 2] * T_A_B[2, 3])
        now[i, 0], now[i, 1], now[i, 2], now[i, 3] = R[i, 0], R[i, 1], R[i, 2], t
    x[3], x[4], x[5] = 0.5 * (E[2, 1] - E[1, 2]), 0.5 * (E[0, 2] - E[2, 0]), 0.5 * (E[1, 0] - E[0, 1])
    x[0] = s[0] - 0.5 * (x[4] * s[2] - x[5] * s[1])
    x[1] = s[1] - 0.5 * (x[5] * s[0] - x[3] * s[2])
    x[2] = s[2] - 0.5 * (x[3] * s[1] - x[4] * s[0])
    return now, x


@kernel
def _quadratic(H: Array, g: Array, x: Array) -> float:
    total = 0.0
    for a in range(6):
        total += 2.0 * g[a] * x[a]
        for c in range(6):
            total += x[a] * H[a, c] * x[c]
    return total


@kernel
def _alignment_cost(poses: Array, pairs: Ints, T_A_B: Array, H: Array, g: Array, cost: Array) -> float:
    total = 0.0
    for k in range(len(pairs)):
        _, x = _moved(poses[pairs[k, 0]], poses[pairs[k, 1]], T_A_B[k])
        total += cost[k] + _quadratic(H[k], g[k], x)
    return total


@kernel
def _add_alignment(
    poses: Array, slot: Ints, pairs: Ints, T_A_B: Array, H: Array, g: Array, U: Array, b_c: Array
) -> None:
    ones, across = np.ones(6), np.zeros((3, 3))
    for k in range(len(pairs)):
        now, x = _moved(poses[pairs[k, 0]], poses[pairs[k, 1]], T_A_B[k])
        across[0, 1], across[0, 2], across[1, 2] = -now[2, 3], now[1, 3], -now[0, 3]
        across[1, 0], across[2, 0], across[2, 1] = now[2, 3], -now[1, 3], now[0, 3]
        turned = times3(across, now)
        B = np.zeros((6, 6))  # what the update of B does to the pair's: -Ad(T_A_B)
        for r in range(3):
            for c in range(3):
                B[r, c], B[3 + r, 3 + c], B[r, 3 + c] = -now[r, c], -now[r, c], -turned[r, c]
        e, HB = g[k].copy(), np.zeros((6, 6))
        for r in range(6):
            for c in range(6):
                e[r] += H[k, r, c] * x[c]
                for q in range(6):
                    HB[r, c] += H[k, r, q] * B[q, c]
        BHB = weighted_gram(B, ones, HB)
        i, j = 6 * slot[pairs[k, 0]], 6 * slot[pairs[k, 1]]
        for r in range(6):
            if i >= 0:
                b_c[i + r] += e[r]
            for c in range(6):
                if i >= 0:
                    U[i + r, i + c] += H[k, r, c]
                if j >= 0:
                    U[j + r, j + c] += BHB[r, c]
                    b_c[j + r] += B[c, r] * e[c]
                if i >= 0 and j >= 0:
                    U[i + r, j + c] += HB[r, c]
                    U[j + r, i + c] += HB[c, r]
