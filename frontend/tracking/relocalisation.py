"""Finding a lost camera again in the map of its track: by the words of its image, then by geometry.

As ORB-SLAM does it (Mur-Artal et al., 2015, section III-E): the vocabulary names key-frames that look alike, groups of
key-frames that see each other's points are ranked by their joint score, a pose is found from one key-frame's points by
RANSAC, and it counts only if the map around bears it out.

Only the map of the track that was lost is searched, not those of finished tracks. A track is one uninterrupted set of
the five files with key-frames in order of time; a camera that entered a finished track anew would break both. Tracks of
one agent are joined later by its own place matches, which bring their uncertainty along.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import OdometryConfig
from ..estimation.absolute_pose import absolute_pose
from ..estimation.pose_refinement import SeenPoints, refine_pose
from ..frames import Frame
from ..image.guided_matching import OrbFeatures, guided_match
from ..image.orb_features import Detector, Keypoints, Pyramid, describe
from ..mapping.map import Array, FrameObservations, Ints, Map, union
from ..mapping.range_sensor import Ranging
from ..reason import Reason
from ..vocabulary.lookup import WordLookup
from ..vocabulary.vocabulary import WordIndex
from .followed_points import TrackedFrame
from .track import Segment

_ORB_SIGMA_PX = 1.0
"""Standard deviation of an ORB key-point on level 0."""
_RANSAC_PX = 4.0
_ALIKE = 0.75
"""Groups scoring less than this share of the best are not looked at (ORB-SLAM's figure)."""
_COVISIBLE = 15
"""Points that two key-frames share at least to be neighbours."""
_ANY_LEVEL = 99.0
_LEVEL_SLACK = 2.5
_RECENT = 6
"""Key-frames before a loss whose points must be seen by another one."""
_GRID = (8, 6)
"""Cells of the image, columns and rows."""


@dataclass(frozen=True)
class _Support:
    """A pose ``T_C_W`` and the map points ``seen`` that agree with it; they fill the share ``spread`` of those cells of
    the image that hold key-points."""

    T_C_W: Array
    seen: FrameObservations
    spread: float

    @property
    def count(self) -> int:
        """Number of points that agree."""
        return len(self.seen.point)


class Relocaliser:
    """Search for a lost camera in one track's map. Words of key-frames are computed when the camera is lost, so
    tracking pays nothing."""

    def __init__(self, segment: Segment, ranging: Ranging, config: OdometryConfig, vocabulary: WordLookup) -> None:
        self.segment, self.ranging, self.config, self.vocabulary = segment, ranging, config, vocabulary
        self._detector = Detector(config.features)
        self._index = WordIndex()
        self.searches = 0
        """Images with texture that were searched; whoever asks starts the count."""
        self._numbers: list[int] = []

    def search(self, frame: Frame) -> TrackedFrame:
        """The pose of ``frame`` in the map; on success the tracker follows the points found from here on."""
        keypoints = self._describe(frame)
        settings, best, spread = self.config.lost, 0, 0.0
        if len(keypoints) < settings.min_matches:
            text = f"lost: {len(keypoints)} key-points in the image, need {settings.min_matches}"
            refusal = Reason("lost: too few key-points in the image", text, len(keypoints) / settings.min_matches)
            return TrackedFrame(None, 0, refusal)
        self.searches += 1
        for number in self.candidates(keypoints):
            first = self._from_keyframe(number, keypoints)
            found = self._from_map(first, number, keypoints) if first is not None else None
            if found is None:
                continue
            best, spread = max((best, spread), (found.count, found.spread))
            if found.count >= settings.min_matches and found.spread >= settings.min_spread:
                tracker = self.segment.tracker
                so_far = tracker.so_far.after(tracker.T_C_W, found.T_C_W, (frame.stamp_ns - tracker.stamp_ns) / 1e9)
                tracker.start(frame, found.T_C_W, found.seen)
                tracker.so_far = so_far
                return TrackedFrame(found.T_C_W, found.count)
        need = f"need {settings.min_matches} in {100 * settings.min_spread:.0f} %"
        seen = f"{best} points of the map in {100 * spread:.0f} % of the image"
        refusal = Reason(
            "lost: the map does not agree on a pose",
            f"lost: at best {seen} agree on a pose, {need}",
            min(best / settings.min_matches, spread / max(settings.min_spread, 1e-9)),
        )
        return TrackedFrame(None, best, refusal)

    def candidates(self, keypoints: Keypoints) -> list[int]:
        """Numbers of key-frames to try: the latest that stayed, then the best of each group that looks like the
        image."""
        self._catch_up()
        map_, settings = self.segment.map, self.config.lost
        scores = {
            self._numbers[place]: score
            for place, score in self._index.most_similar(
                self.vocabulary.bag(keypoints.descriptors), settings.similar_keyframes
            )
            if self._numbers[place] in map_.keyframes
        }
        groups: dict[int, float] = {}
        for group in self._groups(sorted(scores)):
            leader = max(group, key=lambda n: (scores[n], n))
            groups[leader] = max(groups.get(leader, 0.0), sum(scores[n] for n in group))
        enough = _ALIKE * max(groups.values(), default=0.0)
        ranked = sorted((n for n in groups if groups[n] >= enough), key=lambda n: (-groups[n], -n))
        latest = [n for n in self._numbers if n in map_.keyframes][-1:]
        return list(dict.fromkeys([*latest, *ranked[: settings.candidates]]))

    def _groups(self, numbers: list[int]) -> list[list[int]]:
        """For each of these key-frames those among them that share points with it, itself included."""
        seen = [np.unique(self.segment.map.keyframes[n].point) for n in numbers]
        place = np.repeat(np.arange(len(numbers)), [len(s) for s in seen])
        ids, column = np.unique(np.concatenate([np.array([-1]), *seen]), return_inverse=True)
        sees = np.zeros((len(numbers), len(ids)), dtype=np.float32)
        sees[place, column[1:]] = 1.0
        shared = sees[:, 1:] @ sees[:, 1:].T  # the first column is -1: no point
        return [[numbers[j] for j in np.flatnonzero(row >= _COVISIBLE).tolist()] for row in shared]

    def _catch_up(self) -> None:
        """Enter the key-frames made since the last loss."""
        since = self._numbers[-1] if self._numbers else -1
        for number in sorted(n for n in self.segment.map.keyframes if n > since):
            keyframe = self.segment.map.keyframes[number]
            if keyframe.described.any():
                self._index.add(self.vocabulary.bag(keyframe.descriptors[keyframe.described]))
                self._numbers.append(number)

    def _describe(self, frame: Frame) -> Keypoints:
        features = self.config.features
        pyramid = Pyramid(frame.image, features.levels, features.scale_factor, frame.used)
        uv, level, _ = self._detector.detect(pyramid, features.landmarks + features.tracks, np.zeros((0, 2)))
        found = describe(pyramid, uv, level)
        usable = np.flatnonzero(np.isfinite(found.angle_deg))
        return Keypoints(uv[usable], level[usable], found.angle_deg[usable], found.descriptors[usable])

    def _from_keyframe(self, number: int, keypoints: Keypoints) -> _Support | None:
        """A pose from the points that one key-frame sees, matched wherever they may be in the image."""
        map_ = self.segment.map
        keyframe = map_.keyframes[number]
        rows = np.flatnonzero((keyframe.point >= 0) & keyframe.described)
        rows = rows[self._known(keyframe.point[rows])]
        anywhere = np.full(len(rows), np.inf)
        match = guided_match(keyframe.features(rows), anywhere, keypoints.features(), self.config.mapping, _ANY_LEVEL)
        hit = np.flatnonzero(match >= 0)
        ids = keyframe.point[rows[hit]]
        T = absolute_pose(map_.xyz[ids], self.ranging.ideal(keypoints.uv[match[hit]]), self.ranging.cam, _RANSAC_PX)
        return None if T is None else self._refined(T, ids, match[hit], keypoints)

    def _known(self, ids: Ints) -> NDArray[np.bool_]:
        """Points ``(n,)`` of known position, without those that one of the latest key-frames alone saw: they may be on
        what came into view and hid the others."""
        map_ = self.segment.map
        recent = union([map_.keyframes[number].point for number in map_.latest(_RECENT)])
        return np.isfinite(map_.xyz[ids, 0]) & ((map_.views[ids] >= 2) | ~np.isin(ids, recent))

    def _from_map(self, first: _Support, number: int, keypoints: Keypoints) -> _Support | None:
        """A second look: everything that ``number`` and its neighbours know, projected with the pose found, and what
        of it is there."""
        map_, mapping = self.segment.map, self.config.mapping
        ids, uv = self._visible(map_, first, number)
        level = map_.level[ids].astype(np.float64)
        radius = mapping.match_radius_px * self.config.features.scale_factor**level
        predicted = OrbFeatures(uv, level, map_.descriptors[ids])
        match = guided_match(predicted, radius, keypoints.features(), mapping, _LEVEL_SLACK)
        hit = np.flatnonzero(match >= 0)
        return self._refined(first.T_C_W, ids[hit], match[hit], keypoints)

    def _visible(self, map_: Map, first: _Support, number: int) -> tuple[Ints, Array]:
        """Described points of a key-frame and those covisible with it that project into the image, and where."""
        seen = map_.keyframes[number].point
        group = [number, *map_.covisible(seen[seen >= 0], {number})[: self.config.lost.group_keyframes]]
        ids = np.unique(np.concatenate([first.seen.point, *(map_.keyframes[n].point for n in group)]))
        ids = ids[ids >= 0]
        ids = ids[self._known(ids) & map_.described[ids]]
        uv, depth = self.ranging.project(first.T_C_W, map_.xyz[ids])
        camera = self.ranging.rig.camera
        inside = (depth > 0) & (uv >= 0).all(axis=1) & (uv < [camera.width, camera.height]).all(axis=1)
        return ids[inside], uv[inside]

    def _refined(self, T: Array, ids: Ints, match: Ints, keypoints: Keypoints) -> _Support | None:
        """The pose refined on key-points ``match`` of points ``ids``, and those that agree."""
        if len(ids) < self.config.pose.min_inliers:
            return None
        uv = keypoints.uv[match]
        ideal = self.ranging.ideal(uv)
        sigma = _ORB_SIGMA_PX * self.config.features.scale_factor ** keypoints.level[match].astype(np.float64)
        outlier = self.config.pose.outlier_sigmas
        seen = SeenPoints.without_depth(self.segment.map.xyz[ids], ideal, sigma)
        T, good, _ = refine_pose(T, seen, self.ranging.cam, outlier, 4)
        if good.sum() < self.config.pose.min_inliers or not np.isfinite(T).all():
            return None
        spread = len(self._cells(uv[good])) / max(len(self._cells(keypoints.uv)), 1)
        return _Support(T, FrameObservations(ids[good], uv[good]), spread)

    def _cells(self, uv: Array) -> Ints:
        """Cells of the image that hold these pixels."""
        camera = self.ranging.rig.camera
        column, row = (uv * _GRID / [camera.width, camera.height]).astype(np.int64).T
        return np.unique(row * _GRID[0] + column)
