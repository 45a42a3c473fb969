"""Further views of a map's points: key-frames that show a point which odometry did not look for there.

Odometry follows few points over many frames, and of all others it keeps what it needs: with depth, most are seen by the
key-frame that ranged them alone. Programs for structure from motion want every view. A point is looked for when its
key-frame has had its neighbours: poses are refined by then, and a patch has a few pixels to be searched in. Nothing
that odometry works with is changed.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, transform_points

from ..config import FlowConfig
from ..image.patch_alignment import HALF, Patches, align, cut_patches, half_sized
from ..image.used_pixels import are_used
from .map import Array, FrameObservations, Ints, Map, MapKeyFrame
from .range_sensor import Ranging

_TRIES = 2
"""Key-frames that a point's looks are taken from, the nearest first."""
_REACH_SHARE = 0.006
"""Search radius around the projection, share of the image's width: what poses and points are uncertain by."""


@dataclass(frozen=True, eq=False)
class _Held:
    """A key-frame, its image with halvings, what its observations look like, row by row, and where points may be."""

    keyframe: MapKeyFrame
    image: list[NDArray[np.uint8]]
    patches: Patches
    used: NDArray[np.bool_] | None


class MoreViews:
    """Finds them while the map grows: ``found`` holds for a key-frame's number the points seen and where.

    ``neighbours``: key-frames before and after one that sees a point in which the point is looked for. The images of
    the latest ``2 * neighbours + 1`` key-frames that stay are held.
    """

    def __init__(self, map_: Map, ranging: Ranging, flow: FlowConfig, neighbours: int) -> None:
        self.map, self.ranging, self.flow, self.neighbours = map_, ranging, flow, neighbours
        self.found: dict[int, FrameObservations] = {}
        self._held: list[_Held] = []

    def add(self, keyframe: MapKeyFrame, image: NDArray[np.uint8], used: NDArray[np.bool_] | None = None) -> None:
        """A key-frame that stays, the latest of the map, with its image and which pixels may give points (None: all);
        the one that has all its neighbours now is searched."""
        if not self.neighbours:
            return
        levels = half_sized(image, self.flow.align_levels)
        self._held.append(_Held(keyframe, levels, cut_patches(levels, keyframe.uv), used))
        del self._held[: -2 * self.neighbours - 1]
        if len(self._held) > self.neighbours:
            self._search(len(self._held) - 1 - self.neighbours)

    def finish(self) -> None:
        """No more key-frames: search the latest, and forget the images."""
        for place in range(max(len(self._held) - self.neighbours, 0), len(self._held)):
            self._search(place)
        self._held = []

    def _search(self, place: int) -> None:
        """Look in the key-frame at ``place`` for what its neighbours see."""
        at = self._held[place]
        near = [p for d in range(1, self.neighbours + 1) for p in (place - d, place + d) if 0 <= p < len(self._held)]
        tries = np.zeros(len(self.map), dtype=np.int8)
        tries[at.keyframe.point[at.keyframe.point >= 0]] = _TRIES
        reach_px = _REACH_SHARE * at.image[0].shape[1]
        points, uv = [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
        for home in (self._held[p] for p in near):
            rows = self._placed(home.keyframe)
            rows, guess, warp = self._expected(home, at, rows[tries[home.keyframe.point[rows]] < _TRIES])
            ids = home.keyframe.point[rows]
            tries[ids] += 1
            xy, good = align(home.patches.take(rows), at.image, warp, guess, self.flow.min_correlation, reach_px)
            good &= are_used(at.used, xy)
            tries[ids[good]] = _TRIES
            points.append(ids[good])
            uv.append(xy[good])
        self.found[at.keyframe.number] = FrameObservations(np.concatenate(points), np.concatenate(uv))

    def _placed(self, keyframe: MapKeyFrame) -> Ints:
        """Rows of the key-frame's points of known position."""
        rows = np.flatnonzero(keyframe.point >= 0)
        return rows[np.isfinite(self.map.xyz[keyframe.point[rows], 0])]

    def _expected(self, home: _Held, at: _Held, rows: Ints) -> tuple[Ints, Array, Array]:
        """The ``rows`` of ``home`` that should show in ``at``, their pixels there ``(n, 2)``, and how a step around
        them in ``home`` shows there ``(n, 2, 2)``."""
        p = transform_points(home.keyframe.T_C_W, self.map.xyz[home.keyframe.point[rows]])
        T_A_H = product(at.keyframe.T_C_W, home.keyframe.T_W_C)
        guess, warp = self.ranging.show(T_A_H, p)
        # What the model is off at home it is off nearby.
        guess += home.keyframe.uv[rows] - self.ranging.project(np.eye(4), p)[0]
        height, width = at.image[0].shape
        inside = ((guess >= HALF + 1) & (guess < [width - HALF - 2, height - HALF - 2])).all(axis=1)
        return rows[inside], guess[inside], warp[inside]
