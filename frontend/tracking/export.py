"""A finished map as the five files' content."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..files.point_views import PointViews
from ..files.vo_files import VoTrack
from ..mapping.map import FrameObservations, Ints, MapKeyFrame
from ..mapping.point_culling import found_ratio
from ..vocabulary.lookup import WordLookup
from .track import Segment


def export_track(segment: Segment, vocabulary: WordLookup) -> tuple[VoTrack, PointViews]:
    """Final key-frames, points and described observations, renumbered without gaps; and where these points are seen.

    A point is written where two key-frames see it or where a depth was measured for it: a point of one ray has no
    place. Points found in too few of the key-frames that should have seen them are left out. An observation is written
    where it has an ORB descriptor (not at the very border of the image); the views are all.
    """
    map_ = segment.map
    numbers = sorted(map_.keyframes)
    kf, point, descriptors = (
        [np.zeros(0, dtype=np.int64)],
        [np.zeros(0, dtype=np.int64)],
        [np.zeros((0, 32), dtype=np.uint8)],
    )
    for k, number in enumerate(numbers):
        keyframe = map_.keyframes[number]
        rows = np.flatnonzero((keyframe.point >= 0) & keyframe.described)
        ids = keyframe.point[rows]
        rows = rows[map_.alive[ids] & np.isfinite(map_.xyz[ids, 0])]
        kf.append(np.full(len(rows), k))
        point.append(keyframe.point[rows])
        descriptors.append(keyframe.descriptors[rows])
    kf_of, point_of, rows_of = np.concatenate(kf), np.concatenate(point), np.concatenate(descriptors)
    count = np.bincount(point_of, minlength=len(map_))
    use = (count[point_of] >= 2) | map_.metric[point_of]
    kf_of, point_of, rows_of = kf_of[use], point_of[use], rows_of[use]
    use = _often_found(segment, kf_of, point_of)[point_of]
    kf_of, point_of, rows_of = kf_of[use], point_of[use], rows_of[use]
    ids, renumbered = np.unique(point_of, return_inverse=True)
    order = np.lexsort((renumbered, kf_of))
    observations = np.stack([kf_of, renumbered], axis=1)[order].astype(np.int32)
    rows_of = np.ascontiguousarray(rows_of[order])
    words = vocabulary.words(rows_of) if len(rows_of) else np.zeros((0, 2), dtype=np.int32)
    keyframes = [map_.keyframes[k] for k in numbers]
    stamps = np.array([k.stamp_ns / 1e9 for k in keyframes])
    track = VoTrack(
        stamps,
        np.stack([k.T_W_C for k in keyframes]),
        map_.xyz[ids].copy(),
        observations,
        rows_of,
        words.astype(np.int32),
    )
    return track, _views(segment, keyframes, ids)


def _views(segment: Segment, keyframes: list[MapKeyFrame], ids: Ints) -> PointViews:
    """Where ``keyframes`` see the points ``ids`` ``(P,)`` of the map, or show them without odometry having looked."""
    number = np.full(len(segment.map), -1)
    number[ids] = np.arange(len(ids))
    kf, point, uv = [np.zeros(0, dtype=np.int64)], [np.zeros(0, dtype=np.int64)], [np.zeros((0, 2))]
    for k, keyframe in enumerate(keyframes):
        nothing = FrameObservations(keyframe.point[:0], keyframe.uv[:0])
        more = segment.mapper.more_views.found.get(keyframe.number, nothing)
        # A point that two were merged into may have been found beside itself.
        found = ~np.isin(more.point, keyframe.point)
        every = np.concatenate([keyframe.point, more.point[found]])
        rows = np.flatnonzero(every >= 0)
        rows = rows[number[every[rows]] >= 0]
        kf.append(np.full(len(rows), k))
        point.append(number[every[rows]])
        uv.append(np.concatenate([keyframe.uv, more.uv[found]])[rows])
    return PointViews.sorted(np.concatenate(kf), np.concatenate(point), np.concatenate(uv))


def _often_found(segment: Segment, kf_of: Ints, point_of: Ints) -> NDArray[np.bool_]:
    """For each point of the map; ``kf_of`` counts the key-frames that stay."""
    map_, mapper = segment.map, segment.mapper
    poses = np.stack([map_.keyframes[k].T_W_C for k in sorted(map_.keyframes)])
    seen = np.stack([kf_of, point_of], axis=1)
    return found_ratio(poses, map_.xyz, seen, mapper.ranging.rig.camera) >= mapper.config.mapping.min_found_ratio
