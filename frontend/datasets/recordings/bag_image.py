"""An image that is a message of a bag."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...files.timestamps import NS_PER_S
from ..images import decode
from ..stored_image import StoredImage
from .message_file import MessageFile, Place, unreadable
from .pixel_formats import compressed_depth, depth_metres, raw_pixels
from .video_packets import COMPRESSED_VIDEO, VIDEO_DEFINITIONS

IMAGE, COMPRESSED_IMAGE = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_STAMP_BYTES = 12  # before them a number or the encoding's head, then seconds and nanoseconds
_WHOLE = 255.0


@dataclass(frozen=True)
class ImageTopic:
    """Topic ``name`` of type ``type``. ``white``: the value of 16-bit pixels that becomes 255."""

    name: str
    type: str
    white: float = 65535.0


@dataclass(frozen=True, slots=True)
class BagImage(StoredImage):
    """One message of an image topic, of ``stamp_ns``."""

    messages: MessageFile
    place: Place
    topic: ImageTopic
    stamp_ns: int

    def __str__(self) -> str:
        return f"{self.messages.path}: {self.topic.name} at {self.stamp_ns} ns"

    @property
    def topic_name(self) -> str:
        """Name of its topic."""
        return self.topic.name

    @property
    def file(self) -> Path:
        """See :attr:`StoredImage.file`."""
        return self.messages.path

    @property
    def name(self) -> str:
        """See :attr:`StoredImage.name`: ``run.bag/alice/camera/image_raw/1700000000000000000``."""
        return f"{self.messages.path.name}/{self.topic.name.strip('/')}/{self.stamp_ns}"

    def pixels(self, flags: int = cv2.IMREAD_UNCHANGED) -> NDArray[Any]:
        """As stored: ``(H, W)`` or ``(H, W, 3)`` BGR, uint8, uint16 or float32; ``flags`` of a compressed image's
        decoding. :class:`FrontendError` where it cannot be read."""
        data = self.messages.read(self.place)
        with unreadable(self.messages.path, f"the message at {self.stamp_ns} ns is damaged"):
            message = deserialised(data, self.topic.type, self.messages.ros1)
        if self.topic.type == IMAGE:
            return raw_pixels(message, self)
        if "compresseddepth" in str(message.format).lower():
            return compressed_depth(message, self)
        return decode(bytes(message.data), self, flags)

    def read_grey(self) -> NDArray[np.uint8]:
        """See :meth:`StoredImage.read_grey`."""
        pixels = self._levels(self.pixels(cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH))
        return pixels if pixels.ndim == 2 else cv2.cvtColor(pixels, cv2.COLOR_BGR2GRAY).astype(np.uint8, copy=False)

    def read_colour(self) -> NDArray[np.uint8]:
        """See :meth:`StoredImage.read_colour`."""
        pixels = self._levels(self.pixels(cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH))
        return pixels if pixels.ndim == 3 else cv2.cvtColor(pixels, cv2.COLOR_GRAY2BGR).astype(np.uint8, copy=False)

    def read_depth(self, unit_m: float) -> NDArray[np.float32]:
        """See :meth:`StoredImage.read_depth`."""
        return depth_metres(self.pixels(), unit_m, self)

    def read_numbers(self) -> NDArray[Any]:
        """See :meth:`StoredImage.read_numbers`."""
        return self.pixels()

    def _levels(self, pixels: NDArray[Any]) -> NDArray[np.uint8]:
        if pixels.dtype == np.uint8:
            return pixels
        return np.clip(pixels * (_WHOLE / self.topic.white), 0.0, _WHOLE).astype(np.uint8)


def stamp_ns(beginning: bytes, ros1: bool, kind: str) -> int:
    """Time in the header with which a message of type ``kind`` begins; 0 where none was set."""
    at = 0 if ros1 and kind == COMPRESSED_VIDEO else 4  # before it ROS 1 counts headers, CDR names its encoding
    if len(beginning) < _STAMP_BYTES:
        raise ValueError(f"a message of {len(beginning)} bytes has no header")
    seconds, nanoseconds = struct.unpack_from("<II" if ros1 else "<iI" if beginning[1] & 1 else ">iI", beginning, at)
    return int(seconds) * NS_PER_S + int(nanoseconds)


def deserialised(data: bytes, kind: str, ros1: bool) -> Any:
    """The message, by the definition of its type that ROS ships: what a bag itself says of types is not used."""
    store = _typestore(ros1)
    return store.deserialize_ros1(data, kind) if ros1 else store.deserialize_cdr(data, kind)


_TRANSFORMS = "geometry_msgs/TransformStamped[] transforms"
_MORE_TYPES = {**VIDEO_DEFINITIONS, "tf2_msgs/msg/TFMessage": _TRANSFORMS, "tf/msg/tfMessage": _TRANSFORMS}
"""Definitions that ROS's own set lacks, as their packages publish them."""


@lru_cache(maxsize=2)
def _typestore(ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name, definition in _MORE_TYPES.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(definition, name))
    return store
