"""The images of a topic in order of time, and those of two topics that belong together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ...errors import FrontendError
from ..base import Problems
from ..pairing import pair_by_time
from .bag import Bag, Messages
from .bag_image import COMPRESSED_IMAGE, BagImage, ImageTopic
from .message_file import Topic
from .video_packets import VIDEO_TYPES, codec_of
from .video_topic import VideoFrame, VideoTopic

_HALF = 0.5  # of the interval between images: what is nearer in time is of the same moment
_APART = 0.1  # of the interval: a pair that is farther apart is no pair for a camera that moves
_BITS = (8, 10, 12, 14, 16)
StampedImage = BagImage | VideoFrame
"""An image of a topic, with its time."""


def images_of_topic(bag: Bag, topic: Topic, depth: bool, problems: Problems) -> list[StampedImage]:
    """The images of a topic in order of time, one for each time."""
    messages = bag.messages(topic)
    where = f"{bag.path}: {topic.name}"
    if messages.received:
        problems.warning(f"{where}: headers without time stamps: the times of reception are taken")
    if messages.moved:
        problems.warning(f"{where}: {messages.moved} times go back in the order of reception: sorted by time stamp")
    kept = np.flatnonzero(np.r_[True, np.diff(messages.stamps_ns) > 0])
    if len(kept) < len(messages.stamps_ns):
        count = len(messages.stamps_ns) - len(kept)
        problems.warning(f"{where}: {count} messages have the time stamp of another; these are left out")
    if topic.type in VIDEO_TYPES or (topic.type == COMPRESSED_IMAGE and _is_video(bag, messages, topic)):
        return _pictures(bag, topic, kept, where, problems)
    images = _all(messages, kept, ImageTopic(topic.name, topic.type))
    white = None if depth else _white(images, where, problems)
    return [*(images if white is None else _all(messages, kept, ImageTopic(topic.name, topic.type, white)))]


def _is_video(bag: Bag, messages: Messages, topic: Topic) -> bool:
    """Whether messages of compressed images hold video, as some drivers send it."""
    return codec_of(str(bag.read(messages, 0, topic).format)) is not None


def _pictures(bag: Bag, topic: Topic, kept: NDArray[np.int64], where: str, problems: Problems) -> list[StampedImage]:
    """Those of a video, from its first key picture on."""
    video = VideoTopic(bag, topic)
    first = int(video.keys[0])
    if first:
        problems.warning(f"{where}: {first} pictures before the first key picture cannot be decoded: left out")
    return [VideoFrame(video, k) for k in kept.tolist() if k >= first]


def _all(messages: Messages, kept: NDArray[np.int64], topic: ImageTopic) -> list[BagImage]:
    return [BagImage(messages.files[i], messages.places[i], topic, int(messages.stamps_ns[i])) for i in kept.tolist()]


def _white(images: list[BagImage], where: str, problems: Problems) -> float | None:
    """The largest value of the bits that 16-bit images use, by some of them; None for images of 8 bits."""
    most = 0.0
    for image in images[:: max(1, len(images) // 3)][:3]:
        try:
            pixels = image.pixels()
        except FrontendError:  # said when its turn comes
            continue
        if pixels.dtype == np.float32:
            raise FrontendError(f"{where}: 32-bit floats are depth, no images; --recording.depth-topic names depth")
        if pixels.dtype == np.uint8:
            return None
        most = max(most, float(pixels.max()))
    white = next(2.0**bits - 1.0 for bits in _BITS if most < 2.0**bits)
    problems.warning(f"{where}: images of 16 bits, values up to {most:.0f}: 0 to {white:.0f} become 0 to 255")
    return white


def partners(
    left: Sequence[StampedImage], others: Sequence[StampedImage], topic: Topic, problems: Problems
) -> tuple[NDArray[np.int64], tuple[StampedImage, ...]]:
    """Frames that have an image of the second topic of the same moment, and these images."""
    stamps, second = (np.array([image.stamp_ns for image in images], dtype=np.int64) for images in (left, others))
    interval = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    pairs = pair_by_time(stamps, second, int(_HALF * interval))
    kept, partners = pairs.kept, pairs.second
    where = f"{others[0].file if others else left[0].file}: {topic.name}"
    if not len(kept):
        raise FrontendError(
            f"{where}: no image within {_HALF * interval / 1e6:.0f} ms of one of {left[0].topic_name}: "
            "on another clock?"
        )
    if len(kept) < len(left) or len(kept) < len(others):
        problems.warning(
            f"{where}: no partner for {len(left) - len(kept)} of {len(left)} frames and "
            f"{len(others) - len(kept)} of its {len(others)} images; these are left out"
        )
    apart = np.abs(second[partners] - stamps[kept])
    if np.median(apart) > _APART * interval:
        problems.warning(
            f"{where}: not synchronised: {np.median(apart) / 1e6:.1f} ms (median) from the image it belongs to: "
            "a camera that moves sees another place then"
        )
    return kept, tuple(others[i] for i in partners.tolist())
