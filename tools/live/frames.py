"""Frames on their way from a camera to odometry: the newest counts, an older one that waits is dropped."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from threading import Condition

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.frames import PutOff


@dataclass(frozen=True, eq=False)
class CameraFrame:
    """One moment of a rectified camera. ``image`` ``(H, W)`` grey or ``(H, W, 3)`` BGR, uint8; ``right`` likewise
    (stereo) or ``depth_m`` ``(H, W)`` float32 metres, 0 = unknown (RGB-D), or put off until a key-frame needs it;
    ``time_ns``: of the image, ascending.
    ``colour``: gives the image in BGR where ``image`` is grey and a colour network needs it."""

    image: NDArray[np.uint8]
    time_ns: int
    right: NDArray[np.uint8] | PutOff[NDArray[np.uint8]] | None = None
    depth_m: NDArray[np.float32] | PutOff[NDArray[np.float32]] | None = None
    name: str = ""
    colour: Callable[[], NDArray[np.uint8]] | None = None


@dataclass(frozen=True, eq=False)
class NumberedFrame:
    """``index``: of all frames that came, also those dropped; ``came_s``: when it came, on the monotonic clock."""

    index: int
    frame: CameraFrame
    came_s: float


class LatestFrames:
    """A queue of at most ``size`` frames, for two threads: a new one takes the place of the oldest."""

    def __init__(self, size: int = 1, clock: Callable[[], float] = time.monotonic) -> None:
        self.received = self.dropped = 0
        self._size, self._clock = size, clock
        self._frames: deque[NumberedFrame] = deque()
        self._changed = Condition()
        self._ended = False

    def put(self, frame: CameraFrame) -> bool:
        """A frame came; whether none was dropped for it. None is taken any more after :meth:`end`."""
        with self._changed:
            if self._ended:
                return True
            self._frames.append(NumberedFrame(self.received, frame, self._clock()))
            self.received += 1
            dropped = len(self._frames) > self._size
            if dropped:
                self._frames.popleft()
                self.dropped += 1
            self._changed.notify_all()
            return not dropped

    def end(self) -> None:
        """No more frames come; those that wait are still taken."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()

    def take(self, wait_s: float | None = None) -> NumberedFrame | None:
        """The oldest frame that waits, once there is one; None after ``wait_s``, seconds, and where all is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._frames or self._ended, wait_s)
            return self._frames.popleft() if self._frames else None

    @property
    def over(self) -> bool:
        """Whether no frame waits and none comes."""
        with self._changed:
            return self._ended and not self._frames
