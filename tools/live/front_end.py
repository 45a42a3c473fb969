"""Frames one by one through odometry and place descriptor: the key-frames that preprocessing makes of the same images,
while the camera goes on.

The odometry is preprocessing's. A key-frame is passed on once its pose is final (:mod:`~maslam.frontend.tracking.
settled`), with the points that the map has by then. What preprocessing does with a whole sequence is not done: no focal
length is estimated, and no point is left out for what key-frames that come later show.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import se3_inverse, transform_points
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.odometry import Odometry
from maslam.frontend.tracking.settled import SettledKeyFrame, SettledKeyFrames
from maslam.mas.live.cpu_parts import CpuParts
from maslam.mas.live.observed import Observed
from maslam.mas.state.keyframe import KeyFrame, median_depth, recording_of

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.frontend.cameras.models import Rig
    from maslam.frontend.config import OdometryConfig
    from maslam.frontend.frames import Frame
    from maslam.frontend.odometry import FrameResult, OdometryResult
    from maslam.frontend.vocabulary.lookup import WordLookup

# Parts of CPU time. Odometry includes decoding of second images; settling is what makes key-frames final.
ODOMETRY, DESCRIPTOR, SETTLING = "odometry", "descriptor", "settling"
log = logging.getLogger(__name__)
Colour = Callable[[], NDArray[np.uint8]]


@dataclass(frozen=True)
class Beginning:
    """What a front end goes on from: numbers of the next key-frame, track and point; ``start_ns``: time stamp of the
    agent's first frame, None where it has none yet; ``latest_ns``: of its latest key-frame."""

    index: int = 0
    track: int = 0
    point: int = 0
    start_ns: int | None = None
    latest_ns: int | None = None

    @classmethod
    def after(cls, keyframes: Sequence[KeyFrame]) -> Beginning:
        """That which follows the key-frames of an agent, in order."""
        if not keyframes:
            return cls()
        last = keyframes[-1]
        points = [int(k.point_ids.max()) for k in keyframes if len(k.point_ids)]
        point = max(points, default=-1) + 1
        return cls(last.index + 1, last.track + 1, point, last.stamp_ns - last.time_ns, last.stamp_ns)


@dataclass(frozen=True, eq=False)
class TrackedLive:
    """What the front end made of a frame: ``observed``: key-frames that are passed on by it; ``T_K_C`` ``(4, 4)``: its
    pose relative to the latest key-frame passed on, number ``keyframe`` of the agent, in the track's unit; None where
    it has no pose, or its track no such key-frame yet."""

    result: FrameResult
    observed: tuple[Observed, ...]
    keyframe: int | None = None
    T_K_C: NDArray[np.float64] | None = None


class LiveFrontEnd:
    """Frames go to :meth:`process` in order of time, then :meth:`finish` is called.

    ``source``: name of the recording: agents that read the same one know its images by it. ``after``: see
    :class:`~maslam.frontend.tracking.settled.SettledKeyFrames`; ``beginning``: what it goes on from; ``cpu``: takes the
    CPU time of its parts.
    """

    def __init__(
        self,
        rig: Rig,
        config: OdometryConfig,
        vocabulary: WordLookup,
        model: PlaceDescriptor,
        source: str,
        after: int | None = None,
        beginning: Beginning | None = None,
        cpu: CpuParts | None = None,
    ) -> None:
        self.odometry = Odometry(rig, config, vocabulary)
        self.beginning = beginning or Beginning()
        self._cpu = cpu or CpuParts()
        self.start_ns = self.beginning.start_ns
        self._settled = SettledKeyFrames(config, vocabulary, after)
        self._model = model
        self._recording = recording_of(source)
        self._described: dict[int, tuple[NDArray[np.float32], bool]] = {}
        self._index, self._track = self.beginning.index, -1
        self._first_point = self._next_point = self.beginning.point

    def warm_up(self) -> None:
        """Have the descriptor ready before the first frame: its first image takes longer than others."""
        camera = self.odometry.rig.camera
        shape = (camera.height, camera.width, 3) if self._model.colour else (camera.height, camera.width)
        self._model.look([np.zeros(shape, dtype=np.uint8)])

    def process(self, frame: Frame, colour: Colour | None = None) -> TrackedLive:
        """Track a frame. ``colour``: gives its image ``(H, W, 3)`` BGR, for a descriptor that uses colours."""
        if self.start_ns is None:
            self.start_ns = frame.stamp_ns
        with self._cpu.part(ODOMETRY):
            result = self.odometry.process(frame)
        observed: tuple[Observed, ...] = ()
        if result.first is not None:
            self._describe(result.first, None)
        if result.stays:
            self._describe(frame, colour)
        if result.is_keyframe:
            with self._cpu.part(SETTLING):
                observed = tuple(self._observed(one) for one in self._settled.take(self.odometry.segments))
        since = None if result.T_W_C is None else self._settled.since(self.odometry.segments[-1], result.T_W_C)
        if since is None:
            return TrackedLive(result, observed)
        return TrackedLive(result, observed, self._index - 1, since)

    def finish(self) -> tuple[tuple[Observed, ...], OdometryResult]:
        """No more frames come: the remaining key-frames, and what preprocessing has at this point."""
        observed = tuple(self._observed(one) for one in self._settled.take(self.odometry.segments, last=True))
        return observed, self.odometry.finish()

    def _describe(self, frame: Frame, colour: Colour | None) -> None:
        image = colour() if colour is not None and self._model.colour else frame.image
        with self._cpu.part(DESCRIPTOR):
            vectors, textured = self._model.look([image])
        self._described[frame.index] = vectors[0], bool(textured[0])

    def _observed(self, one: SettledKeyFrame) -> Observed:
        assert self.start_ns is not None
        if one.track != self._track:
            self._track, self._first_point = one.track, self._next_point
        vector, textured = self._described.pop(one.frame_index, (None, False))
        if vector is None:
            log.warning("key-frame of frame %d has no place vector: it is not recognised", one.frame_index)
            vector = np.zeros(self._model.dim, dtype=np.float32)
        points_C = transform_points(se3_inverse(one.T_T_C), one.points_T)
        point_ids = self._first_point + one.point_ids
        self._next_point = max(self._next_point, int(point_ids.max(initial=-1)) + 1)
        keyframe = KeyFrame(
            index=self._index,
            time_ns=one.stamp_ns - self.start_ns,
            stamp_ns=one.stamp_ns,
            recording=self._recording,
            track=self.beginning.track + one.track,
            T_T_C=one.T_T_C,
            points_C=points_C.astype(np.float32),
            descriptors=one.descriptors,
            words=one.words[:, 1].astype(np.int32),
            point_ids=point_ids,
            first_seen=one.first_seen,
            depth=median_depth(points_C),
            vector=np.asarray(vector, dtype=np.float32),
            textured=textured,
        )
        self._index += 1
        return Observed(keyframe, Trajectory(one.frames.stamps_ns - self.start_ns, one.frames.poses))
