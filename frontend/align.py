"""Small patches of one image found in another, from a good guess, with the change of scale and turn known: compiled.

Inverse-compositional Lucas-Kanade (Baker and Matthews, IJCV 2004) on a translation; brightness and contrast may
differ. Other than frame-to-frame flow it always compares with the key-frame's own patch, so errors do not add up, and
a point may be lost and found.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]
HALF = 5
"""Patches are 11 x 11 pixels."""
_SIDE = 2 * HALF + 1
_STEPS = 12
_CONVERGED_PX = 0.02
_REORDER = {"reassoc", "contract", "arcp", "nsz"}
"""What the compiler may do to sums for speed; NaN must stay NaN."""
_FLAT = 12.0
"""Smallest eigenvalue of the mean gradient matrix, grey levels squared a pixel squared, of a patch that has a place."""


def half_sized(image: NDArray[np.uint8], levels: int) -> list[NDArray[np.uint8]]:
    """The image and its halvings; pixel ``x`` of level k lies at ``2^k x`` of level 0."""
    out = [image]
    for _ in range(levels):
        out.append(cv2.pyrDown(out[-1]).astype(np.uint8, copy=False))
    return out


@njit(cache=True, nogil=True, fastmath=_REORDER)
def _sample(image: NDArray[np.uint8], x: float, y: float) -> float:
    # Unsigned indices need no test for counting from the end.
    x0, y0 = np.uint32(x), np.uint32(y)
    x1, y1 = x0 + np.uint32(1), y0 + np.uint32(1)
    a, b = x - x0, y - y0
    top = (1.0 - a) * image[y0, x0] + a * image[y0, x1]
    bottom = (1.0 - a) * image[y1, x0] + a * image[y1, x1]
    return (1.0 - b) * top + b * bottom


@njit(cache=True, nogil=True)
def _cut(image: NDArray[np.uint8], x: float, y: float, out: Array) -> None:
    """The patch around a point with a border of one pixel; all its samples share their weights."""
    x0, y0 = int(x), int(y)
    a, b = x - x0, y - y0
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    for r in range(_SIDE + 2):
        for c in range(_SIDE + 2):
            yy, xx = y0 + r - HALF - 1, x0 + c - HALF - 1
            out[r, c] = (
                w00 * image[yy, xx] + w01 * image[yy, xx + 1] + w10 * image[yy + 1, xx] + w11 * image[yy + 1, xx + 1]
            )


@njit(cache=True, nogil=True, fastmath=_REORDER)
def align_patches(
    source: NDArray[np.uint8], target: NDArray[np.uint8], uv: Array, warp: Array, guess: Array, reach_px: float
) -> tuple[Array, Array]:
    """Positions ``(n, 2)`` in ``target`` of patches around ``uv`` ``(n, 2)`` of ``source``, and their correlation
    ``(n,)``, -1 = failed.

    ``warp`` ``(n, 2, 2)``: how a step in ``source`` shows in ``target``; ``guess`` ``(n, 2)``; a patch that moves
    farther than ``reach_px`` from its guess has failed.
    """
    n = len(uv)
    out, score = guess.copy(), np.full(n, -1.0)
    height_s, width_s = source.shape
    height_t, width_t = target.shape
    T, gx, gy = np.zeros(_SIDE * _SIDE), np.zeros(_SIDE * _SIDE), np.zeros(_SIDE * _SIDE)
    I, P = np.zeros(_SIDE * _SIDE), np.zeros((_SIDE + 2, _SIDE + 2))
    count = _SIDE * _SIDE
    for i in range(n):
        x, y = uv[i, 0], uv[i, 1]
        if not (x >= HALF + 2 and y >= HALF + 2 and x < width_s - HALF - 3 and y < height_s - HALF - 3):
            continue
        A = warp[i]
        det = A[0, 0] * A[1, 1] - A[0, 1] * A[1, 0]
        if not (0.1 < det < 10.0):
            continue
        b00, b01, b10, b11 = A[1, 1] / det, -A[0, 1] / det, -A[1, 0] / det, A[0, 0] / det
        mean, mx, my = 0.0, 0.0, 0.0
        _cut(source, x, y, P)
        k = 0
        for r in range(1, _SIDE + 1):
            for c in range(1, _SIDE + 1):
                T[k] = P[r, c]
                sx, sy = 0.5 * (P[r, c + 1] - P[r, c - 1]), 0.5 * (P[r + 1, c] - P[r - 1, c])
                # The template's gradient as a step in the target image sees it.
                gx[k], gy[k] = sx * b00 + sy * b10, sx * b01 + sy * b11
                mean, mx, my = mean + T[k], mx + gx[k], my + gy[k]
                k += 1
        mean, mx, my = mean / count, mx / count, my / count
        hxx, hxy, hyy, var_T = 0.0, 0.0, 0.0, 0.0
        for k in range(count):
            T[k] -= mean
            gx[k] -= mx
            gy[k] -= my
            hxx, hxy, hyy = hxx + gx[k] * gx[k], hxy + gx[k] * gy[k], hyy + gy[k] * gy[k]
            var_T += T[k] * T[k]
        det_h = hxx * hyy - hxy * hxy
        smallest = 0.5 * (hxx + hyy - np.sqrt((hxx - hyy) ** 2 + 4.0 * hxy * hxy))
        if smallest < _FLAT * count * 0.1 or det_h <= 0.0:
            continue
        span_x = HALF * (abs(A[0, 0]) + abs(A[0, 1])) + 1.0
        span_y = HALF * (abs(A[1, 0]) + abs(A[1, 1])) + 1.0
        u, v = guess[i, 0], guess[i, 1]
        for step in range(_STEPS):
            if not (u >= span_x and v >= span_y and u < width_t - span_x - 1.0 and v < height_t - span_y - 1.0):
                score[i] = -1.0
                break
            mean_I, var_I, cross = 0.0, 0.0, 0.0
            k = 0
            for dy in range(-HALF, HALF + 1):
                for dx in range(-HALF, HALF + 1):
                    I[k] = _sample(target, u + A[0, 0] * dx + A[0, 1] * dy, v + A[1, 0] * dx + A[1, 1] * dy)
                    mean_I += I[k]
                    k += 1
            mean_I /= count
            for k in range(count):
                I[k] -= mean_I
                var_I += I[k] * I[k]
                cross += I[k] * T[k]
            if var_I < 1e-6:
                score[i] = -1.0
                break
            gain = np.sqrt(var_T / var_I)
            score[i] = cross / np.sqrt(var_I * var_T)
            bx, by = 0.0, 0.0
            for k in range(count):
                r = gain * I[k] - T[k]
                bx, by = bx + gx[k] * r, by + gy[k] * r
            du, dv = -(hyy * bx - hxy * by) / det_h, -(hxx * by - hxy * bx) / det_h
            u, v = u + du, v + dv
            if (u - guess[i, 0]) ** 2 + (v - guess[i, 1]) ** 2 > reach_px * reach_px:
                score[i] = -1.0
                break
            if du * du + dv * dv < _CONVERGED_PX * _CONVERGED_PX:
                break
            if step == _STEPS - 1 and du * du + dv * dv > 0.1:
                score[i] = -1.0
        if score[i] > -1.0:
            out[i, 0], out[i, 1] = u, v
    return out, score


def align(
    source: list[NDArray[np.uint8]],
    target: list[NDArray[np.uint8]],
    uv: Array,
    warp: Array,
    guess: Array,
    min_score: float,
    reach_px: float,
) -> tuple[Array, NDArray[np.bool_]]:
    """Coarse to fine over the levels of :func:`half_sized`; positions ``(n, 2)`` and which were found."""
    at = guess.copy()
    for level in range(len(source) - 1, 0, -1):
        factor = 0.5**level
        found, score = align_patches(source[level], target[level], uv * factor, warp, at * factor, reach_px * factor)
        at = np.where((score > 0.3)[:, None], found / factor, at)
    found, score = align_patches(source[0], target[0], uv, warp, at, reach_px if len(source) == 1 else 4.0)
    return found, score >= min_score
