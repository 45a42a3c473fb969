"""Which key-frames of a map see which of its points, and where in their images.

A map copy holds each point once, in the key-frame that saw it first. Results for other programs want every view of a
point: those stand in the owner's sequence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from maslam.backend.geometry import Array

from ..manifest import CameraEntry
from ..map_exchange.map_copy import MapCopy
from ..sequence import AgentSequence
from ..state.keyframe import KeyFrame

# A copied point is one of the owner's key-frame where it lies this near to it, as a share of its depth: copies are
# rounded by less.
_SAME_POINT = 0.05


@dataclass(frozen=True, eq=False)
class OwnerViews:
    """All that an agent's key-frames see: key-frame k the points ``ids[starts[k]:starts[k + 1]]``, numbered as in
    :class:`~maslam.mas.state.keyframe.KeyFrame`, at ``uv`` ``(N, 2)`` pixels."""

    starts: NDArray[np.intp]
    ids: NDArray[np.int64]
    uv: Array

    def of(self, k: int) -> slice:
        """The rows of key-frame k."""
        return slice(int(self.starts[k]), int(self.starts[k + 1]))


_NOTHING = OwnerViews(np.zeros(1, dtype=np.intp), np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


@dataclass(frozen=True, eq=False)
class MapOwner:
    """What results tell of an agent whose map is written: its ``camera``, all its ``keyframes`` with what they see, and
    the names of their ``images``; empty where that is not known."""

    camera: CameraEntry
    keyframes: Sequence[KeyFrame] = ()
    views: OwnerViews = _NOTHING
    images: Sequence[str] = ()
    _trees: dict[int, cKDTree] = field(default_factory=dict)

    def nearest(self, k: int, points_C: Array) -> tuple[Array, NDArray[np.int64]]:
        """Distance ``(n,)`` from each of ``points_C`` to the nearest point of key-frame k, and the ids of those. Every
        holder of a copy asks."""
        if k not in self._trees:
            self._trees[k] = cKDTree(self.keyframes[k].points_C.astype(np.float64))
        apart, row = self._trees[k].query(points_C)
        return apart, self.keyframes[k].point_ids[row]


def map_owner(sequence: AgentSequence, keyframes: Sequence[KeyFrame], camera: CameraEntry) -> MapOwner:
    """All of that, with the views that the front end has measured; where it has left none, each point of a key-frame
    is seen where it projects."""
    return MapOwner(camera, keyframes, _measured(sequence) or _projected(keyframes, camera), sequence.places.images)


def project(points_C: Array, camera: CameraEntry) -> Array:
    """Pixels ``(n, 2)`` of points ``(n, 3)`` in front of the camera."""
    return points_C[:, :2] / points_C[:, 2:] * [camera.fx, camera.fy] + np.array([camera.cx, camera.cy])


_NOTHING = OwnerViews(np.zeros(1, dtype=np.intp), np.zeros(0, dtype=np.int64), np.zeros((0, 2)))


def _measured(sequence: AgentSequence) -> OwnerViews | None:
    if None in sequence.views or len(sequence.views) != len(sequence.tracks):
        return None
    starts, ids, uv = [np.zeros(1, dtype=np.intp)], [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
    points = 0
    for track, views in zip(sequence.tracks, sequence.views, strict=True):
        assert views is not None
        ends = np.searchsorted(views.observations[:, 0], np.arange(len(track)), side="right")
        starts.append(starts[-1][-1] + ends)
        ids.append(points + views.observations[:, 1].astype(np.int64))
        uv.append(views.uv.astype(np.float64))
        points += len(track.points)
    return OwnerViews(np.concatenate(starts), np.concatenate(ids), np.concatenate(uv))


def _projected(keyframes: Sequence[KeyFrame], camera: CameraEntry) -> OwnerViews:
    ahead = [k.points_C[:, 2] > 0 for k in keyframes]
    ids = [np.zeros(0, dtype=np.int64), *(k.point_ids[use] for k, use in zip(keyframes, ahead, strict=True))]
    points_C = [np.zeros((0, 3), dtype=np.float32), *(k.points_C[use] for k, use in zip(keyframes, ahead, strict=True))]
    starts = np.cumsum([0, *(int(use.sum()) for use in ahead)])
    return OwnerViews(starts, np.concatenate(ids), project(np.concatenate(points_C).astype(np.float64), camera))


@dataclass(frozen=True, eq=False)
class Sightings:
    """Views of a map's points, ordered by row: key-frame ``rows`` ``(n,)`` sees ``points`` ``(n,)`` (numbers in the
    map) at ``uv`` ``(n, 2)``, pixels."""

    rows: NDArray[np.intp]
    points: NDArray[np.intp]
    uv: Array


def sightings(copy: MapCopy, owner: MapOwner) -> Sightings:
    """Every view of the map's points from its key-frames. A point that is none of the owner's is seen by the key-frame
    that it belongs to alone, where the map has it."""
    views = owner.views
    number = _numbers(copy, owner)
    rows, points = [np.zeros(0, dtype=np.intp)], [np.zeros(0, dtype=np.intp)]
    uv = [np.zeros((0, 2))]
    for row, index in enumerate(copy.keyframes.tolist()):
        if not 0 <= index < len(views.starts) - 1:
            continue
        seen = views.of(index)
        ids = views.ids[seen]
        known = np.full(len(ids), -1)
        inside = ids < len(number)
        known[inside] = number[ids[inside]]
        points.append(known[known >= 0])
        rows.append(np.full(len(points[-1]), row))
        uv.append(views.uv[seen][known >= 0])
    at_home = np.zeros(len(copy.references), dtype=bool)
    seen_rows, seen_points = np.concatenate(rows), np.concatenate(points)
    at_home[seen_points[copy.references[seen_points] == seen_rows]] = True
    alone = np.flatnonzero(~at_home)
    every = np.concatenate([seen_rows, copy.references[alone].astype(np.intp)])
    order = np.argsort(every, kind="stable")
    pixels = np.concatenate([*uv, project(copy.points_C[alone], owner.camera)])
    return Sightings(every[order], np.concatenate([seen_points, alone])[order], pixels[order])


def _numbers(copy: MapCopy, owner: MapOwner) -> NDArray[np.intp]:
    """Number in the map of each of the owner's points, by their ids; -1 where it is not in it."""
    found: dict[int, int] = {}
    by_row = np.argsort(copy.references, kind="stable")
    bounds = np.searchsorted(copy.references[by_row], np.arange(len(copy.keyframes) + 1))
    for row, index in enumerate(copy.keyframes.tolist()):
        mine = by_row[bounds[row] : bounds[row + 1]]
        if not len(mine) or not 0 <= index < len(owner.keyframes) or not len(owner.keyframes[index].points_C):
            continue
        apart, ids = owner.nearest(index, copy.points_C[mine])
        near = apart <= _SAME_POINT * np.abs(copy.points_C[mine, 2])
        for point, id_ in zip(mine[near].tolist(), ids[near].tolist(), strict=True):
            found.setdefault(id_, point)
    out = np.full(max(found, default=-1) + 1, -1)
    out[list(found.keys())] = list(found.values())
    return out
