"""One uninterrupted track: its map, its tracker and mapper, and the pose of each frame relative to a key-frame."""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse, transform_points

from ..cameras.models import Rig
from ..config import OdometryConfig
from ..files.trajectory import Trajectory
from ..frames import Frame
from ..mapping.map import FrameObservations, Map, MapKeyFrame
from ..mapping.mapper import Mapper
from ..mapping.range_sensor import Ranging
from ..reason import Reason
from ..stopwatch import Stopwatch
from .doubt import jumps
from .followed_points import TrackedFrame
from .keyframe_policy import SinceKeyframe
from .light import AmbientLight
from .pose_log import PoseLog
from .tracker import Tracker

Array = NDArray[np.float64]
_SLOW = 0.01
"""Share of the image's width."""
_SEEN_AGAIN = 15
"""Points that several key-frames saw and that tell how far a view reaches."""


class Segment:
    """The track in progress."""

    def __init__(self, ranging: Ranging, config: OdometryConfig, watch: Stopwatch | None = None) -> None:
        self.map = Map()
        self.mapper = Mapper(self.map, ranging, config, watch)
        self.tracker = Tracker(ranging, config)
        self.light = AmbientLight()
        self.frames = PoseLog()
        self.latest: MapKeyFrame | None = None
        self._reference_points = 0

    def track(self, frame: Frame) -> TrackedFrame:
        """Follow the points into ``frame``; where the light is back, those that were followed before it went out, if
        more of them agree."""
        assert self.latest is not None
        self.light.look(frame.image, self.tracker, self.latest)
        last = copy(self.tracker)
        tracked = self.tracker.track(frame, self.map)
        before = self.light.kept(self.map)
        if before is not None and before.stamp_ns < last.stamp_ns:
            again = before.track(frame, self.map, last.predict(frame) if tracked.T_C_W is None else tracked.T_C_W)
            if again.T_C_W is not None and (tracked.T_C_W is None or again.inliers > tracked.inliers):
                # The frame before is the last one without light.
                before.motion = product(again.T_C_W, se3_inverse(last.T_C_W))
                before.step_s = (frame.stamp_ns - last.stamp_ns) / 1e9
                self._go_on(before)
                tracked = again
        if before is not None and tracked.T_C_W is not None:
            self.light.forget()
        return tracked

    def _go_on(self, tracker: Tracker) -> None:
        """Follow what ``tracker`` follows from here on."""
        self.tracker = tracker
        self._reference_points = int(np.isfinite(self.map.xyz[tracker.followed.point, 0]).sum())

    def record(self, frame: Frame, T_C_W: Array) -> None:
        """Note a tracked frame, relative to the latest key-frame."""
        assert self.latest is not None
        self.frames.note(
            frame.index, frame.stamp_ns, self.latest.number, product(T_C_W, se3_inverse(self.latest.T_C_W))
        )

    def since_keyframe(self, frame: Frame, rig: Rig) -> SinceKeyframe:
        """Changes since the latest key-frame, for the key-frame policy."""
        assert self.latest is not None
        followed, latest = self.tracker.followed, self.latest
        moved = np.linalg.norm((followed.uv - followed.anchor_uv)[followed.found], axis=1)
        flow = float(np.median(moved)) / rig.camera.width if len(moved) else 1.0
        known = int(np.isfinite(self.map.xyz[followed.seen.point, 0]).sum())
        keyframes = len(self.map.keyframes) + len(self.map.culled)
        return SinceKeyframe(frame.index - latest.frame_index, known, self._reference_points, flow, keyframes)

    def adds_views(self, since: SinceKeyframe) -> bool:
        """Whether a key-frame may be made: not of a standing camera, whose new points would be those of what came
        before it."""
        standing = self.tracker.standing
        return not (standing.held or (standing.rested and since.flow < self.tracker.config.keyframes.min_flow))

    def insert_keyframe(self, frame: Frame) -> None:
        """Make the frame last tracked a key-frame; what is followed from here on is what it sees."""
        tracker = self.tracker
        self.latest = self.mapper.insert(frame, tracker.T_C_W, tracker.followed.seen)
        self.follow(frame)

    def follow(self, frame: Frame) -> None:
        """Follow the points of the latest key-frame from ``frame``, its own image, on."""
        latest = self.latest
        assert latest is not None
        self.light.at_keyframe(frame.image)
        self.frames.note(frame.index, frame.stamp_ns, latest.number, np.eye(4))
        rows = np.flatnonzero(latest.followed & (latest.point >= 0))
        previous = None
        if self.tracker.motion is not None and len(self.frames) > 1:
            # The map has just moved: the velocity must come from poses of the same map.
            T_C_W = product(self.frames.T_C_K(-2), self.map.pose(self.frames.keyframe(-2)))
            previous = product(latest.T_C_W, se3_inverse(T_C_W))
        seen = FrameObservations(latest.point[rows], latest.uv[rows])
        self.tracker.start(frame, latest.T_C_W, seen)
        self.tracker.motion = previous
        self._reference_points = int(np.isfinite(self.map.xyz[seen.point, 0]).sum())

    @property
    def slow(self) -> bool:
        """Whether the last step moved the image by little: what is lost then was not lost by the camera's motion."""
        tracker = self.tracker
        if tracker.motion is None:
            return False
        xyz = self.map.xyz[tracker.followed.seen.point]
        now, _ = tracker.ranging.project(tracker.T_C_W, xyz)
        before, _ = tracker.ranging.project(product(se3_inverse(tracker.motion), tracker.T_C_W), xyz)
        moved_px = np.hypot(*(now - before).T)
        moved_px = moved_px[np.isfinite(moved_px)]
        return len(moved_px) > 0 and float(np.median(moved_px)) < _SLOW * tracker.ranging.rig.camera.width

    def view_depth(self) -> float:
        """Median depth of the points that several key-frames saw, in the latest one that sees some; of all points of a
        track that has just begun. In the track's unit."""
        depth = 0.0
        for keyframe in reversed(self.map.keyframes.values()):
            seen = keyframe.point[keyframe.point >= 0]
            z = transform_points(keyframe.T_C_W, self.map.xyz[seen])[:, 2]
            known = np.isfinite(z)
            again = known & (self.map.views[seen] >= 2)
            if int(again.sum()) >= _SEEN_AGAIN:
                return float(np.median(z[again]))
            depth = depth or (float(np.median(z[known])) if known.any() else 0.0)
        return depth

    def lasting(self, count: int) -> bool:
        """Whether at least ``count`` of its key-frames will stay."""
        return sum(keyframe.stays for keyframe in self.map.keyframes.values()) >= count

    def close(self) -> None:
        """No more frames: what only supported the window goes."""
        self.mapper.more_views.finish()
        numbers = sorted(self.map.keyframes)
        for k in range(1, len(numbers)):
            if not self.map.keyframes[numbers[k]].stays:
                parent = next(n for n in reversed(numbers[:k]) if n in self.map.keyframes)
                self.map.cull_keyframe(numbers[k], parent)

    def keyframe_indices(self) -> NDArray[np.int64]:
        """Frame index of each key-frame that stayed."""
        return np.array([self.map.keyframes[k].frame_index for k in sorted(self.map.keyframes)], dtype=np.int64)

    def jumps(self) -> list[tuple[int, Reason]]:
        """Time stamp, nanoseconds, and doubt of each frame whose step is a jump."""
        trajectory = self.trajectory()
        unit = "m" if self.tracker.ranging.rig.metric else "(unit of the track)"
        found = jumps(trajectory.stamps_ns, trajectory.centres, self._depths(), unit)
        return [(int(trajectory.stamps_ns[k]), doubt) for k, doubt in found]

    def _depths(self) -> Array:
        """Median depth of the points that each frame's key-frame sees, in the track's unit; of a culled one its
        parent's."""
        of: dict[int, float] = {}
        for number, keyframe in self.map.keyframes.items():
            z = transform_points(keyframe.T_C_W, self.map.xyz[keyframe.point[keyframe.point >= 0]])[:, 2]
            of[number] = float(np.nanmedian(z)) if np.isfinite(z).any() else 0.0
        out = np.empty(len(self.frames))
        for i in range(len(out)):
            number = self.frames.keyframe(i)
            while number not in of:
                number = self.map.culled[number].parent
            out[i] = of[number]
        return out

    def trajectory(self) -> Trajectory:
        """``T_W_C`` of every frame, through its key-frame's final pose."""
        frames = self.frames
        T_C_W = [product(frames.T_C_K(i), self.map.pose(frames.keyframe(i))) for i in range(len(frames))]
        return Trajectory(frames.stamps_ns(), se3_inverse(np.stack(T_C_W)))
