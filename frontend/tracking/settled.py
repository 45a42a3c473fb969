"""Key-frames passed on while odometry goes on: each once its pose is final, as it is in the finished track.

The window's bundle adjustment moves its latest key-frames; what has become one of its fixed ones moves no more. Its
points may: later key-frames refine them, merge them or find them wrong. They are passed on as known by then.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse, transform_points

from ..config import OdometryConfig
from ..files.trajectory import Trajectory
from ..mapping.map import Map, MapKeyFrame
from ..mapping.point_culling import AFTER, BEFORE, found_ratio
from ..vocabulary.lookup import WordLookup
from .track import Segment

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class SettledKeyFrame:
    """A key-frame with what it sees. ``track``: number of its track, one more for each that begins or that another one
    has interrupted; ``frame_index``, ``stamp_ns``: of its frame; ``T_T_C`` ``(4, 4)``: in the track's frame.

    ``points_T`` ``(n, 3)``: the points in the track's frame, numbered ``point_ids`` ``(n,)``, from 0 in each track and
    the same in all its key-frames; ``first_seen`` ``(n,)`` bool: in none before; ``descriptors`` ``(n, 32)`` uint8 with
    ``words`` ``(n, 2)``. ``frames``: poses of the frames since the key-frame before, of the last key-frame of a track
    also of those after it.
    """

    track: int
    frame_index: int
    stamp_ns: int
    T_T_C: Array
    points_T: Array
    point_ids: Ints
    first_seen: NDArray[np.bool_]
    descriptors: NDArray[np.uint8]
    words: NDArray[np.int32]
    frames: Trajectory


@dataclass
class _Passed:
    """What was passed on of a segment since it was last taken up: ``last``: number of the latest key-frame, with its
    pose then, as passed on (``T_T_C``) and in the map (``T_W_C``); ``rows``: frames of its log; ``ids``: number of each
    point of the map."""

    segment: Segment
    track: int
    last: int
    rows: int
    T_T_C: Array | None = None
    T_W_C: Array | None = None
    T_T_W: Array | None = None
    ids: dict[int, int] = field(default_factory=dict)


class SettledKeyFrames:
    """Key-frames of an odometry's tracks, each passed on once.

    ``after``: newer key-frames of the map that one waits for, at least 1; None: until its pose is final. Where it does
    not wait so long, a pose that has changed since changes the steps that follow, not those passed on.
    """

    def __init__(self, config: OdometryConfig, vocabulary: WordLookup, after: int | None = None) -> None:
        if after is not None and after < 1:
            raise ValueError(f"a key-frame waits for 1 newer one at least, not {after}")
        self._config, self._vocabulary = config, vocabulary
        mapping = config.mapping
        self._until_final = max(mapping.window - 1 - mapping.fixed, 1)
        self._after = self._until_final if after is None else after
        # Shorter windows than this hold their first key-frame alone.
        self._least = mapping.window - 1 if self._after >= self._until_final else 1
        self._current: _Passed | None = None
        self._done: dict[int, tuple[Segment, int, int]] = {}
        self._tracks = 0

    def take(self, segments: Sequence[Segment], last: bool = False) -> list[SettledKeyFrame]:
        """What can be passed on by now, in order of time. ``segments``: finished tracks and the current one;
        ``last``: no more frames come."""
        out: list[SettledKeyFrame] = []
        for segment in segments:
            going_on = segment is segments[-1] and not last
            for number in self._due(segment, going_on):
                out.append(self._passed_on(segment, number, going_on))
        return out

    def since(self, segment: Segment, T_W_C: Array) -> Array | None:
        """``T_K_C`` ``(4, 4)``: a pose in the current track relative to the latest key-frame passed on, in the track's
        unit; None where that is of another track."""
        passed = self._current
        if passed is None or passed.segment is not segment or passed.T_W_C is None:
            return None
        return product(segment.map.keyframes[passed.last].T_C_W, T_W_C)

    def _due(self, segment: Segment, going_on: bool) -> list[int]:
        """Numbers of key-frames of a segment, in order."""
        if not segment.lasting(self._config.min_track_keyframes):
            return []
        _, before, _ = self._done.get(id(segment), (segment, -1, 0))
        keyframes = segment.map.keyframes
        numbers = [n for n, keyframe in keyframes.items() if n > before and keyframe.stays]
        if not going_on:
            return numbers
        every = list(keyframes)
        settled = set(every[: -self._after]) if len(every) >= self._least else set()
        return [n for n in numbers[:-1] if n in settled]

    def _passed_on(self, segment: Segment, number: int, going_on: bool) -> SettledKeyFrame:
        passed = self._taken_up(segment)
        keyframe = segment.map.keyframes[number]
        T_T_W = self._to_track(passed)
        T_W_C = keyframe.T_W_C
        T_T_C = T_W_C if T_T_W is None else product(T_T_W, T_W_C)
        passed.last, passed.T_W_C, passed.T_T_C, passed.T_T_W = number, T_W_C, T_T_C, T_T_W
        rows, ids = _seen(segment, keyframe)
        numbers, first_seen = _numbered(passed.ids, ids)
        points = segment.map.xyz[ids]
        descriptors = np.ascontiguousarray(keyframe.descriptors[rows])
        words = self._vocabulary.words(descriptors) if len(rows) else np.zeros((0, 2), dtype=np.int32)
        whole = not going_on and number == max(n for n, k in segment.map.keyframes.items() if k.stays)
        frames = self._frames(passed, None if whole else keyframe.stamp_ns)
        self._done[id(segment)] = (segment, number, passed.rows)
        return SettledKeyFrame(
            passed.track,
            keyframe.frame_index,
            keyframe.stamp_ns,
            T_T_C,
            points if T_T_W is None else transform_points(T_T_W, points),
            numbers,
            first_seen,
            descriptors,
            words.astype(np.int32),
            frames,
        )

    def _taken_up(self, segment: Segment) -> _Passed:
        """The segment as a track: a new one where the latest key-frame was another's."""
        if self._current is None or self._current.segment is not segment:
            _, last, rows = self._done.get(id(segment), (segment, -1, 0))
            self._current = _Passed(segment, self._tracks, last, rows)
            self._tracks += 1
        return self._current

    def _to_track(self, passed: _Passed) -> Array | None:
        """``T_T_W``: what keeps the step from the key-frame before as it is now, where that was passed on as it was
        then; None where the map's frame is the track's."""
        if passed.T_W_C is None or passed.T_T_C is None:
            return None
        before = passed.segment.map.keyframes[passed.last]
        if np.array_equal(before.T_W_C, passed.T_W_C):
            return passed.T_T_W
        return product(passed.T_T_C, before.T_C_W)

    def _frames(self, passed: _Passed, until_ns: int | None) -> Trajectory:
        """Poses in the track's frame of the frames not yet passed on, up to a time (None: all)."""
        log, map_ = passed.segment.frames, passed.segment.map
        stamps = log.stamps_ns()
        end = len(log) if until_ns is None else int(np.searchsorted(stamps, until_ns, side="right"))
        rows = range(passed.rows, end)
        passed.rows = max(end, passed.rows)
        if not rows:
            return Trajectory(stamps[:0], np.zeros((0, 4, 4)))
        poses = se3_inverse(np.stack([product(log.T_C_K(i), map_.pose(log.keyframe(i))) for i in rows]))
        return Trajectory(stamps[rows.start : end], poses if passed.T_T_W is None else product(passed.T_T_W, poses))


def _numbered(known: dict[int, int], ids: Ints) -> tuple[Ints, NDArray[np.bool_]]:
    """Numbers ``(n,)`` of points of the map, without gaps, and which are new."""
    new = np.array([point not in known for point in ids.tolist()], dtype=bool)
    for point in ids[new].tolist():
        known[point] = len(known)
    return np.array([known[point] for point in ids.tolist()], dtype=np.int64), new


def _seen(segment: Segment, keyframe: MapKeyFrame) -> tuple[Ints, Ints]:
    """Rows of a key-frame's observations worth passing on, and their points, ascending: by the rules of
    :func:`~.export.export_track`, as far as the map goes by now."""
    map_ = segment.map
    rows = np.flatnonzero((keyframe.point >= 0) & keyframe.described)
    ids = keyframe.point[rows]
    rows = rows[map_.alive[ids] & np.isfinite(map_.xyz[ids, 0])]
    rows = rows[np.argsort(keyframe.point[rows], kind="stable")]
    ids = keyframe.point[rows]
    if not len(ids):
        return rows, ids
    stay = [n for n, one in map_.keyframes.items() if one.stays]
    slot, point = _views(map_, ids, {n: k for k, n in enumerate(stay)})
    count = np.bincount(point, minlength=len(ids))
    near = slice(max(int(slot.min()) - BEFORE, 0), int(slot.max()) + AFTER + 1)
    poses = np.stack([map_.keyframes[n].T_W_C for n in stay[near]])
    mapper = segment.mapper
    seen = np.stack([slot - near.start, point], axis=1)
    ratio = found_ratio(poses, map_.xyz[ids], seen, mapper.ranging.rig.camera)
    use = ((count >= 2) | map_.metric[ids]) & (ratio >= mapper.config.mapping.min_found_ratio)
    return rows[use], ids[use]


def _views(map_: Map, ids: Ints, slots: dict[int, int]) -> tuple[Ints, Ints]:
    """Described views of points by key-frames that stay: ``slots`` of the key-frame's number, and which of ``ids``."""
    views = [
        (slots[number], k)
        for k, point in enumerate(ids.tolist())
        for number, row in map_.observers[point]
        if number in slots and map_.keyframes[number].described[row]
    ]
    slot, point = np.array(views, dtype=np.int64).reshape(-1, 2).T
    return slot, point
