"""The map of one track: key-frames, points, and which key-frame observes which point."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse, transform_points

from ..estimation.depth_alignment import Surface
from ..image.guided_matching import OrbFeatures

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class FrameObservations(NamedTuple):
    """Map points ``point`` ``(n,)`` that a frame sees, and the pixels ``uv`` ``(n, 2)`` where."""

    point: Ints
    uv: Array


@dataclass
class MapKeyFrame:
    """A frame that stays. Rows of the arrays are its observations; ``point`` is -1 where an observation was dropped.

    ``T_C_W`` ``(4, 4)``; ``uv`` ``(n, 2)`` pixels; ``disparity`` and ``row`` (the row
    in the right image less that in the left) ``(n,)`` raw, NaN where unknown; ``sigma`` ``(n,)``
    pixels of ``uv``; ``level`` ``(n,)``; ``descriptors`` ``(n, 32)`` with ``described`` ``(n,)``; ``followed``
    ``(n,)``: by flow, not only matched.
    """

    number: int
    frame_index: int
    stamp_ns: int
    T_C_W: Array
    uv: Array
    disparity: Array
    row: Array
    point: Ints
    sigma: Array
    level: NDArray[np.int8]
    descriptors: NDArray[np.uint8]
    described: NDArray[np.bool_]
    followed: NDArray[np.bool_]
    stays: bool = True
    """False: supports the window only and goes when it leaves it; it has no descriptors."""
    surface: Surface | None = None
    """RGB-D: what the depth image showed."""

    def features(self, rows: Ints) -> OrbFeatures:
        """What observations ``rows`` are matched by."""
        return OrbFeatures(self.uv[rows], self.level[rows], self.descriptors[rows])

    @property
    def T_W_C(self) -> Array:
        """Pose ``(4, 4)``, camera to the track's frame."""
        return se3_inverse(self.T_C_W)


@dataclass(frozen=True, slots=True)
class CulledKeyFrame:
    """Remainder of a culled key-frame: its pose ``T_C_P`` ``(4, 4)`` relative to the key-frame ``parent``."""

    parent: int
    T_C_P: Array


def union(parts: list[Ints]) -> Ints:
    """Each point number of ``parts`` once, ascending, without -1. Numbers seen together lie close: marks are much
    quicker than sorting."""
    ids = np.concatenate([np.zeros(0, dtype=np.int64), *parts])
    ids = ids[ids >= 0]
    if not len(ids):
        return ids
    first = int(ids.min())
    marked = np.zeros(int(ids.max()) - first + 1, dtype=bool)
    marked[ids - first] = True
    return np.flatnonzero(marked) + first


def without(ids: Ints, gone: Ints) -> Ints:
    """``ids`` (ascending) less those in ``gone``."""
    if not len(ids):
        return ids
    first, last = int(ids[0]), int(ids[-1])
    keep = np.ones(last - first + 1, dtype=bool)
    keep[gone[(gone >= first) & (gone <= last)] - first] = False
    return ids[keep[ids - first]]


_COLUMNS = ("_xyz", "_alive", "_metric", "_views", "_descriptors", "_described", "_level", "_depth")


class Map:
    """Points are numbered for good; arrays grow by doubling. A point whose position is not yet known has NaN in
    ``xyz``."""

    def __init__(self) -> None:
        self.keyframes: dict[int, MapKeyFrame] = {}  # in order of their numbers
        self.culled: dict[int, CulledKeyFrame] = {}
        self.observers: list[list[tuple[int, int]]] = []
        self._xyz = np.full((1024, 3), np.nan)
        self._alive = np.zeros(1024, dtype=bool)
        self._metric = np.zeros(1024, dtype=bool)
        self._views = np.zeros(1024, dtype=np.int64)
        self._descriptors = np.zeros((1024, 32), dtype=np.uint8)
        self._described = np.zeros(1024, dtype=bool)
        self._level = np.zeros(1024, dtype=np.int8)
        self._depth = np.full(1024, np.nan)

    def __len__(self) -> int:
        return len(self.observers)

    @property
    def xyz(self) -> Array:
        """Positions ``(P, 3)`` in the track's frame; NaN where unknown."""
        return self._xyz[: len(self)]

    @property
    def alive(self) -> NDArray[np.bool_]:
        """Whether each point ``(P,)`` is still in the map."""
        return self._alive[: len(self)]

    @property
    def metric(self) -> NDArray[np.bool_]:
        """A disparity or depth gave this point its position at least once."""
        return self._metric[: len(self)]

    @property
    def views(self) -> Ints:
        """Number of key-frames that observe each point, ``(P,)``."""
        return self._views[: len(self)]

    @property
    def descriptors(self) -> NDArray[np.uint8]:
        """The latest descriptor of each point."""
        return self._descriptors[: len(self)]

    @property
    def described(self) -> NDArray[np.bool_]:
        """Whether each point ``(P,)`` has a descriptor."""
        return self._described[: len(self)]

    @property
    def level(self) -> NDArray[np.int8]:
        """Pyramid level of the latest descriptor of each point, ``(P,)``."""
        return self._level[: len(self)]

    @property
    def depth(self) -> Array:
        """Depth of each point ``(P,)`` at its latest descriptor, in the track's unit; NaN where its position is
        unknown."""
        return self._depth[: len(self)]

    def add_points(self, count: int) -> Ints:
        """Numbers ``(count,)`` of new points of unknown position."""
        first, last = len(self), len(self) + count
        while last > len(self._alive):
            for name in _COLUMNS:
                old = getattr(self, name)
                fill = np.nan if name in ("_xyz", "_depth") else 0
                setattr(self, name, np.concatenate([old, np.full_like(old, fill)]))
        self._alive[first:last] = True
        self.observers.extend([] for _ in range(count))
        return np.arange(first, last)

    def latest(self, count: int) -> list[int]:
        """Numbers of the latest key-frames, at most ``count``, oldest first."""
        return list(islice(reversed(self.keyframes), count))[::-1]

    def insert(self, keyframe: MapKeyFrame) -> None:
        """Add a key-frame and enter its observations with their points."""
        self.keyframes[keyframe.number] = keyframe
        for row in np.flatnonzero(keyframe.point >= 0).tolist():
            self.observers[keyframe.point[row]].append((keyframe.number, row))
        seen = keyframe.point[keyframe.point >= 0]
        self.views[seen] += 1
        rows = np.flatnonzero((keyframe.point >= 0) & keyframe.described)
        ids = keyframe.point[rows]
        self.descriptors[ids], self.described[ids], self.level[ids] = (
            keyframe.descriptors[rows],
            True,
            keyframe.level[rows],
        )
        self.depth[ids] = transform_points(keyframe.T_C_W, self.xyz[ids])[:, 2]

    def drop_observation(self, number: int, row: int) -> None:
        """Remove observation ``row`` of key-frame ``number``."""
        keyframe = self.keyframes[number]
        point = int(keyframe.point[row])
        keyframe.point[row] = -1
        self.observers[point].remove((number, row))
        self.views[point] -= 1

    def drop_point(self, point: int) -> None:
        """Remove a point and all its observations."""
        for number, row in self.observers[point]:
            self.keyframes[number].point[row] = -1
        self.observers[point] = []
        self.views[point] = 0
        self.alive[point] = False

    def seen_together(self, a: int, b: int) -> bool:
        """Whether one key-frame sees both points: then they are two."""
        return not {number for number, _ in self.observers[a]}.isdisjoint(number for number, _ in self.observers[b])

    def merge_points(self, kept: int, gone: int) -> None:
        """``gone`` is the same place as ``kept``: hand its observations over (key-frames that already see ``kept``
        keep that one)."""
        seen = {number for number, _ in self.observers[kept]}
        for number, row in self.observers[gone]:
            if number in seen:
                self.keyframes[number].point[row] = -1
            else:
                self.keyframes[number].point[row] = kept
                self.observers[kept].append((number, row))
        self.observers[kept].sort()
        self.observers[gone] = []
        self.views[kept], self.views[gone] = len(self.observers[kept]), 0
        self.alive[gone] = False

    def cull_keyframe(self, number: int, parent: int) -> None:
        """Remove a key-frame; its pose is kept relative to ``parent``, its observations are forgotten."""
        keyframe = self.keyframes.pop(number)
        for row in np.flatnonzero(keyframe.point >= 0).tolist():
            self.observers[keyframe.point[row]].remove((number, row))
        self.views[keyframe.point[keyframe.point >= 0]] -= 1
        self.culled[number] = CulledKeyFrame(parent, product(keyframe.T_C_W, self.keyframes[parent].T_W_C))

    def pose(self, number: int) -> Array:
        """``T_C_W`` of a key-frame, also of a culled one."""
        if number in self.keyframes:
            return self.keyframes[number].T_C_W
        gone = self.culled[number]
        return product(gone.T_C_P, self.pose(gone.parent))

    def covisible(self, point_ids: Ints, exclude: set[int]) -> list[int]:
        """Key-frames that see the most of these points, most first (ties: newest first), with at least 15 of them."""
        counts: dict[int, int] = {}
        for point in point_ids.tolist():
            for number, _ in self.observers[point]:
                if number not in exclude:
                    counts[number] = counts.get(number, 0) + 1
        good = [number for number, count in counts.items() if count >= 15]
        return sorted(good, key=lambda number: (-counts[number], -number))
