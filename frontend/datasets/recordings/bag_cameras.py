"""The cameras of a robot in a bag: by a file beside it, by camera_info, and how they stand by camera_info or tf."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...cameras.calibration import RawRig
from ...cameras.models import PinholeCamera
from ...errors import FrontendError
from ..assemble import DepthSensor
from ..base import Problems
from .bag import Bag
from .beside import camera_beside
from .camera_info import CameraInfo, one_camera, pair, pair_apart
from .message_file import Topic
from .robot_topics import RobotTopics
from .transforms import FixedTransforms, read_transforms, side_by_side

_AGREE = 0.05  # share by which two sources of a baseline may differ
_TURNED_DEG, _ASIDE = 0.5, 0.05  # of a pair called rectified: more is none


@dataclass(frozen=True)
class DepthUse:
    """Whether depth is read, and by which ``sensor``; None: it is of the images' own camera."""

    used: bool
    sensor: DepthSensor | None = None


def camera_of_robot(bag: Bag, topics: RobotTopics, name: str, problems: Problems) -> tuple[RawRig, Path]:
    """The calibration: a file named after the robot or the bag, else camera_info, else another file beside the bag."""
    folders = folders_beside(bag)
    own = camera_beside(folders, name, others=False)
    if own is not None:
        return own
    infos = [None if topic is None else _info(bag, topic, problems) for topic in topics.infos[:2]]
    left, right = infos
    if left is not None and (left.calibrated or (topics.rectified and left.P[0, 0] > 0)):
        rig = None if right is None else _pair(bag, topics, left, right, problems)
        if rig is None and topics.right is not None:
            beside = _pair_beside(folders, name)
            if beside is not None:
                return beside
        return rig or one_camera(left, topics.rectified), left.source
    beside = next(filter(None, (camera_beside([folder], name) for folder in folders[: 1 + bag.path.is_dir()])), None)
    if beside is not None:
        return beside
    if left is not None:
        left.camera(topics.rectified)  # says what is wrong with it
    raise FrontendError(
        f"{bag.path}: no camera_info topic beside {topics.left.name}, and no camera file: put {name}.yaml "
        "beside the bag (width, height, fx, fy, cx, cy), or name the topic by --recording.camera-topic"
    )


def _pair_beside(folders: list[Path], name: str) -> tuple[RawRig, Path] | None:
    """A file of a pair beside a bag whose camera_info does not say how its cameras stand."""
    try:
        found = camera_beside(folders, name)
    except FrontendError:
        return None
    return found if found is not None and found[0].right is not None else None


def folders_beside(bag: Bag) -> list[Path]:
    """Where files lie that belong to the bag: in its folder, and beside it."""
    return [bag.path, bag.path.parent] if bag.path.is_dir() else [bag.path.parent, bag.path.parent.parent]


def depth_use(bag: Bag, topics: RobotTopics, problems: Problems) -> DepthUse:
    """How depth lies on the images, as far as camera_info says: of their own camera, of one that tf places beside it,
    or else not read, which is said."""
    left, depth = topics.infos[0], topics.infos[2]
    if left is None or depth is None or topics.depth is None or left == depth:
        return DepthUse(True)
    image, measured = _info(bag, left, problems), _info(bag, depth, problems)
    if image.same_view(measured):
        return DepthUse(True)
    T_C_D = _transforms(bag, topics).between(image.frame, measured.frame)
    where = f"{bag.path}: {topics.depth.name}"
    if T_C_D is None or image.frame == measured.frame:
        problems.warning(
            f"{where} is of another camera than {topics.left.name} by its camera_info, and no tf says how "
            f"{measured.frame!r} stands to {image.frame!r}: depth as the image's camera sees it is needed "
            "(aligned_depth_to_color, depth_registered): read without depth"
        )
        return DepthUse(False)
    lens = measured.camera("rect" in topics.depth.name)
    if lens.distorted or lens.size is None:
        problems.warning(
            f"{where}: its own camera is distorted or has no size by its camera_info: depth registered to the image is "
            "needed: read without depth"
        )
        return DepthUse(False)
    T_C_D, _ = side_by_side(T_C_D, (image.frame, measured.frame))
    return DepthUse(True, DepthSensor(PinholeCamera(*lens.size, lens.fx, lens.fy, lens.cx, lens.cy), T_C_D))


def _info(bag: Bag, topic: Topic, problems: Problems) -> CameraInfo:
    """The first message of a camera_info topic; a change by the last is said."""
    source = bag.path / topic.name.strip("/")
    first, last = (CameraInfo(message, source) for message in bag.ends(topic))
    if not first.same_view(last):
        problems.warning(f"{source}: the calibration changes within the recording: the first one is taken")
    return first


def _transforms(bag: Bag, topics: RobotTopics) -> FixedTransforms:
    return read_transforms(bag, topics.transforms)


def _pair(bag: Bag, topics: RobotTopics, left: CameraInfo, right: CameraInfo, problems: Problems) -> RawRig | None:
    """The pair by the projection matrices, else by tf; None where neither says how the cameras stand. Where both do
    and contradict each other, that is said."""
    stated = pair(left, right, topics.rectified)
    T_left_right = _transforms(bag, topics).between(left.frame, right.frame)
    if T_left_right is None or left.frame == right.frame or not np.linalg.norm(T_left_right[:3, 3]):
        return stated
    T_left_right, turned = side_by_side(T_left_right, (left.frame, right.frame))
    length = float(np.linalg.norm(T_left_right[:3, 3]))
    frames = f"{left.frame} and {right.frame}"
    if stated is not None and stated.T_left_right is not None:
        said = float(np.linalg.norm(stated.T_left_right[:3, 3]))
        if abs(said - length) > _AGREE * length:
            problems.warning(
                f"{right.source}: {said:.4g} m between the cameras by its projection matrix, {length:.4g} m between "
                f"{frames} by tf: that of camera_info is taken; a camera file beside the bag would settle it"
            )
        return stated
    if topics.rectified:
        angle = np.degrees(np.arccos(np.clip(0.5 * (np.trace(T_left_right[:3, :3]) - 1.0), -1.0, 1.0)))
        if angle > _TURNED_DEG or np.abs(T_left_right[1:3, 3]).max() > _ASIDE * length:
            problems.warning(
                f"{right.source}: images called rectified, but by tf the right camera is turned by {angle:.1f} degrees "
                f"and stands at {np.round(T_left_right[:3, 3], 4).tolist()} m: only x is used"
            )
    axes = ", turned from a body's axes" if turned else ""
    rig = pair_apart(left, right, topics.rectified, T_left_right)
    return replace(rig, form=f"camera_info, with tf: {length:.4g} m between {frames}{axes}")
