"""Pyramidal Lucas-Kanade: points of one image found in another."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from ..config import FlowConfig

_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.02)


def follow(
    source: NDArray[np.uint8],
    target: NDArray[np.uint8],
    uv: NDArray[np.float64],
    guess: NDArray[np.float64],
    config: FlowConfig,
    levels: int | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Positions ``(n, 2)`` in ``target`` of the points ``uv`` of ``source``, searched from ``guess``, and which were
    found.

    Found: converged inside the image with a small grey-level difference. OpenCV throws on no points at all; we do not.
    """
    if not len(uv):
        return np.zeros((0, 2)), np.zeros(0, dtype=bool)
    height, width = target.shape
    start = np.ascontiguousarray(guess, dtype=np.float32).reshape(-1, 1, 2)
    found, status, error = cv2.calcOpticalFlowPyrLK(
        source,
        target,
        np.ascontiguousarray(uv, dtype=np.float32).reshape(-1, 1, 2),
        start.copy(),
        winSize=(config.window_px, config.window_px),
        maxLevel=config.levels if levels is None else levels,
        criteria=_CRITERIA,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=1e-4,
    )
    xy = found.reshape(-1, 2).astype(np.float64)
    inside = (xy >= 2.0).all(axis=1) & (xy[:, 0] < width - 3.0) & (xy[:, 1] < height - 3.0)
    ok = (status.ravel() > 0) & inside & (error.ravel() < config.max_error)
    return xy, ok


def follow_both_ways(
    source: NDArray[np.uint8],
    target: NDArray[np.uint8],
    uv: NDArray[np.float64],
    guess: NDArray[np.float64],
    config: FlowConfig,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """As :func:`follow`, and tracking back must end within ``round_trip_px`` of the start."""
    xy, ok = follow(source, target, uv, guess, config)
    index = np.flatnonzero(ok)
    back, returned = follow(target, source, xy[index], uv[index], config, min(1, config.levels))
    ok[index] = returned & (np.linalg.norm(back - uv[index], axis=1) < config.round_trip_px)
    return xy, ok
