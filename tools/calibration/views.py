"""Views of a board: found in the frames of a film, and the sharp and varied ones among them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ..common.errors import ToolError
from ..common.progress import Progress
from .board import Array, Board

_NEIGHBOURS = 5
"""Consecutive views of which the sharpest is kept."""
_SHARP = 0.4
"""Share of the sharpness that the better half of all views has, below which a view is blurred."""


@dataclass(frozen=True)
class BoardView:
    """One image of the board: ``points`` ``(n, 3)`` on it, ``uv`` ``(n, 2)`` pixels; ``sharpness`` of the image."""

    name: str
    points: Array
    uv: Array
    sharpness: float


@dataclass(frozen=True)
class FoundViews:
    """All views of the board, in order, in images of ``size`` ``(width, height)``; ``frames`` were looked at."""

    views: tuple[BoardView, ...]
    size: tuple[int, int]
    frames: int


def find_views(
    frames: Iterable[tuple[str, NDArray[np.uint8]]], expected: int, board: Board, progress: Progress
) -> FoundViews:
    """Look for the board in every frame; ``expected``: about how many there are. ``ToolError`` where sizes change."""
    task = progress.start("looking for the board", max(expected, 1))
    views: list[BoardView] = []
    size, count = (0, 0), 0
    for count, (name, image) in enumerate(frames, 1):
        here = (image.shape[1], image.shape[0])
        if size not in ((0, 0), here):
            raise ToolError(f"{name}: {here[0]}x{here[1]} pixels, but the images before have {size[0]}x{size[1]}")
        size = here
        found = board.find(image)
        if found is not None:
            views.append(BoardView(name, *found, _sharpness(image, found[1])))
        progress.advance(task, min(count, max(expected, 1)))
    progress.advance(task, max(expected, 1))
    return FoundViews(tuple(views), size, count)


def choose_views(found: FoundViews, most: int) -> tuple[BoardView, ...]:
    """At most ``most`` sharp views, each as unlike those before as can be: by place, size and slant of the board."""
    groups = [found.views[i : i + _NEIGHBOURS] for i in range(0, len(found.views), _NEIGHBOURS)]
    dense = len(found.views) >= most * _NEIGHBOURS
    kept = [max(group, key=lambda view: view.sharpness) for group in groups] if dense else list(found.views)
    if not kept:
        return ()
    level = float(np.quantile([view.sharpness for view in kept], 0.75))
    sharp = [view for view in kept if view.sharpness >= _SHARP * level]
    looks = np.stack([_look(view, found.size) for view in sharp])
    chosen = [int(np.argmax([view.sharpness for view in sharp]))]
    while len(chosen) < min(most, len(sharp)):
        apart = np.linalg.norm(looks[:, None] - looks[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(apart)))
    return tuple(sharp[i] for i in sorted(chosen))


def coverage(views: Sequence[BoardView], size: tuple[int, int], cells: tuple[int, int] = (8, 6)) -> NDArray[np.int64]:
    """Points in each cell of the image, ``(rows, columns)`` of ``cells`` (columns, rows)."""
    uv = np.concatenate([view.uv for view in views]) if views else np.zeros((0, 2))
    counts, _, _ = np.histogram2d(uv[:, 1], uv[:, 0], bins=cells[::-1], range=((0, size[1]), (0, size[0])))
    return counts.astype(np.int64)


def _look(view: BoardView, size: tuple[int, int]) -> Array:
    """Place, size and slant of the board in the image, as numbers of about one: of the affine map from board to image,
    and what perspective adds."""
    diagonal = float(np.hypot(*size))
    centred = np.column_stack([view.points[:, :2] - view.points[:, :2].mean(axis=0), np.ones(len(view.points))])
    affine = np.linalg.lstsq(centred, view.uv, rcond=None)[0]
    span = np.ptp(view.points[:, :2], axis=0)
    sides = affine[:2] * span[:, None] / diagonal
    lengths = np.linalg.norm(sides, axis=1)
    skew = float((sides[0] * sides[1]).sum() / max(float(lengths.prod()), 1e-9))
    ratio = float(np.log(max(lengths[0], 1e-6) / max(lengths[1], 1e-6)))
    homography, _ = cv2.findHomography(view.points[:, :2], view.uv)
    slant = homography[2, :2] / homography[2, 2] * span if homography is not None else np.zeros(2)
    return np.array([*(2.0 * affine[2] / diagonal), lengths.sum(), skew, ratio, *(2.0 * slant)])


def _sharpness(image: NDArray[np.uint8], uv: Array) -> float:
    """Steepest edges on the board in units of its contrast."""
    low, high = np.floor(uv.min(axis=0)).astype(int), np.ceil(uv.max(axis=0)).astype(int) + 1
    seen = image[max(low[1], 0) : high[1], max(low[0], 0) : high[0]]
    if min(seen.shape) < 8:
        return 0.0
    steep = cv2.magnitude(cv2.Sobel(seen, cv2.CV_32F, 1, 0), cv2.Sobel(seen, cv2.CV_32F, 0, 1))
    dark, bright = np.quantile(seen, [0.05, 0.95])
    return float(np.quantile(steep, 0.98) / max(bright - dark, 1.0))
