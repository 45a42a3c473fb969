"""Key-frame odometry: frames in, poses, key-frames and map points out (thesis sections 2.1.3 and 3.3)."""

from __future__ import annotations

import logging
from pathlib import PurePath

import numpy as np

from maslam.backend.geometry import se3_inverse

from .cameras.models import Rig, RigKind
from .config import OdometryConfig
from .enlargement import Enlargement
from .errors import FrontendError
from .files.point_views import PointViews
from .frames import Frame
from .mapping.map import Map
from .mapping.range_sensor import Ranging
from .odometry_results import FrameResult, OdometryResult, TrackingState
from .reason import NO_REASON, STANDS_SHORT, Reason
from .stopwatch import Stopwatch, TimedStage
from .tracking.carried import CARRIED
from .tracking.darkness import doubt_dark, unless_dark
from .tracking.export import export_track
from .tracking.followed_points import TrackedFrame
from .tracking.initialisation import WITHOUT_SECOND, make_starter
from .tracking.keyframe_policy import wants_keyframe
from .tracking.pose_log import MomentLog
from .tracking.relocalisation import Relocaliser
from .tracking.shadow import Shadow
from .tracking.track import Segment
from .vocabulary.lookup import WordLookup

__all__ = ["FrameResult", "Odometry", "OdometryResult", "TrackingState"]
log = logging.getLogger(__name__)

_CONFIRMING = 2
"""Times the points that find a lost camera confirm that it was found."""
_WAITING = 6
"""Times as many frames are searched where the camera stood when it was lost, or something nearer hides what it saw: a
new track would follow that."""


class Odometry:
    """Visual odometry of one camera rig: stereo, RGB-D or one camera (thesis sections 2.1.3 and 3.3).

    Pass frames to :meth:`process` in order of time, then call :meth:`finish`. The same frames give the same result, bit
    by bit. ``stopwatch`` holds processor and wall time by stage. ``rig`` is rectified; ``vocabulary`` gives the words
    of ORB descriptors. :class:`FrontendError` for a stereo rig without a baseline above 0 m.
    """

    def __init__(self, rig: Rig, config: OdometryConfig, vocabulary: WordLookup) -> None:
        if rig.kind is RigKind.STEREO and not (rig.baseline_m and rig.baseline_m > 0):
            raise FrontendError(f"a stereo rig needs a baseline above 0 m, got {rig.baseline_m}")
        self.rig, self.config, self.vocabulary = rig, config, vocabulary
        self._enlargement = Enlargement.of(rig.camera)
        self.ranging = Ranging(self._enlargement.rig(rig), config.stereo, config.flow)
        self.stopwatch = Stopwatch()
        self._starter = make_starter(self.ranging, config, self.stopwatch)
        self._segment: Segment | None = None
        self._relocaliser: Relocaliser | None = None
        self._finished: list[Segment] = []
        self._forgotten: list[Segment] = []
        self._moments = MomentLog()
        self._lost_frames = 0
        self._relocalised = 0
        self._unconfirmed = False
        self._shadow: Shadow | None = None
        self._former: Relocaliser | None = None
        self._withdrawn = 0
        self._carried = self._sudden = False

    def process(self, frame: Frame) -> FrameResult:
        """Return the pose of ``frame``, or the reason why there is none.

        The content of an image never raises; :class:`FrontendError` where its size is not the camera's.
        """
        problem = self._unfit(frame)
        if problem:
            return FrameResult(frame.stamp_ns, None, self._state(), False, problem)
        frame = self._enlargement.frame(frame)
        segment = self._segment
        if segment is None:
            return self._start(frame)
        # Follow the points into this frame; the pose that explains them best.
        with self.stopwatch.stage(TimedStage.TRACK):
            tracked = segment.track(frame)
        found_again = tracked.T_C_W is None
        if found_again:
            # Lost: look for the map in this frame by its words.
            segment, tracked = self._search(frame, segment, tracked.refusal)
        if tracked.T_C_W is None:
            return self._lost(frame, tracked.refusal)
        self._lost_frames = 0
        segment.record(frame, tracked.T_C_W)
        doubt = self._doubt(tracked, found_again)
        if segment.light.out and not doubt.kind:
            doubt = doubt_dark(frame.image)
        # A view that brings something new stays, and the map around it is refined.
        since = segment.since_keyframe(frame, self.ranging.rig)
        wanted = wants_keyframe(since, self.config.keyframes, self.rig.metric)
        sound = tracked.doubt.kind != CARRIED and segment.adds_views(since)
        allowed = sound and segment.light.allows_keyframe(tracked.inliers, self.config.pose)
        is_keyframe = found_again or (wanted and allowed)
        if is_keyframe:
            frame.prepare()
            segment.insert_keyframe(frame)
        T_W_C = se3_inverse(segment.tracker.T_C_W)
        stays = is_keyframe and segment.latest is not None and segment.latest.stays
        result = FrameResult(
            frame.stamp_ns,
            T_W_C,
            TrackingState.TRACKING,
            is_keyframe,
            problem=frame.problem,
            stays=stays,
            doubt=doubt.text,
        )
        self._moments.note(frame.stamp_ns, NO_REASON, doubt)
        return result

    @property
    def segments(self) -> list[Segment]:
        """The finished tracks and the current one, read-only."""
        return [*self._finished, *([self._segment] if self._segment else [])]

    @property
    def maps(self) -> list[Map]:
        """Their maps, read-only."""
        return [segment.map for segment in self.segments]

    def finish(self) -> OdometryResult:
        """Return the tracks after the last frame, with bundle-adjusted poses and points.

        A track with fewer key-frames than ``min_track_keyframes`` is left out.
        """
        segments, given_px = self.segments, self._enlargement.given_px
        for segment in segments:
            segment.close()
        kept = [s for s in segments if len(s.map.keyframes) >= self.config.min_track_keyframes]
        trajectories = [s.trajectory() for s in kept]
        with self.stopwatch.stage(TimedStage.EXPORT):
            written = [export_track(s, self.vocabulary) for s in kept]
        return OdometryResult(
            tracks=[track for track, _ in written],
            views=[
                PointViews(views.observations, given_px(self.ranging.ideal(views.uv.astype(np.float64))))
                for _, views in written
            ],
            keyframe_indices=[s.keyframe_indices() for s in kept],
            trajectories=trajectories,
            lost=self._moments.lost([t.stamps_ns for t in trajectories], self._too_short),
            doubtful=self._moments.doubtful(
                [t.stamps_ns for t in trajectories], [jump for segment in kept for jump in segment.jumps()]
            ),
            stats=self._stats(segments, kept),
        )

    def _doubt(self, tracked: TrackedFrame, found_again: bool) -> Reason:
        """Why the pose may be wrong: by its points, or because the camera was found again by few and nothing has
        confirmed it since."""
        need = _CONFIRMING * self.config.lost.min_matches
        self._unconfirmed = (found_again or self._unconfirmed) and tracked.inliers < need
        if not tracked.doubt.kind and self._shadow is not None and self._segment is not None:
            return self._shadow.doubt(self._segment)
        if tracked.doubt.kind or not self._unconfirmed:
            return tracked.doubt
        text = f"found again by few points: {tracked.inliers} agree, {need} would confirm it"
        return Reason("found again by few points", text, need / max(tracked.inliers, 1))

    def _start(self, frame: Frame) -> FrameResult:
        """The first map: from one view with depth, from two or more without."""
        started = self._offered(frame)
        if isinstance(started, Reason):
            return self._refused(frame, TrackingState.STARTING, started)
        return started

    def _offered(self, frame: Frame) -> FrameResult | Reason:
        """Offer the frame to a new map; where that begins, the one before, if any, is finished."""
        frame.prepare()
        with self.stopwatch.stage(TimedStage.START):
            start = self._starter.offer(frame)
        if start.segment is None:
            return start.refusal
        if self._segment is not None:
            assert self._relocaliser is not None
            shadow = Shadow.over(self._segment, start.segment, self._carried or self._sudden)
            waits = NO_REASON if shadow is None or self._waited(_WAITING) else shadow.refusal(start.segment)
            if waits.kind:
                return waits
            self._finished.append(self._segment)
            self._shadow = shadow
        self._segment, self._lost_frames = start.segment, 0
        log.info("track %d starts at frame %d", len(self._finished), frame.index)
        T_W_C = se3_inverse(start.segment.tracker.T_C_W)
        why = NO_REASON if self._shadow is None else self._shadow.doubt(start.segment)
        self._moments.note(frame.stamp_ns, NO_REASON, why)
        state = TrackingState.TRACKING
        return FrameResult(frame.stamp_ns, T_W_C, state, True, stays=True, first=start.first, doubt=why.text)

    def _refused(self, frame: Frame, state: TrackingState, refusal: Reason) -> FrameResult:
        refusal = refusal if refusal.kind in WITHOUT_SECOND else unless_dark(refusal, frame.image)
        self._moments.note(frame.stamp_ns, refusal)
        return FrameResult(frame.stamp_ns, None, state, False, refusal.text, frame.problem, kind=refusal.kind)

    def _search(self, frame: Frame, segment: Segment, refusal: Reason) -> tuple[Segment, TrackedFrame]:
        """Look for the frame in the map just lost, or, if that is too young to become a track, in the one before."""
        if not self._lost_frames:
            image = f" ({PurePath(frame.name).name})" if frame.name else ""
            log.warning("tracking lost at frame %d%s: %s", frame.index, image, unless_dark(refusal, frame.image).text)
            self._starter = make_starter(self.ranging, self.config, self.stopwatch)
            if self._finished and not segment.lasting(self.config.min_track_keyframes):
                self._forgotten.append(segment)
                self._segment, self._shadow = self._finished.pop(), None
                segment = self._segment
            if self._relocaliser is None or self._relocaliser.segment is not segment:
                self._relocaliser = Relocaliser(segment, self.ranging, self.config, self.vocabulary)
            self._relocaliser.searches = 0
            self._carried, self._sudden = refusal.kind == CARRIED, segment.slow
        assert self._relocaliser is not None
        with self.stopwatch.stage(TimedStage.RELOCALISE):
            found = self._relocaliser.search(frame)
            if found.T_C_W is None and self._shadow is not None and self._shadow.doubt(segment).kind:
                segment, found = self._search_former(frame, segment, found)
        if found.T_C_W is not None:
            self._relocalised += 1
            log.info("found again at frame %d by %d points of the map", frame.index, found.inliers)
        return segment, found

    def _search_former(self, frame: Frame, segment: Segment, found: TrackedFrame) -> tuple[Segment, TrackedFrame]:
        """Where a track that began with what hid the view is lost, look in the one before too: if that shows the frame,
        the camera never left it, and the track is withdrawn."""
        if self._former is None or self._former.segment is not self._finished[-1]:
            self._former = Relocaliser(self._finished[-1], self.ranging, self.config, self.vocabulary)
        again = self._former.search(frame)
        if again.T_C_W is None:
            return segment, found
        self._forgotten.append(segment)
        self._segment, self._relocaliser, self._shadow = self._finished.pop(), self._former, None
        self._withdrawn += 1
        return self._segment, again

    def _waited(self, times: int) -> bool:
        assert self._relocaliser is not None
        return self._relocaliser.searches > times * self.config.lost.relocalise_frames

    def _lost(self, frame: Frame, refusal: Reason) -> FrameResult:
        """Search the map in some frames; from then on a new track may start where the images allow one. The search goes
        on until a track starts: after a black-out of any length the camera may be where it was."""
        assert self._relocaliser is not None
        self._lost_frames += 1
        stood = self._relocaliser.segment.tracker.standing.rested
        if self._waited(_WAITING if stood or self._carried else 1):
            started = self._offered(frame)
            if isinstance(started, FrameResult):
                return started
            kind = f"{refusal.kind}, and no new track yet: {started.kind}"
            refusal = Reason(kind, f"{refusal.text}, and no new track yet: {started.text}", started.reached)
        return self._refused(frame, TrackingState.LOST, refusal)

    def _state(self) -> TrackingState:
        if self._segment is None:
            return TrackingState.STARTING
        return TrackingState.LOST if self._lost_frames else TrackingState.TRACKING

    def _unfit(self, frame: Frame) -> str:
        """Reason why a frame cannot be used at all; empty if it can."""
        camera = self.rig.camera
        frame.check_size(frame.image, "image", (camera.width, camera.height))
        latest_ns = self._moments.latest_ns
        if latest_ns is not None and frame.stamp_ns <= latest_ns:
            behind_ms = (latest_ns - frame.stamp_ns) / 1e6
            return f"time stamp is not after the previous frame's ({behind_ms:.3f} ms before it)"
        return ""

    def _too_short(self) -> Reason:
        if self._withdrawn:
            return Reason(CARRIED, f"{CARRIED}: the track that followed it is withdrawn")
        need = self.config.min_track_keyframes
        short = [one for one in [*self._forgotten, *self.segments] if len(one.map.keyframes) < need]
        stood = bool(short) and all(one.tracker.standing.rested for one in short)
        kind = STANDS_SHORT if stood else "the track is too short"
        return Reason(kind, f"{kind}: fewer key-frames than the {need} that it needs to be written")

    def _stats(self, segments: list[Segment], kept: list[Segment]) -> dict[str, float]:
        return {
            "frames": float(len(self._moments)),
            "tracked": float(sum(len(s.frames) for s in kept)),
            "tracks": float(len(kept)),
            "relocalised": float(self._relocalised),
            "short_tracks": float(len(segments) + len(self._forgotten) - len(kept)),
            "keyframes": float(sum(len(s.map.keyframes) for s in kept)),
            "keyframes_culled": float(sum(len(s.map.culled) for s in kept)),
            "points": float(sum(int(s.map.alive.sum()) for s in kept)),
            **self._enlargement.given_stats(self.ranging.calibration_stats()),
        }
