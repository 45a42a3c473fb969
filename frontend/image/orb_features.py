"""Key-points spread over the image and a scale pyramid, with orientation and ORB descriptors.

Pixel centres are kept between levels: a point at ``x`` on a level of scale ``s`` lies at ``s * (x + 0.5) - 0.5`` on
level 0 (OpenCV's own ORB leaves the half-pixel term out).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, cast

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from ..config import FeatureConfig
from .guided_matching import OrbFeatures
from .used_pixels import corner_mask

EDGE_PX = 20
"""ORB's rotated sampling pattern reaches 18.4 pixels from its centre."""
_HALF_PATCH = 15
_REACH = (15, 15, 15, 15, 14, 14, 14, 13, 13, 12, 11, 10, 9, 8, 6, 3)
"""Half width of each row of the round patch that gives the orientation: the same circle as OpenCV's and ORB-SLAM's."""
_ROUND = np.array(
    [[1.0 if abs(dx) <= _REACH[abs(dy)] else 0.0 for dx in range(-15, 17)] for dy in range(-15, 16)], dtype=np.float32
)
"""That patch in rows of 32: whole vectors of the processor."""
_ROUND_X = _ROUND * np.arange(-15, 17, dtype=np.float32)
_TILE_PX = 120


@dataclass(frozen=True)
class Keypoints:
    """``uv`` ``(n, 2)`` float64 level-0 pixels; ``level`` ``(n,)`` int8; ``angle_deg`` ``(n,)``, NaN where no
    descriptor is possible; ``descriptors`` ``(n, 32)`` uint8, zero there."""

    uv: NDArray[np.float64]
    level: NDArray[np.int8]
    angle_deg: NDArray[np.float32]
    descriptors: NDArray[np.uint8]

    def __len__(self) -> int:
        return len(self.uv)

    def features(self, rows: NDArray[np.int64] | slice = slice(None)) -> OrbFeatures:
        """What ``rows`` are matched by."""
        return OrbFeatures(self.uv[rows], self.level[rows], self.descriptors[rows])


class Pyramid:
    """An image and its scaled copies, made once and shared by detection and description; ``used`` ``(H, W)``: where
    corners may lie, None: everywhere."""

    def __init__(
        self, image: NDArray[np.uint8], levels: int, scale_factor: float, used: NDArray[np.bool_] | None = None
    ) -> None:
        height, width = image.shape
        self.levels: list[NDArray[np.uint8]] = [np.ascontiguousarray(image)]
        for k in range(1, levels):
            size = (round(width / scale_factor**k), round(height / scale_factor**k))
            if min(size) < 4 * EDGE_PX:
                break
            self.levels.append(
                cv2.resize(self.levels[-1], size, interpolation=cv2.INTER_LINEAR).astype(np.uint8, copy=False)
            )
        self.scales = np.array([[width / im.shape[1], height / im.shape[0]] for im in self.levels])
        self.used = None if used is None else self._scaled(corner_mask(used))

    def _scaled(self, mask: NDArray[np.float32]) -> list[NDArray[np.uint8]]:
        """The mask of each level, as OpenCV's detectors take it: pixels of which no part is masked."""
        sized = (cv2.resize(mask, im.shape[::-1], interpolation=cv2.INTER_AREA) for im in self.levels)
        return [(one > 1.0 - 1e-4).astype(np.uint8) for one in sized]

    def to_base(self, xy: NDArray[np.float64], level: int | NDArray[np.int8]) -> NDArray[np.float64]:
        """Pixels ``(n, 2)`` of the full image from those of ``level``."""
        return (xy + 0.5) * self.scales[level] - 0.5

    def from_base(self, uv: NDArray[np.float64], level: int | NDArray[np.int8]) -> NDArray[np.float64]:
        """Pixels ``(n, 2)`` of ``level`` from those of the full image."""
        return (uv + 0.5) / self.scales[level] - 0.5


class Detector:
    """FAST corners spread over the image: tiles with thresholds of their own, which learn from one image to the next,
    then cells."""

    def __init__(self, config: FeatureConfig) -> None:
        self.config = config
        self._thresholds: dict[tuple[int, int, int], int] = {}

    def detect(
        self, pyramid: Pyramid, count: int, taken_uv: NDArray[np.float64], levels: int | None = None
    ) -> tuple[NDArray[np.float64], NDArray[np.int8], NDArray[np.float64]]:
        """About ``count`` corners over the cells of ``levels`` levels (None: all), away from ``taken_uv`` ``(m, 2)``.

        Returns ``uv`` ``(n, 2)`` level-0 pixels, ``level`` ``(n,)`` int8 and ``strength`` ``(n,)``, strongest first.
        """
        images = pyramid.levels[:levels]
        area = sum(im.size for im in images)
        all_uv, all_level, all_strength = [np.zeros((0, 2))], [np.zeros(0, dtype=np.int8)], [np.zeros(0)]
        for level, image in enumerate(images):
            quota = max(round(count * image.size / area), 8)
            used = None if pyramid.used is None else pyramid.used[level]
            xy, strength = self._detect_level(image, used, level, quota, pyramid.from_base(taken_uv, level))
            all_uv.append(pyramid.to_base(xy, level))
            all_level.append(np.full(len(xy), level, dtype=np.int8))
            all_strength.append(strength)
        uv, level_of, strength = np.concatenate(all_uv), np.concatenate(all_level), np.concatenate(all_strength)
        order = np.argsort(-strength, kind="stable")
        return uv[order], level_of[order], strength[order]

    def _detect_level(
        self,
        image: NDArray[np.uint8],
        used: NDArray[np.uint8] | None,
        level: int,
        quota: int,
        taken: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        height, width = image.shape
        columns, rows = max(width // _TILE_PX, 1), max(height // _TILE_PX, 1)
        x_edges = np.linspace(EDGE_PX, width - EDGE_PX, columns + 1).astype(int)
        y_edges = np.linspace(EDGE_PX, height - EDGE_PX, rows + 1).astype(int)
        want = max(3 * quota // (columns * rows), 4)
        found_xy, found_strength = [np.zeros((0, 2))], [np.zeros(0)]
        for r in range(rows):
            for c in range(columns):
                # FAST leaves a border of 3 pixels.
                at = slice(y_edges[r] - 3, y_edges[r + 1] + 3), slice(x_edges[c] - 3, x_edges[c + 1] + 3)
                corners = self._detect_tile(image[at], None if used is None else used[at], (level, r, c), want)
                if corners:
                    found_xy.append(cv2.KeyPoint.convert(corners) + np.array([x_edges[c] - 3.0, y_edges[r] - 3.0]))
                    found_strength.append(np.array([k.response for k in corners]))
        xy, strength = np.concatenate(found_xy), np.concatenate(found_strength)
        cell = max(float(np.sqrt(2.0 * (width - 2 * EDGE_PX) * (height - 2 * EDGE_PX) / quota)), 12.0)
        keep = _spread(xy, np.argsort(-strength, kind="stable"), taken, width, height, cell, 2, 4.0)
        return xy[keep], strength[keep]

    def _detect_tile(
        self, tile: NDArray[np.uint8], used: NDArray[np.uint8] | None, key: tuple[int, int, int], want: int
    ) -> Sequence[cv2.KeyPoint]:
        """Corners of a tile by its own threshold, which is halved at once where it finds far too few."""
        low = self.config.fast_threshold
        threshold = self._thresholds.get(key, 3 * low)
        tile = np.ascontiguousarray(tile)
        corners = cv2.FastFeatureDetector.create(threshold).detect(tile, used)
        while len(corners) < want // 2 and threshold > low:
            threshold = max(threshold // 2, low)
            corners = cv2.FastFeatureDetector.create(threshold).detect(tile, used)
        if len(corners) > 2 * want:
            threshold += max(threshold // 5, 1)
        elif len(corners) < want:
            threshold = max(threshold - max(threshold // 5, 1), low)
        self._thresholds[key] = threshold
        return corners


@kernel
def _spread(
    xy: NDArray[np.float64],
    order: NDArray[np.int64],
    taken: NDArray[np.float64],
    width: int,
    height: int,
    cell: float,
    per_cell: int,
    distance: float,
) -> NDArray[np.int64]:
    """Indices of the first points in ``order``, at most ``per_cell`` a cell (taken ones count), at least ``distance``
    apart."""
    columns, rows = int(np.ceil(width / cell)), int(np.ceil(height / cell))
    used = np.zeros((rows, columns), dtype=np.int64)
    blocked = np.zeros((height, width), dtype=np.bool_)
    reach = int(distance)
    for i in range(len(taken)):
        x, y = round(taken[i, 0]), round(taken[i, 1])
        if 0 <= x < width and 0 <= y < height:
            used[int(y / cell), int(x / cell)] += 1
            for yy in range(max(y - reach, 0), min(y + reach + 1, height)):
                for xx in range(max(x - reach, 0), min(x + reach + 1, width)):
                    blocked[yy, xx] = True
    kept = np.zeros(len(xy), dtype=np.int64)
    n = 0
    for i in order:
        x, y = int(xy[i, 0]), int(xy[i, 1])
        row, column = int(y / cell), int(x / cell)
        if blocked[y, x] or used[row, column] >= per_cell:
            continue
        used[row, column] += 1
        kept[n] = i
        n += 1
        for yy in range(max(y - reach, 0), min(y + reach + 1, height)):
            for xx in range(max(x - reach, 0), min(x + reach + 1, width)):
                blocked[yy, xx] = True
    return kept[:n]


def spread_cells(
    uv: NDArray[np.float64], taken: NDArray[np.float64], width: int, height: int, count: int
) -> NDArray[np.int64]:
    """Indices of ``uv`` ``(n, 2)``, given in order of merit, that fill the cells ``taken`` leaves empty; ``count``
    cells in all."""
    cell = float(np.sqrt(width * height / count))
    return _spread(uv, np.arange(len(uv)), taken, width, height, cell, 1, 6.0)


@kernel(fastmath={"reassoc"})
def _orientation(image: NDArray[np.uint8], xy: NDArray[np.float64]) -> NDArray[np.float32]:
    """Intensity-centroid angles in degrees, 0 to 360 (Rublee et al., ORB, ICCV 2011). All sums are whole numbers that
    float32 holds exactly, so their order does not matter."""
    out = np.empty(len(xy), dtype=np.float32)
    height, width = image.shape
    flat = image.reshape(height * width)
    for i in range(len(xy)):
        cx, cy = round(xy[i, 0]), round(xy[i, 1])
        m10, m01 = np.float32(0.0), np.float32(0.0)
        for r in range(2 * _HALF_PATCH + 1):
            at = np.uint64((cy + r - _HALF_PATCH) * width + cx - _HALF_PATCH)
            row = np.float32(0.0)
            for c in range(2 * _HALF_PATCH + 2):
                value = np.float32(flat[at + np.uint64(c)])
                m10 += value * _ROUND_X[r, c]
                row += value * _ROUND[r, c]
            m01 += np.float32(r - _HALF_PATCH) * row
        angle = np.degrees(np.arctan2(float(m01), float(m10)))
        out[i] = angle if angle >= 0 else angle + 360.0
    return out


def describe(pyramid: Pyramid, uv: NDArray[np.float64], level: NDArray[np.int8]) -> Keypoints:
    """ORB orientation and descriptor of each point on its level; points too near the border get none."""
    n = len(uv)
    angle = np.full(n, np.nan, dtype=np.float32)
    descriptors = np.zeros((n, 32), dtype=np.uint8)
    for k, image in enumerate(pyramid.levels):
        height, width = image.shape
        index = np.flatnonzero(level == k)
        xy = pyramid.from_base(uv[index], k)
        pixel = np.rint(xy)
        inside = (pixel >= EDGE_PX).all(axis=1) & (pixel < [width - EDGE_PX, height - EDGE_PX]).all(axis=1)
        index, xy = index[inside], xy[inside]
        if not len(index):
            continue
        angle[index] = _orientation(image, xy)
        points = cv2.KeyPoint.convert(cast("Sequence[Any]", xy.astype(np.float32)), 31.0)
        for point, degrees in zip(points, angle[index].tolist(), strict=True):
            point.angle = degrees
        # One pixel less than our own border: compute() drops no point.
        orb = cv2.ORB.create(nfeatures=len(points), nlevels=1, edgeThreshold=EDGE_PX - 1)
        descriptors[index] = orb.compute(image, points)[1]
    return Keypoints(uv, level, angle, descriptors)


def undescribed(uv: NDArray[np.float64], level: NDArray[np.int8]) -> Keypoints:
    """Key-points without descriptors."""
    return Keypoints(uv, level, np.full(len(uv), np.nan, dtype=np.float32), np.zeros((len(uv), 32), dtype=np.uint8))
