"""Small patches kept from one image and found in others, from a good guess, with the change of scale and turn known:
compiled.

Inverse-compositional Lucas-Kanade (Baker and Matthews, IJCV 2004) on a translation; brightness and contrast may
differ. Unlike frame-to-frame flow, it always compares with the patch as it was first seen, so errors do not add
up, and a point may be lost and found. The kept patch is turned and scaled once into the view of the image it is looked
for in; then all its samples share their weights, which leaves the compiler rows it can work on many pixels at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

Array = NDArray[np.float64]
Sums = tuple[np.float32, ...]
HALF = 5
"""What is compared: 11 x 11 pixels of the image searched."""
KEPT = 9
"""What is kept: 19 x 19 pixels, enough for a turn of 45 degrees or a view from 1.5 times as far away."""
_SIDE, _KEPT_SIDE = 2 * HALF + 1, 2 * KEPT + 1
_LANE = 16
"""Rows are padded to this many samples of no weight, and each column has sums of its own until the end: whole vectors
of the processor, and the same order of summation on all of them."""
_STEPS = 12
_CONVERGED_PX = 0.01
_COARSE_CONVERGED_PX = 0.02
_COARSE_SCORE = 0.3
_REFINE_PX = 4.0
"""The coarse search leaves no more than this to the fine one."""
_SAME_VIEW_PX = 0.05
"""A turn that moves the patch's border by less is none."""
_FLAT = 1.2
"""Smallest eigenvalue of the mean gradient matrix, grey levels squared a pixel squared, of a patch that has a place."""

_SAME_GREY = 1e-2
"""Sum of squares about the mean, grey levels squared, of a patch whose pixels are all the same."""


@dataclass(frozen=True)
class Patches:
    """Appearance of ``n`` points: ``uv`` ``(n, 2)`` pixels of the image they were cut from, and on each of its levels
    ``pixels`` ``(n, levels, 19, 19)`` around the nearest pixel. Rows may be taken, and joined from several images."""

    uv: Array
    pixels: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.uv)

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> Patches:
        """The patches of ``rows`` (indices or a mask)."""
        return Patches(self.uv[rows], self.pixels[rows])


def half_sized(image: NDArray[np.uint8], levels: int) -> list[NDArray[np.uint8]]:
    """The image and its halvings; pixel ``x`` of level k lies at ``2^k x`` of level 0."""
    out = [np.ascontiguousarray(image)]
    for _ in range(levels):
        out.append(cv2.pyrDown(out[-1]).astype(np.uint8, copy=False))
    return out


def cut_patches(image: list[NDArray[np.uint8]], uv: Array) -> Patches:
    """Patches of the levels of :func:`half_sized` around ``uv`` ``(n, 2)``; beyond the border its pixels repeat."""
    pixels = np.empty((len(uv), len(image), _KEPT_SIDE, _KEPT_SIDE), dtype=np.uint8)
    for level, at_level in enumerate(image):
        _cut(at_level, uv, level, pixels)
    return Patches(uv, pixels)


@kernel
def _cut(image: NDArray[np.uint8], uv: Array, level: int, out: NDArray[np.uint8]) -> None:
    height, width = image.shape
    factor = 0.5**level
    for i in range(len(uv)):
        x0, y0 = int(np.floor(uv[i, 0] * factor + 0.5)) - KEPT, int(np.floor(uv[i, 1] * factor + 0.5)) - KEPT
        for r in range(_KEPT_SIDE):
            y = min(max(y0 + r, 0), height - 1)
            if x0 >= 0 and x0 + _KEPT_SIDE <= width:
                for c in range(_KEPT_SIDE):
                    out[i, level, r, c] = image[y, x0 + c]
            else:
                for c in range(_KEPT_SIDE):
                    out[i, level, r, c] = image[y, min(max(x0 + c, 0), width - 1)]


@kernel
def _turned(kept: NDArray[np.uint8], fx: float, fy: float, A: Array, det: float, out: NDArray[np.float32]) -> None:
    """The kept patch ``(19 * 19)`` as the image searched shows it, with a border of one pixel, ``(13, 18)``; ``fx``,
    ``fy``: where the point lies off the patch's middle pixel. In fixed point: half as long as in floating point."""
    one = 65536.0
    b00, b01 = np.int32(A[1, 1] / det * one), np.int32(-A[0, 1] / det * one)
    b10, b11 = np.int32(-A[1, 0] / det * one), np.int32(A[0, 0] / det * one)
    # Weights are cut to 8 bits: half a step more rounds them.
    x_mid, y_mid = np.int32((KEPT + fx) * one) + np.int32(128), np.int32((KEPT + fy) * one) + np.int32(128)
    eight, sixteen, mask = np.int32(8), np.int32(16), np.int32(255)
    low, high, grey = np.int32(0), np.int32(2 * KEPT * 65536 - 1), np.float32(1.0 / one)
    right, below = np.uint32(1), np.uint32(_KEPT_SIDE)
    for r in range(_SIDE + 2):
        dy = np.int32(r - HALF - 1)
        x_row, y_row = x_mid + b01 * dy - b00 * np.int32(HALF + 1), y_mid + b11 * dy - b10 * np.int32(HALF + 1)
        for c in range(_SIDE + 2):
            x, y = min(max(x_row, low), high), min(max(y_row, low), high)
            x_row, y_row = x_row + b00, y_row + b10
            a, b = (x >> eight) & mask, (y >> eight) & mask
            # Unsigned indices need no test for counting from the end.
            k = np.uint32(y >> sixteen) * below + np.uint32(x >> sixteen)
            p00, p01 = np.int32(kept[k]), np.int32(kept[k + right])
            p10, p11 = np.int32(kept[k + below]), np.int32(kept[k + below + right])
            top, bottom = (p00 << eight) + a * (p01 - p00), (p10 << eight) + a * (p11 - p10)
            out[r, c] = np.float32((top << eight) + b * (bottom - top)) * grey


@kernel
def _shifted(kept: NDArray[np.uint8], fx: float, fy: float, out: NDArray[np.float32]) -> None:
    """:func:`_turned` without a turn: all samples share their weights."""
    x0, y0 = int(np.floor(KEPT + fx)), int(np.floor(KEPT + fy))
    a, b, one = np.float32(KEPT + fx - x0), np.float32(KEPT + fy - y0), np.float32(1.0)
    w00, w01, w10, w11 = (one - a) * (one - b), a * (one - b), (one - a) * b, a * b
    for r in range(_SIDE + 2):
        at = np.uint64((y0 + r - HALF - 1) * _KEPT_SIDE + x0 - HALF - 1)
        below = at + np.uint64(_KEPT_SIDE)
        for j in range(_SIDE + 2):
            c = np.uint64(j)
            out[r, j] = (
                w00 * np.float32(kept[at + c])
                + w01 * np.float32(kept[at + c + np.uint64(1)])
                + w10 * np.float32(kept[below + c])
                + w11 * np.float32(kept[below + c + np.uint64(1)])
            )


@kernel
def _template(
    P: NDArray[np.float32],
    inside: NDArray[np.float32],
    T: NDArray[np.float32],
    gx: NDArray[np.float32],
    gy: NDArray[np.float32],
    acc: NDArray[np.float32],
) -> tuple[Sums, Sums]:
    """Patch less its middle pixel, and its gradients, ``(11 * 16)``, of a turned patch, zero in the padding. Returns
    the middle pixel and the three sums; the sums of products about the means: of the patch with itself and with each
    gradient, and of the gradients. The means come out of the sums, not of the arrays: that takes one pass."""
    count, half, zero = np.float32(_SIDE * _SIDE), np.float32(0.5), np.float32(0.0)
    one, two, lane = np.uint64(1), np.uint64(2), np.uint64(_LANE)
    middle = P[HALF + 1, HALF + 1]
    acc[:] = zero
    for r in range(_SIDE):
        for j in range(_LANE):
            c = np.uint64(j)
            k = np.uint64(r * _LANE) + c
            w = inside[k]
            t = (P[r + 1, c + one] - middle) * w
            x, y = half * w * (P[r + 1, c + two] - P[r + 1, c]), half * w * (P[r + 2, c + one] - P[r, c + one])
            T[k], gx[k], gy[k] = t, x, y
            acc[c] += t
            acc[c + lane] += x
            acc[c + np.uint64(2) * lane] += y
            acc[c + np.uint64(3) * lane] += t * t
            acc[c + np.uint64(4) * lane] += t * x
            acc[c + np.uint64(5) * lane] += t * y
            acc[c + np.uint64(6) * lane] += x * x
            acc[c + np.uint64(7) * lane] += x * y
            acc[c + np.uint64(8) * lane] += y * y
    st, sx, sy, tt, tx, ty, xx, xy, yy = zero, zero, zero, zero, zero, zero, zero, zero, zero
    for j in range(_LANE):
        st, sx, sy = st + acc[j], sx + acc[j + _LANE], sy + acc[j + 2 * _LANE]
        tt, tx, ty = tt + acc[j + 3 * _LANE], tx + acc[j + 4 * _LANE], ty + acc[j + 5 * _LANE]
        xx, xy, yy = xx + acc[j + 6 * _LANE], xy + acc[j + 7 * _LANE], yy + acc[j + 8 * _LANE]
    tt, tx, ty = tt - st * st / count, tx - st * sx / count, ty - st * sy / count
    xx, xy, yy = xx - sx * sx / count, xy - sx * sy / count, yy - sy * sy / count
    return (middle, st, sx, sy), (tt, tx, ty, xx, xy, yy)


@kernel
def _compare(
    flat: NDArray[np.uint8],
    width: int,
    u: float,
    v: float,
    offset: np.float32,
    T: NDArray[np.float32],
    gx: NDArray[np.float32],
    gy: NDArray[np.float32],
    inside: NDArray[np.float32],
    acc: NDArray[np.float32],
) -> Sums:
    """Sums over the image's patch at ``(u, v)``, ``offset`` taken off: of its values, of their squares, and of their
    products with the template and its gradients."""
    x0, y0 = int(u), int(v)
    a, b = np.float32(u - x0), np.float32(v - y0)
    one = np.float32(1.0)
    w00, w01, w10, w11 = (one - a) * (one - b), a * (one - b), (one - a) * b, a * b
    acc[: 5 * _LANE] = 0.0
    for r in range(_SIDE):
        # Padding may read on into the next row: there is one, and it has no weight.
        at = np.uint64((y0 + r - HALF) * width + x0 - HALF)
        below = at + np.uint64(width)
        k = np.uint64(r * _LANE)
        for j in range(_LANE):
            c = np.uint64(j)
            value = (
                w00 * np.float32(flat[at + c])
                + w01 * np.float32(flat[at + c + np.uint64(1)])
                + w10 * np.float32(flat[below + c])
                + w11 * np.float32(flat[below + c + np.uint64(1)])
                - offset
            )
            weighted = value * inside[k + c]
            acc[c] += weighted
            acc[c + np.uint64(_LANE)] += weighted * value
            acc[c + np.uint64(2 * _LANE)] += value * T[k + c]
            acc[c + np.uint64(3 * _LANE)] += value * gx[k + c]
            acc[c + np.uint64(4 * _LANE)] += value * gy[k + c]
    total = squares = cross = bx = by = np.float32(0.0)
    for j in range(_LANE):
        total += acc[j]
        squares += acc[j + _LANE]
        cross += acc[j + 2 * _LANE]
        bx += acc[j + 3 * _LANE]
        by += acc[j + 4 * _LANE]
    return total, squares, cross, bx, by


@kernel
def _align_level(
    pixels: NDArray[np.uint8],
    uv: Array,
    level: int,
    target: NDArray[np.uint8],
    warp: Array,
    guess: Array,
    reach_px: float,
    converged_px: float,
) -> tuple[Array, Array]:
    """Positions ``(n, 2)`` on one level and correlations ``(n,)``, -1 = failed; ``guess`` and ``reach_px`` in pixels of
    the level."""
    n, factor = len(uv), 0.5**level
    out, score = guess.copy(), np.full(n, -1.0)
    height, width = target.shape
    flat = target.reshape(height * width)
    count = _SIDE * _SIDE
    P = np.zeros((_SIDE + 2, _LANE + 2), dtype=np.float32)
    T, inside = np.zeros(_SIDE * _LANE, dtype=np.float32), np.zeros(_SIDE * _LANE, dtype=np.float32)
    gx, gy = np.zeros(_SIDE * _LANE, dtype=np.float32), np.zeros(_SIDE * _LANE, dtype=np.float32)
    acc = np.zeros(9 * _LANE, dtype=np.float32)
    for r in range(_SIDE):
        inside[r * _LANE : r * _LANE + _SIDE] = 1.0
    kept = pixels.reshape(n, pixels.shape[1], _KEPT_SIDE * _KEPT_SIDE)
    for i in range(n):
        A = warp[i]
        det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        if not (0.1 < det < 10.0):
            continue
        x, y = uv[i, 0] * factor, uv[i, 1] * factor
        fx, fy = x - np.floor(x + 0.5), y - np.floor(y + 0.5)
        if max(abs(A[0, 0] - 1.0) + abs(A[0, 1]), abs(A[1, 0]) + abs(A[1, 1] - 1.0)) * (HALF + 1) < _SAME_VIEW_PX:
            _shifted(kept[i, level], fx, fy, P)
        else:
            _turned(kept[i, level], fx, fy, A, det, P)
        (offset, sum_T, sum_gx, sum_gy), (var_T, own_x, own_y, hxx, hxy, hyy) = _template(P, inside, T, gx, gy, acc)
        det_h = hxx * hyy - hxy * hxy
        smallest = 0.5 * (hxx + hyy - np.sqrt((hxx - hyy) ** 2 + 4.0 * hxy * hxy))
        # A patch beside an edge may have gradients at its border alone: all its pixels are the same.
        if smallest < _FLAT * count or det_h <= 0.0 or var_T < _SAME_GREY:
            continue
        u, v = guess[i, 0], guess[i, 1]
        for step in range(_STEPS):
            if not (u >= HALF and v >= HALF and u < width - HALF - 1 and v < height - HALF - 2):
                score[i] = -1.0
                break
            total, squares, cross, bx, by = _compare(flat, width, u, v, offset, T, gx, gy, inside, acc)
            mean = total / count
            var_I = squares - mean * total
            if var_I < _SAME_GREY:
                score[i] = -1.0
                break
            score[i] = (cross - mean * sum_T) / np.sqrt(var_I * var_T)
            gain = np.sqrt(var_T / var_I)
            bx, by = gain * (bx - mean * sum_gx) - own_x, gain * (by - mean * sum_gy) - own_y
            du, dv = -(hyy * bx - hxy * by) / det_h, -(hxx * by - hxy * bx) / det_h
            u, v = u + du, v + dv
            if (u - guess[i, 0]) ** 2 + (v - guess[i, 1]) ** 2 > reach_px * reach_px:
                score[i] = -1.0
                break
            if du * du + dv * dv < converged_px * converged_px:
                break
            if step == _STEPS - 1 and du * du + dv * dv > 0.1:
                score[i] = -1.0
        if score[i] > -1.0:
            out[i, 0], out[i, 1] = u, v
    return out, score


def align(
    patches: Patches, target: list[NDArray[np.uint8]], warp: Array, guess: Array, min_score: float, reach_px: float
) -> tuple[Array, NDArray[np.bool_]]:
    """Where ``patches`` show in ``target`` (levels of :func:`half_sized`, as many as were cut), coarse to fine:
    positions ``(n, 2)`` and which were found.

    ``warp`` ``(n, 2, 2)``: how a step in the image they were cut from shows in ``target``; ``guess`` ``(n, 2)``. Found:
    no farther than ``reach_px`` from the guess, with a correlation of at least ``min_score``.
    """
    warp = np.require(warp, requirements=("C", "W"))  # one kind of array: the kernel is compiled once
    at, last = guess, len(target) - 1
    for level in range(last, 0, -1):
        factor = 0.5**level
        found, score = _align_level(
            patches.pixels, patches.uv, level, target[level], warp, at * factor, reach_px * factor, _COARSE_CONVERGED_PX
        )
        at = np.where((score > _COARSE_SCORE)[:, None], found / factor, at)
    reach = _REFINE_PX if last else reach_px
    found, score = _align_level(patches.pixels, patches.uv, 0, target[0], warp, at, reach, _CONVERGED_PX)
    return found, score >= min_score
