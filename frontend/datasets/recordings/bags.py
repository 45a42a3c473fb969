"""Bags as a data set: ROS 1 and ROS 2, each robot in them a sequence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from ...cameras.models import RigKind
from ...errors import FrontendError
from ...recording_config import RecordingConfig
from ..assemble import FoundSequence, assemble, available_rigs
from ..base import ImageSequence, Problems, Reader, choose_rig
from ..images import list_images
from ..truth import Truth
from .bag import BAG_SUFFIXES, Bag, bags_in
from .bag_cameras import camera_of_robot, depth_use, folders_beside
from .bag_poses import read_bag_poses
from .bag_positions import read_fixes
from .beside import truth_beside
from .recorded import RecordedBag, recordings
from .robot_topics import RobotTopics
from .topic_images import StampedImage, images_of_topic, partners

_FEW_IMAGES = 3  # beside a bag, fewer are no sequence
_MILLIMETRE = 0.001


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
    left = images_of_topic(bag, topics.left, False, problems)
    raw, source = camera_of_robot(bag, topics, name, problems)
    right: tuple[StampedImage, ...] = ()
    depth: tuple[StampedImage, ...] = ()
    kept = np.arange(len(left))
    if topics.right is not None and rig in (None, RigKind.STEREO):
        if raw.right is None:
            problems.warning(
                f"{source}: right images on {topics.right.name}, but no baseline of a pair (P of the right "
                "camera_info, tf between the two frames, or a camera file beside the bag): read as one camera"
            )
        else:
            kept, right = partners(left, images_of_topic(bag, topics.right, False, problems), topics.right, problems)
    elif raw.right is not None and topics.right is None and rig is None:
        problems.warning(f"{source}: a calibrated pair, but {bag.path} has no right images: read as mono")
    sensor = None
    if topics.depth is not None and not right and rig in (None, RigKind.RGBD):
        use = depth_use(bag, topics, problems)
        if use.used:
            sensor = use.sensor
            kept, depth = partners(left, images_of_topic(bag, topics.depth, True, problems), topics.depth, problems)
    stamps = np.array([image.stamp_ns for image in left], dtype=np.int64)[kept]
    truth = _truth(bag, topics, name, alone, problems)
    found_beside = (f"ground truth: {truth.source}",) if truth is not None and topics.truth is None else ()
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
        truth=truth,
        name=name,
        origin=_described(topics, bool(right), bool(depth)) + ("; depth moved to the image by tf" if sensor else ""),
    )
    sequence = assemble(found, choose_rig(available_rigs(bool(right), bool(depth)), rig, bag.path), problems)
    fixes, said = (None, []) if topics.gps is None else read_fixes(bag, topics.gps)
    return replace(sequence, positions=fixes, notes=(*sequence.notes, *recorded.notes, *found_beside, *said))


def _truth(bag: Bag, topics: RobotTopics, name: str, alone: bool, problems: Problems) -> Truth | None:
    if topics.truth is not None:
        trajectory, notes = read_bag_poses(bag, topics.truth)
        for note in notes:
            problems.warning(f"{bag.path}: {note}")
        return Truth(trajectory, bag.path / topics.truth.name.strip("/"))
    return truth_beside(folders_beside(bag), name, alone, problems)


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
    truth += [f"positions: {topics.gps.name} ({topics.gps.count})"] if topics.gps is not None else []
    others = [f"{topic.name} ({topic.type.rpartition('/')[2]}, {topic.count})" for topic in topics.unread]
    unread = [f"not read: {', '.join(others)}"] if others else []
    return "; ".join([*parts, *camera, *truth, *unread])
