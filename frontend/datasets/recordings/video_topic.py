"""Compressed video in a bag: its pictures decoded on demand, from the key picture before."""

from __future__ import annotations

import io
import os
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import FrontendError
from ..stored_image import StoredImage
from .bag import Bag
from .bag_image import deserialised
from .message_file import Topic, unreadable
from .video_packets import HEAD_BYTES, Packet, codec_of, packet_of

_KEPT = 8  # pictures decoded last: a key-frame's colours are asked for while reading is some frames ahead


class VideoTopic:
    """The pictures of one topic, each of them one message. One process has one decoder, opened when a picture is first
    asked for; threads take turns."""

    def __init__(self, bag: Bag, topic: Topic) -> None:
        """:class:`FrontendError` that names the topic and a cure for a codec that is not read, and for pictures that
        are not stored in the order in which they were taken."""
        self.messages, self.topic = bag.messages(topic), topic
        where = f"{bag.path}: {topic.name}"
        first = bag.read(self.messages, 0, topic)
        named = str(getattr(first, "format", getattr(first, "encoding", "")))
        self.codec = codec_of(named)
        if self.codec is None:
            raise FrontendError(
                f"{where}: video coded as {named!r}, which is not read (h264, h265): republish it as images "
                "(`ros2 run image_transport republish`) and record these, or make a film of it"
            )
        if self.messages.moved:
            raise FrontendError(
                f"{where}: {self.messages.moved} of its times go back: video whose pictures are stored in another "
                "order than they were taken (B frames) is not read: record it without (`tune: zerolatency`)"
            )
        packets = [self._packet(i, bag) for i in range(len(self.messages.places))]
        self.keys = np.flatnonzero([packet.key for packet in packets])
        self.parameters = next((packet.parameters for packet in packets if packet.parameters), b"")
        if not len(self.keys):
            raise FrontendError(f"{where}: no key picture, from which decoding can begin, in {len(packets)} messages")
        self._forget()

    def _packet(self, i: int, bag: Bag) -> Packet:
        file = self.messages.files[i]
        head = file.read(self.messages.places[i], HEAD_BYTES)
        with unreadable(file.path, f"a message of {self.topic.name} is damaged"):
            return packet_of(head, self.topic.type, file.ros1, str(self.codec))

    def _forget(self) -> None:
        self._lock, self._process = Lock(), os.getpid()
        self._capture: cv2.VideoCapture | None = None
        self._next, self._key = 0, -1
        self._decoded: OrderedDict[int, NDArray[np.uint8]] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {name: self.__dict__[name] for name in ("messages", "topic", "codec", "keys", "parameters")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._forget()

    def read(self, k: int) -> NDArray[np.uint8]:
        """Picture ``k``, ``(H, W, 3)`` uint8 BGR. :class:`FrontendError` where it cannot be decoded."""
        if self._process != os.getpid():  # threads and a decoder do not survive a fork
            self._forget()
        with self._lock:
            if k not in self._decoded:
                self._decoded[k] = self._decode(k)
                while len(self._decoded) > _KEPT:
                    self._decoded.popitem(last=False)
            return self._decoded[k]

    def _decode(self, k: int) -> NDArray[np.uint8]:
        key = int(self.keys[self.keys <= k][-1])
        if self._capture is None or self._key != key or self._next > k:
            self._capture, self._key, self._next = self._opened(key), key, key
        image = None
        while self._next <= k:
            there, image = self._capture.read() if self._next == k else (self._capture.grab(), None)
            if not there:
                self._capture = None
                raise FrontendError(f"{self._where(k)}: {self._next - key} pictures from the key picture on, then none")
            self._next += 1
        if image is None or image.ndim != 3:
            raise FrontendError(f"{self._where(k)}: cannot be decoded")
        return image.astype(np.uint8, copy=False)

    def _opened(self, key: int) -> cv2.VideoCapture:
        """A decoder of the pictures from ``key`` to the next one."""
        later = self.keys[self.keys > key]
        end = int(later[0]) if len(later) else len(self.messages.places)
        data = b"".join([self.parameters, *(self._data(i) for i in range(key, end))])
        os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
        level = cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
        try:
            capture = cv2.VideoCapture(io.BytesIO(data), cv2.CAP_FFMPEG, [])  # type: ignore[call-overload]
        except cv2.error as error:
            raise FrontendError(f"{self._where(key)}: cannot be decoded: {error.err}") from error
        finally:
            cv2.utils.logging.setLogLevel(level)
        if not capture.isOpened():
            raise FrontendError(f"{self._where(key)}: cannot be decoded as {self.codec}")
        return capture

    def _data(self, i: int) -> bytes:
        file = self.messages.files[i]
        data = file.read(self.messages.places[i])
        with unreadable(file.path, f"a message of {self.topic.name} is damaged"):
            return bytes(deserialised(data, self.topic.type, file.ros1).data)

    def _where(self, k: int) -> str:
        return f"{self.messages.files[k].path}: {self.topic.name} at {self.messages.stamps_ns[k]} ns"


@dataclass(frozen=True)
class VideoFrame(StoredImage):
    """Picture ``k`` of a video topic."""

    video: VideoTopic
    k: int

    @property
    def topic_name(self) -> str:
        """Name of its topic."""
        return self.video.topic.name

    @property
    def stamp_ns(self) -> int:
        """Its time."""
        return int(self.video.messages.stamps_ns[self.k])

    def __str__(self) -> str:
        return f"{self.file}: {self.video.topic.name} at {self.stamp_ns} ns"

    @property
    def file(self) -> Path:
        """See :attr:`StoredImage.file`."""
        return self.video.messages.files[self.k].path

    @property
    def name(self) -> str:
        """See :attr:`StoredImage.name`: ``run.mcap/alice/camera/video/1700000000000000000``."""
        return f"{self.file.name}/{self.video.topic.name.strip('/')}/{self.stamp_ns}"

    def read_grey(self) -> NDArray[np.uint8]:
        """See :meth:`StoredImage.read_grey`."""
        return cv2.cvtColor(self.video.read(self.k), cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)

    def read_colour(self) -> NDArray[np.uint8]:
        """See :meth:`StoredImage.read_colour`."""
        return self.video.read(self.k)

    def read_depth(self, unit_m: float) -> NDArray[np.float32]:
        """Video holds no depth: :class:`FrontendError`."""
        raise FrontendError(f"{self}: video has 8 bits a channel: no depth can be read from it")
