"""Which pixels of an image may give points: masks as detection and tracking ask them."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

CORNER_PX = 3
"""Radius of the circle of pixels that makes a corner: where it touches what is masked, the corner is the mask's."""


def are_used(used: NDArray[np.bool_] | None, uv: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the positions ``uv`` ``(n, 2)`` may give points by ``used`` ``(H, W)``, None: all; outside the image
    none may, nor what is no number."""
    if used is None:
        return np.ones(len(uv), dtype=bool)
    height, width = used.shape
    known = np.asarray(np.isfinite(uv).all(axis=1))
    at = np.rint(np.where(known[:, None], uv, -1.0))
    inside = known & (at >= 0).all(axis=1) & (at[:, 0] < width) & (at[:, 1] < height)
    column, row = at[inside].astype(np.intp).T
    out = np.zeros(len(uv), dtype=bool)
    out[inside] = used[row, column]
    return out


def corner_mask(used: NDArray[np.bool_]) -> NDArray[np.float32]:
    """1 where a corner may lie by ``used`` ``(H, W)``, else 0; outside the image nothing is masked."""
    side = 2 * CORNER_PX + 1
    return cv2.erode(used.astype(np.float32), np.ones((side, side), np.uint8)).astype(np.float32, copy=False)
