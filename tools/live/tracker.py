"""Odometry in a thread of its own, beside negotiation: frames are taken as it is ready for them."""

from __future__ import annotations

import json
import logging
import time
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from threading import Lock
from typing import Any

import cv2
import numpy as np

from maslam.frontend.errors import FrontendError
from maslam.frontend.frames import Frame
from maslam.mas.live.observed import Observed
from maslam.mas.live.revisits import RevisitTimes
from maslam.mas.live.team_pose import LatestFrame
from maslam.mas.state.keyframe import KeyFrame

from .frames import CameraFrame, LatestFrames, NumberedFrame
from .front_end import LiveFrontEnd, TrackedLive

log = logging.getLogger(__name__)
_SAY_EACH_S = 5.0
_REMEMBERED = 10_000
"""Frames whose coming is known: those since the latest key-frame that was passed on."""


@dataclass
class LiveFigures:
    """Frames ``received``; ``tracked``: with a pose; ``lost``: without; ``dropped``: the next came before odometry was
    ready; ``unreadable``: that could not be used. ``lag_s``: from a frame's coming to its pose, mean and most;
    ``busy_s``: spent on frames. ``revisits``: from a key-frame's coming to its matches and the poses that hold them;
    ``cpu_s``: CPU time of the process by part."""

    received: int = 0
    tracked: int = 0
    lost: int = 0
    dropped: int = 0
    unreadable: int = 0
    keyframes: int = 0
    lag_mean_s: float = 0.0
    lag_most_s: float = 0.0
    busy_s: float = 0.0
    revisits: RevisitTimes = field(default_factory=RevisitTimes)
    cpu_s: dict[str, float] = field(default_factory=dict)

    def as_json(self) -> str:
        """One object, times to the microsecond."""
        return json.dumps(_rounded(asdict(self)), indent=1) + "\n"

    @classmethod
    def from_json(cls, text: str) -> LiveFigures:
        """What :meth:`as_json` wrote."""
        content = json.loads(text)
        return cls(**{**content, "revisits": RevisitTimes(**content["revisits"])})


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    rounded: dict[str, Any] = {}
    for name, value in values.items():
        rounded[name] = _rounded(value) if isinstance(value, dict) else value
        if isinstance(value, float):
            rounded[name] = round(value, 6)
    return rounded


class LiveTracker:
    """Takes ``frames``, and gives key-frames, each with the time at which its image came, to ``pass_on`` and each
    latest frame with a pose to ``placed``, None where it has none."""

    def __init__(
        self,
        front_end: LiveFrontEnd,
        frames: LatestFrames,
        pass_on: Callable[[Observed, float], None],
        placed: Callable[[LatestFrame | None], None],
    ) -> None:
        self.front_end, self.frames = front_end, frames
        self._pass_on, self._placed = pass_on, placed
        self._figures, self._lock = LiveFigures(), Lock()
        self._latest: KeyFrame | None = None
        self._came: deque[tuple[int, float]] = deque(maxlen=_REMEMBERED)
        self._said_s, self._said_dropped, self._said_received = -_SAY_EACH_S, 0, 0

    @property
    def figures(self) -> LiveFigures:
        """A copy, with what waits or was dropped by now."""
        with self._lock:
            now = replace(self._figures)
        now.received, now.dropped = self.frames.received, self.frames.dropped
        return now

    def run(self) -> None:
        """Until no more frames come; the last key-frames are passed on then."""
        while not self.frames.over:
            taken = self.frames.take(_SAY_EACH_S)
            if taken is not None:
                self.track(taken)
        self.finish()

    def track(self, taken: NumberedFrame) -> None:
        """One frame through the front end."""
        began_s = time.monotonic()
        self._came.append((taken.frame.time_ns, taken.came_s))
        try:
            tracked = self.front_end.process(_as_frame(taken), taken.frame.colour or _colour_of(taken.frame))
        except FrontendError as error:
            log.warning("frame %d: %s", taken.index, error)
            with self._lock:
                self._figures.unreadable += 1
            return
        self._give(taken, tracked)
        self._count(tracked, began_s, taken.came_s)
        self._say_dropped(began_s)

    def finish(self) -> None:
        """No more frames come."""
        observed, _ = self.front_end.finish()
        for one in observed:
            self._passed_on(one)

    def _give(self, taken: NumberedFrame, tracked: TrackedLive) -> None:
        for one in tracked.observed:
            self._passed_on(one)
        if tracked.T_K_C is None or self._latest is None:
            self._placed(None)
        else:
            self._placed(LatestFrame(taken.frame.time_ns, self._latest, tracked.T_K_C))

    def _passed_on(self, observed: Observed) -> None:
        self._latest = observed.keyframe
        with self._lock:
            self._figures.keyframes += 1
        while self._came[0][0] < observed.keyframe.stamp_ns:
            self._came.popleft()
        self._pass_on(observed, self._came[0][1])

    def _count(self, tracked: TrackedLive, began_s: float, came_s: float) -> None:
        now_s = time.monotonic()
        with self._lock:
            figures = self._figures
            figures.tracked += tracked.result.T_W_C is not None
            figures.lost += tracked.result.T_W_C is None
            done = figures.tracked + figures.lost
            figures.lag_mean_s += (now_s - came_s - figures.lag_mean_s) / done
            figures.lag_most_s = max(figures.lag_most_s, now_s - came_s)
            figures.busy_s += now_s - began_s

    def _say_dropped(self, now_s: float) -> None:
        """Say how many frames were dropped, every few seconds at most."""
        dropped, received = self.frames.dropped, self.frames.received
        if dropped == self._said_dropped or now_s - self._said_s < _SAY_EACH_S:
            return
        figures = self.figures
        each_ms = 1e3 * figures.busy_s / max(figures.tracked + figures.lost, 1)
        log.warning(
            "%d of the last %d frames dropped: a frame takes %.0f ms, and more come",
            dropped - self._said_dropped,
            received - self._said_received,
            each_ms,
        )
        self._said_s, self._said_dropped, self._said_received = now_s, dropped, received


def _as_frame(taken: NumberedFrame) -> Frame:
    """The frame as odometry takes it, grey."""
    given = taken.frame
    right = _grey(given.right) if isinstance(given.right, np.ndarray) else given.right
    return Frame(taken.index, given.time_ns, _grey(given.image), right, given.depth_m, given.name)


def _grey(image: np.ndarray) -> np.ndarray:
    return image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def _colour_of(frame: CameraFrame) -> Callable[[], np.ndarray] | None:
    return (lambda: frame.image) if frame.image.ndim == 3 else None
