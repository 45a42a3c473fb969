"""Which key-frames of a map see which of its points, as the owner's odometry has it.

A map copy holds each point once, in the key-frame that saw it first. Results for other programs want every view of a
point: those stand in the owner's sequence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from maslam.backend.geometry import Array

from ..map_exchange.map_copy import MapCopy
from ..state.keyframe import KeyFrame

# A copied point is one of the owner's key-frame where it lies this near to it, as a share of its depth: copies are
# rounded by less.
_SAME_POINT = 0.05


@dataclass(frozen=True, eq=False)
class Sightings:
    """Views of a map's points, ordered by row: key-frame ``rows`` ``(n,)`` sees ``points`` ``(n,)`` (numbers in the
    map) at ``points_C`` ``(n, 3)`` in its camera, in the owner's unit."""

    rows: NDArray[np.int64]
    points: NDArray[np.int64]
    points_C: Array


def first_sightings(copy: MapCopy) -> Sightings:
    """What the map itself holds: each point in the key-frame that it belongs to."""
    order = np.argsort(copy.references, kind="stable")
    return Sightings(copy.references[order].astype(np.int64), order.astype(np.int64), copy.points_C[order])


def sightings(copy: MapCopy, owner: Sequence[KeyFrame]) -> Sightings:
    """Every view of the map's points from its key-frames; ``owner``: all key-frames of the map's owner."""
    own, number = first_sightings(copy), _numbers(copy, owner)
    rows, points, points_C = [own.rows], [own.points], [own.points_C]
    for row, index in enumerate(copy.keyframes.tolist()):
        if not 0 <= index < len(owner):
            continue
        keyframe = owner[index]
        known = np.array([number.get(i, -1) for i in keyframe.point_ids.tolist()], dtype=np.int64)
        again = (known >= 0) & (keyframe.points_C[:, 2] > 0)
        again[again] = copy.references[known[again]] != row
        points.append(known[again])
        rows.append(np.full(int(again.sum()), row))
        points_C.append(keyframe.points_C[again].astype(np.float64))
    every = np.concatenate(rows)
    order = np.argsort(every, kind="stable")
    return Sightings(every[order], np.concatenate(points)[order], np.concatenate(points_C)[order])


def _numbers(copy: MapCopy, owner: Sequence[KeyFrame]) -> dict[int, int]:
    """Number in the map of each of the owner's points that is in it."""
    found: dict[int, int] = {}
    for row, index in enumerate(copy.keyframes.tolist()):
        mine = np.flatnonzero(copy.references == row)
        if not len(mine) or not 0 <= index < len(owner) or not len(owner[index].points_C):
            continue
        apart, nearest = cKDTree(owner[index].points_C.astype(np.float64)).query(copy.points_C[mine])
        near = apart <= _SAME_POINT * np.abs(copy.points_C[mine, 2])
        for point, id_ in zip(mine[near].tolist(), owner[index].point_ids[nearest[near]].tolist(), strict=True):
            found.setdefault(id_, point)
    return found
