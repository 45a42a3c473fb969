"""Whether depth lies on its image: steps of the depth are mostly edges of the image, in the right place only."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from maslam.frontend.datasets import Problem
    from maslam.frontend.frames import Frame

_STEP = 0.15
"""Of the nearer depth: a smaller one is a slope seen at a grazing angle."""
_SPAN_PX = 4
"""A step is looked for across so many pixels: many sensors do not know the depth right at it."""
_REACH_PX = (24, 12)
_GRID_PX = 2
_PER_FRAME = 4000
_ENOUGH = 1000
"""Fewest pixels on steps of the depth, in all frames, from which anything is concluded."""
_CLEAR = 3.0
"""Standard deviations above the mean of all offsets that a peak stands out by."""
_FLAT = 1.0
"""Fewer than this, and the edges of the image do not know the steps of the depth."""
_BETTER = 1.15
_NEAR_PX = 3.0
"""Offsets up to this are the sensors' own."""


@dataclass(frozen=True)
class EdgeOffsets:
    """Image gradient on the depth's steps, its mean over the image being 1, with the depth moved by ``offsets``
    ``(n, 2)`` pixels right and down: ``gradient`` ``(n,)``, over ``pixels``."""

    offsets: NDArray[np.int64]
    gradient: NDArray[np.float64]
    pixels: int

    @property
    def own(self) -> float:
        """As the depth is given."""
        return float(self.gradient[(self.offsets == 0).all(axis=1)][0])

    def above(self, gradient: float) -> float:
        """How far a gradient stands above the mean of all offsets, standard deviations."""
        return float((gradient - self.gradient.mean()) / max(self.gradient.std(), 1e-9))


def measure_edges(frames: Sequence[Frame]) -> EdgeOffsets | None:
    """The image's gradient on the steps of the depth of several frames; None where these are too few."""
    reach_x, reach_y = _REACH_PX
    grid = np.mgrid[-reach_y : reach_y + 1 : _GRID_PX, -reach_x : reach_x + 1 : _GRID_PX]
    offsets = np.stack([grid[1].ravel(), grid[0].ravel()], axis=1).astype(np.int64)
    total, pixels = np.zeros(len(offsets)), 0
    for frame in frames:
        if frame.depth_m is None:
            continue
        v, u = np.nonzero(_steps(frame.depth_m))
        height, width = frame.depth_m.shape
        inside = (u >= reach_x) & (u < width - reach_x) & (v >= reach_y) & (v < height - reach_y)
        rows = np.flatnonzero(inside)
        if len(rows) > _PER_FRAME:
            rows = rows[np.linspace(0, len(rows) - 1, _PER_FRAME).astype(np.int64)]
        if len(rows):
            gradient, u, v = _gradient(frame.image), u[rows], v[rows]
            total += [float(gradient[v + dy, u + dx].sum()) for dx, dy in offsets]
            pixels += len(rows)
    return EdgeOffsets(offsets, total / pixels, pixels) if pixels >= _ENOUGH else None


def edge_problems(frames: Sequence[Frame], source: str) -> list[Problem]:
    """A warning where the depth's steps lie beside the image's edges, or nowhere near them; ``source`` names the
    depth images."""
    from maslam.frontend.datasets import Problem, Severity

    found = measure_edges(frames)
    if found is None:
        return []
    best = int(found.gradient.argmax())
    dx, dy = found.offsets[best].tolist()
    peak = float(found.gradient[best])
    if found.above(peak) >= _CLEAR and peak >= _BETTER * found.own and np.hypot(dx, dy) >= _NEAR_PX:
        sides = [
            f"{abs(n)} px too far {side}"
            for n, side in ((dx, _side(-dx, "right", "left")), (dy, _side(-dy, "down", "up")))
            if n
        ]
        message = f"edges of the depth lie {' and '.join(sides)} in the image: depth is not registered to it"
        return [Problem(Severity.WARNING, f"{source}: {message}")]
    if found.above(found.own) < _FLAT:
        message = (
            f"edges of the depth are no edges of the image ({found.own:.2f} times its mean gradient): is the depth "
            "registered to the image, and of the same moment?"
        )
        return [Problem(Severity.WARNING, f"{source}: {message}")]
    return []


def _side(amount: int, positive: str, negative: str) -> str:
    return positive if amount > 0 else negative


def _steps(depth_m: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Pixels in the middle of a step of the depth between two that are known."""
    steps = np.zeros(depth_m.shape, dtype=bool)
    half = _SPAN_PX // 2
    for axis in (0, 1):
        depth, out = (depth_m, steps) if axis == 0 else (depth_m.T, steps.T)
        a, b = depth[:-_SPAN_PX], depth[_SPAN_PX:]
        out[half:-half] |= (a > 0) & (b > 0) & (np.abs(a - b) > _STEP * np.minimum(a, b))
    return steps


def _gradient(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Length of the image's gradient, its mean 1, without the strongest twentieth: these would decide alone."""
    import cv2

    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32)
    length = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    length = np.minimum(length, np.quantile(length, 0.95))
    return (length / max(float(length.mean()), 1e-6)).astype(np.float32)
