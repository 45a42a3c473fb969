"""Bags as a data set: ROS 1 and ROS 2, each robot in them a sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...cameras.models import RigKind
from ...errors import FrontendError
from ...recording_config import RecordingConfig
from ..assemble import FoundSequence, assemble, available_rigs
from ..base import ImageSequence, Problems, Reader, choose_rig
from ..images import list_images
from ..pairing import pair_by_time
from ..truth import Truth
from .bag import BAG_SUFFIXES, Bag, Messages, bags_in
from .bag_cameras import camera_of_robot, depth_use
from .bag_image import BagImage, ImageTopic
from .bag_truth import read_truth
from .beside import truth_beside
from .message_file import Topic
from .recorded import RecordedBag, recordings
from .robot_topics import RobotTopics

_FEW_IMAGES = 3  # beside a bag, fewer are no sequence
_HALF = 0.5  # of the interval between images: what is nearer in time is of the same moment
_APART = 0.1  # of the interval: a pair that is farther apart is no pair for a camera that moves
_MILLIMETRE = 0.001
_BITS = (8, 10, 12, 14, 16)


class BagReader(Reader):
    """``.bag``, ``.mcap``, ``.db3``, the folder of a ROS 2 bag, or a folder with a bag for each robot.

    Images, raw or compressed, by topic; cameras from ``camera_info``, or from a camera file beside the bag
    (``<bag>.yaml``, ``<robot>.yaml``, which come first, ``camera.yaml``). Time stamps: of the messages' headers.
    """

    kind = "bag"
    suffixes = BAG_SUFFIXES

    def __init__(self, config: RecordingConfig | None = None) -> None:
        """``config``: topics that the user named."""
        self.config = config or RecordingConfig()

    def recognises(self, folder: Path) -> bool:
        """See :meth:`Reader.recognises`."""
        return bool(bags_in(folder)) and len(list_images(folder)) < _FEW_IMAGES

    def openers(self, path: Path, rig: RigKind | None) -> dict[str, Callable[[], ImageSequence]]:
        """See :meth:`Reader.openers`."""
        found: dict[str, Callable[[], ImageSequence]] = {}
        every = recordings(bags_in(path), self.config)
        for one in every:
            for robot, topics in one.robots.items():
                name = robot if robot and len(every) == 1 else "_".join(filter(None, (one.name, robot)))
                alone = len(one.robots) == len(every) == 1
                found[name] = partial(_open_robot, one, topics, name, rig, alone)
        return found

    def open(self, folder: Path, rig: RigKind | None) -> ImageSequence:
        """See :meth:`Reader.open`."""
        openers = self.openers(folder, rig)
        if len(openers) != 1:
            raise FrontendError(f"{folder}: {len(openers)} sequences ({', '.join(openers)}), one is expected here")
        return next(iter(openers.values()))()


def _open_robot(
    recorded: RecordedBag, topics: RobotTopics, name: str, rig: RigKind | None, alone: bool
) -> ImageSequence:
    """The sequence of one robot; ``alone``: in its bag, beside which all files are its own."""
    problems, bag = Problems(), recorded.bag
    for warning in (*topics.warnings, *recorded.warnings):
        problems.warning(warning)
    left = _images(bag, topics.left, False, problems)
    raw, source = camera_of_robot(bag, topics, name, problems)
    right: tuple[BagImage, ...] = ()
    depth: tuple[BagImage, ...] = ()
    kept = np.arange(len(left))
    if topics.right is not None and rig in (None, RigKind.STEREO):
        if raw.right is None:
            problems.warning(
                f"{source}: right images on {topics.right.name}, but no baseline of a pair (P of the right "
                "camera_info, tf between the two frames, or a camera file beside the bag): read as one camera"
            )
        else:
            kept, right = _second(left, _images(bag, topics.right, False, problems), topics.right, problems)
    elif raw.right is not None and topics.right is None and rig is None:
        problems.warning(f"{source}: a calibrated pair, but {bag.path} has no right images: read as mono")
    sensor = None
    if topics.depth is not None and not right and rig in (None, RigKind.RGBD):
        use = depth_use(bag, topics, problems)
        if use.used:
            sensor = use.sensor
            kept, depth = _second(left, _images(bag, topics.depth, True, problems), topics.depth, problems)
    stamps = np.array([image.stamp_ns for image in left], dtype=np.int64)[kept]
    found = FoundSequence(
        kind=BagReader.kind,
        folder=bag.path,
        raw=raw,
        calibration=source,
        images=tuple(left[i] for i in kept),
        stamps_ns=stamps,
        stamps_source=bag.path / topics.left.name.strip("/"),
        right=right,
        depth=depth,
        depth_unit_m=raw.depth_unit_m or _MILLIMETRE,
        depth_sensor=sensor,
        truth=_truth(bag, topics, name, alone),
        name=name,
        origin=_described(topics, bool(right), bool(depth)) + ("; depth moved to the image by tf" if sensor else ""),
    )
    sequence = assemble(found, choose_rig(available_rigs(bool(right), bool(depth)), rig, bag.path), problems)
    return replace(sequence, notes=(*sequence.notes, *recorded.notes))


def _images(bag: Bag, topic: Topic, depth: bool, problems: Problems) -> list[BagImage]:
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
    images = _all(messages, kept, ImageTopic(topic.name, topic.type))
    white = None if depth else _white(images, where, problems)
    return images if white is None else _all(messages, kept, ImageTopic(topic.name, topic.type, white))


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


def _second(
    left: list[BagImage], others: list[BagImage], topic: Topic, problems: Problems
) -> tuple[NDArray[np.int64], tuple[BagImage, ...]]:
    """Frames that have an image of the second topic of the same moment, and these images."""
    stamps, second = (np.array([image.stamp_ns for image in images], dtype=np.int64) for images in (left, others))
    interval = float(np.median(np.diff(stamps))) if len(stamps) > 1 else 0.0
    pairs = pair_by_time(stamps, second, int(_HALF * interval))
    kept, partners = pairs.kept, pairs.second
    where = f"{others[0].file if others else left[0].file}: {topic.name}"
    if not len(kept):
        raise FrontendError(
            f"{where}: no image within {_HALF * interval / 1e6:.0f} ms of one of {left[0].topic.name}: "
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


def _truth(bag: Bag, topics: RobotTopics, name: str, alone: bool) -> Truth | None:
    if topics.truth is not None:
        return Truth(read_truth(bag, topics.truth), bag.path / topics.truth.name.strip("/"))
    folder = bag.path if bag.path.is_dir() else bag.path.parent
    return truth_beside(folder, name, alone) or truth_beside(bag.path.parent, name, False)


def _described(topics: RobotTopics, right: bool, depth: bool) -> str:
    """The topics that are read, in a line for people."""
    shown = [
        ("", topics.left),
        ("right: ", topics.right if right else None),
        ("depth: ", topics.depth if depth else None),
    ]
    parts = [f"{what}{t.name} ({t.type.rpartition('/')[2]}, {t.count})" for what, t in shown if t is not None]
    camera = [f"camera: {topics.infos[0].name}"] if topics.infos[0] is not None else []
    truth = [f"truth: {topics.truth.name}"] if topics.truth is not None else []
    others = [f"{topic.name} ({topic.type.rpartition('/')[2]}, {topic.count})" for topic in topics.unread]
    unread = [f"not read: {', '.join(others)}"] if others else []
    return "; ".join([*parts, *camera, *truth, *unread])
