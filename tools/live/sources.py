"""Where frames come from: a recording played at its rate, a folder that grows, a camera. Each runs in a thread of its
own, and gives its frames as they come."""

from __future__ import annotations

import logging
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam.frontend.cameras.calibration import RawRig
from maslam.frontend.cameras.models import Rig, RigKind
from maslam.frontend.cameras.rectification import rectify_rig
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.datasets.images import list_images
from maslam.frontend.datasets.named_times import times_of_names
from maslam.frontend.errors import FrontendError
from maslam.frontend.frames import PutOff

from ..common.errors import ToolError
from .frames import CameraFrame

log = logging.getLogger(__name__)
Put = Callable[[CameraFrame], object]
_POLL_S = 0.02
_DAMAGED_S = 2.0
"""An image that cannot be read for so long is no longer waited for."""


class FrameSource(ABC):
    """A camera: ``rig`` is rectified, as its frames are; ``name`` stands for the recording. ``after_ns``: only frames
    with later time stamps are given, of a recording that an earlier process has begun to play."""

    rig: Rig
    name: str
    after_ns: int | None = None

    @abstractmethod
    def run(self, put: Put, stop: Event) -> None:
        """Give each frame to ``put`` when it comes, until there are no more or ``stop`` is set."""


class PlayedRecording(FrameSource):
    """A sequence of images, a film or a bag, at its own rate times ``speed``."""

    def __init__(self, sequence: ImageSequence, speed: float = 1.0) -> None:
        self.rig, self.name = sequence.rig, sequence.name
        self._sequence, self._speed = sequence, speed

    def run(self, put: Put, stop: Event) -> None:
        """See :meth:`FrameSource.run`. A frame that cannot be read is left out, which is said."""
        stamps_ns = self._sequence.stamps_ns
        first = 0 if self.after_ns is None else int(np.searchsorted(stamps_ns, self.after_ns, side="right"))
        if first == len(stamps_ns):
            return
        began, first_ns = time.monotonic(), int(stamps_ns[first])
        for index in range(first, len(stamps_ns)):
            at = began + (int(self._sequence.stamps_ns[index]) - first_ns) / 1e9 / self._speed
            if stop.wait(max(at - time.monotonic(), 0.0)):
                return
            try:
                put(stored_frame(self._sequence, index))
            except FrontendError as error:
                log.warning("left out: %s", error)


def stored_frame(sequence: ImageSequence, index: int) -> CameraFrame:
    """Frame ``index``; its second image is decoded where a key-frame needs it. ``FrontendError`` as in
    :meth:`~maslam.frontend.datasets.base.ImageSequence.read`."""
    return CameraFrame(
        sequence.read_image(index),
        int(sequence.stamps_ns[index]),
        PutOff(partial(sequence.read_right, index)) if sequence.right else None,
        PutOff(partial(_depth, sequence, index)) if sequence.depth else None,
        str(sequence.left[index]),
        partial(sequence.read_colour, index),
    )


def _depth(sequence: ImageSequence, index: int) -> NDArray[np.float32]:
    depth = sequence.read(index).depth_m
    assert depth is not None
    return depth


class GrowingFolder(FrameSource):
    """A folder of images, with its calibration, that a camera's driver writes into: each image is taken once it and its
    partner of the same name are whole. Time stamps: in the names, else when the file was written.

    Of the images that are there already, the newest is taken. The folder is at its end after ``idle_s`` without a new
    image; None: never. ``ToolError`` where the folder holds no images of a known layout after ``wait_s``.
    """

    def __init__(
        self, folder: Path, rig: RigKind | None = None, idle_s: float | None = None, wait_s: float = 60.0
    ) -> None:
        self._sequence = _opened(folder, rig, wait_s)
        self.rig, self.name = self._sequence.rig, self._sequence.name
        self._idle_s = idle_s
        self._left = Path(str(self._sequence.left[0])).parent
        second = self._sequence.right or self._sequence.depth
        self._second = Path(str(second[0])).parent if second else None
        if self._second == self._left:
            raise ToolError(f"{folder}: left and right images of a folder that grows are in folders of their own")
        self._by_names = times_of_names([Path(str(p)).stem for p in self._sequence.left]) is not None
        self._seen: set[str] = set()
        self._damaged: dict[str, float] = {}

    def run(self, put: Put, stop: Event) -> None:
        """See :meth:`FrameSource.run`."""
        self._seen = {path.name for path, _ in self._pairs()[:-1]}
        came = time.monotonic()
        while not stop.is_set():
            for frame in self._new_frames():
                put(frame)
                came = time.monotonic()
            if self._idle_s is not None and time.monotonic() - came > self._idle_s:
                return
            stop.wait(_POLL_S)

    def _new_frames(self) -> Iterator[CameraFrame]:
        """The frames of images that have come and are whole, in order."""
        for left, second in self._pairs():
            if left.name in self._seen:
                continue
            frame = self._frame(left, second)
            if frame is None and not self._given_up(left):
                return  # those after it wait: frames are in order
            self._seen.add(left.name)
            if frame is not None:
                yield frame

    def _pairs(self) -> list[tuple[Path, Path | None]]:
        """The images with their partners, in order of their names; those whose partner is not there yet are left
        out."""
        found = list_images(self._left)
        if self._second is None:
            return [(path, None) for path in found]
        partners = {path.stem: path for path in list_images(self._second)}
        return [(path, partners[path.stem]) for path in found if path.stem in partners]

    def _frame(self, left: Path, second: Path | None) -> CameraFrame | None:
        """The frame of a pair of files, decoded at once: they may be gone soon. None where one is not whole yet."""
        others = () if second is None else (second,)
        one = replace(
            self._sequence,
            left=(left,),
            right=others if self._sequence.right else (),
            depth=others if self._sequence.depth else (),
            stamps_ns=np.array([self._stamp_ns(left)], dtype=np.int64),
            masks=None,
        )
        try:
            read = one.read(0)
            colour = one.read_colour(0)
        except (FrontendError, OSError) as error:
            if left.name not in self._damaged:
                self._damaged[left.name] = time.monotonic()
            elif self._given_up(left):
                log.warning("left out: %s", error)
            return None
        return CameraFrame(read.image, read.stamp_ns, read.right, read.depth_m, read.name, lambda: colour)

    def _given_up(self, left: Path) -> bool:
        return time.monotonic() - self._damaged.get(left.name, np.inf) > _DAMAGED_S

    def _stamp_ns(self, left: Path) -> int:
        if self._by_names:
            # Of one name alone it may be unclear what is a time: those of the first images say it.
            stems = [Path(str(p)).stem for p in self._sequence.left[:3]]
            named = times_of_names([*stems, left.stem] if left.stem not in stems else stems)
            if named is not None:
                return int(named.stamps_ns[stems.index(left.stem) if left.stem in stems else len(stems)])
        return left.stat().st_mtime_ns


def _opened(folder: Path, rig: RigKind | None, wait_s: float) -> ImageSequence:
    """The sequence of the folder as it is, as soon as it holds images that can be read."""
    until = time.monotonic() + wait_s
    while True:
        try:
            (sequence,) = open_dataset(folder, rig, strict=False).sequences
            return sequence
        except (FrontendError, ValueError, OSError) as error:
            if time.monotonic() >= until:
                raise ToolError(f"{folder}: no images came within {wait_s:.0f} s: {error}") from error
            time.sleep(10 * _POLL_S)


class OpenCvCamera(FrameSource):
    """A camera by OpenCV: its number, a device, or an address; ``raw`` is its calibration. A stereo camera whose image
    is its left and right one side by side is used as such where ``raw`` is of a pair. Time stamps: the machine's
    clock when the image came."""

    def __init__(self, device: int | str, raw: RawRig, capture: Any = None) -> None:
        self._capture = cv2.VideoCapture(device) if capture is None else capture
        self.name = f"camera {device}"
        if not self._capture.isOpened():
            raise ToolError(f"{self.name}: cannot be opened")
        width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        known = raw.left.size
        self._pair = raw.right is not None and known is not None and (width, height) == (2 * known[0], known[1])
        size = (width // 2, height) if self._pair else (width, height)
        if known is not None and known != size:
            found = f"{width}x{height}"
            raise ToolError(f"{self.name}: its images are {found} pixels, the calibration's {known[0]}x{known[1]}")
        kind = RigKind.STEREO if self._pair else RigKind.MONO
        ideal = rectify_rig(raw, kind, size)
        self.rig = Rig(kind, ideal.camera, ideal.baseline_m)
        self._rectifier = ideal.rectifier

    def run(self, put: Put, stop: Event) -> None:
        """See :meth:`FrameSource.run`."""
        try:
            while not stop.is_set():
                there, image = self._capture.read()
                if not there:
                    return
                put(self._frame(image, time.time_ns()))
        finally:
            self._capture.release()

    def _frame(self, image: NDArray[np.uint8], time_ns: int) -> CameraFrame:
        width = self.rig.camera.width
        left, right = (image[:, :width], image[:, width:]) if self._pair else (image, None)
        if self._rectifier is not None:
            left = self._rectifier.rectify_left(left)
            right = None if right is None else self._rectifier.rectify_right(right)
        return CameraFrame(left, time_ns, None if right is None else np.ascontiguousarray(right))
