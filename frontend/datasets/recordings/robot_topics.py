"""Topics of each robot in a bag: which images are its left, right and depth ones, by their names or by the user's."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ...errors import FrontendError
from ...recording_config import RecordingConfig
from .bag_image import COMPRESSED_IMAGE, IMAGE
from .bag_poses import POSE_TYPES
from .bag_positions import NAV_SAT_FIX, choose_fixes
from .camera_info import CAMERA_INFO
from .message_file import Topic
from .topic_names import ImageName, by_robot, right_of
from .transforms import TF_TYPES
from .video_packets import VIDEO_TYPES

_SHOWN = 12
_OPTION = "--recording.image-topic"
_TYPES = (IMAGE, COMPRESSED_IMAGE, *sorted(VIDEO_TYPES))


@dataclass(frozen=True)
class RobotTopics:
    """What is read of one robot. ``right``, ``depth``, ``infos`` (camera_info of left, right, depth), ``truth``,
    ``gps``: None where there is none. ``warnings``: what was found and is not used; ``unread``: its other images;
    ``transforms``: tf of its name space and those above, static ones first."""

    left: Topic
    right: Topic | None = None
    depth: Topic | None = None
    infos: tuple[Topic | None, Topic | None, Topic | None] = (None, None, None)
    truth: Topic | None = None
    gps: Topic | None = None
    rectified: bool = False
    warnings: tuple[str, ...] = field(default=())
    unread: tuple[Topic, ...] = ()
    transforms: tuple[Topic, ...] = ()

    @property
    def all(self) -> tuple[Topic, ...]:
        """Those whose every message is needed."""
        return tuple(topic for topic in (self.left, self.right, self.depth, self.truth, self.gps) if topic is not None)


def find_robots(path: Path, topics: Sequence[Topic], config: RecordingConfig) -> dict[str, RobotTopics]:
    """The topics of each robot, by its name in them; ``""`` where there is one. :class:`FrontendError` that lists the
    image topics where names do not tell what is to be read, or what the user named is not there."""
    images = {ImageName.of(t.name, t.type != IMAGE): t for t in topics if _is_image(t) and t.count}
    if not images:
        others = ", ".join(f"{topic.name} ({topic.type})" for topic in topics[:_SHOWN])
        raise FrontendError(f"{path}: no image topic with messages; it holds {others or 'no topic'}{_cure(topics)}")
    if config.image_topic is not None:
        robots = _named(path, images, config.image_topic)
    else:
        robots = by_robot([name for name in images if not name.is_derived] or list(images))
    found = {}
    for robot, names in robots.items():
        left, right = _cameras(path, images, names, config)
        head = "" if config.image_topic is None else _head(left, config.image_topic)
        if config.image_topic is not None:
            names = [name for name in images if name.topic.startswith(f"{head}/")]
        names += [
            name for name in images if name.is_derived and name not in names and (not robot or robot in name.parts)
        ]
        one = _completed(path, topics, {name: images[name] for name in names}, left, right, config, head)
        fixes = [topic for topic in topics if topic.type == NAV_SAT_FIX]
        shared = [_shared(topic.name, left) for topic in fixes]
        gps, said = choose_fixes(path, fixes, config.gps_topic, shared, len(robots) == 1)
        found[robot] = replace(one, gps=gps, warnings=(*one.warnings, *said))
    return found


def _cure(topics: Sequence[Topic]) -> str:
    """What to do about images in messages that are not read."""
    found = next((t for t in topics if t.count and re.search(r"theora|video|packet|image", t.type.lower())), None)
    if found is None:
        return ""
    return (
        f"; {found.name} seems to hold images in messages that are not read: republish them as sensor_msgs/Image "
        "(`ros2 run image_transport republish`) and record these"
    )


def has_images(topics: Sequence[Topic]) -> bool:
    """Whether there are messages of images among ``topics``."""
    return any(_is_image(topic) and topic.count for topic in topics)


def _is_image(topic: Topic) -> bool:
    return topic.type in _TYPES


def _coded(topic: Topic) -> int:
    """How far from the sensor's own images: as they are, compressed one by one, video."""
    return _TYPES.index(topic.type)


def _named(path: Path, images: dict[ImageName, Topic], wanted: str) -> dict[str, list[ImageName]]:
    """The images that the user named, for each robot."""
    chosen = [name for name in images if _matches(name, wanted)]
    if not chosen:
        raise FrontendError(f"{path}: no image topic {wanted}: {_listed(images)}")
    exact = [name for name in chosen if name.topic == wanted] or chosen
    heads = {name: _head(name, wanted) for name in exact}
    if len(exact) == 1:
        return {"": exact}
    parts = {name: tuple(part for part in head.split("/") if part) for name, head in heads.items()}
    robots: dict[str, list[ImageName]] = {}
    for name in exact:
        robots.setdefault("_".join(parts[name]), []).append(name)
    return robots


def _matches(name: ImageName, wanted: str) -> bool:
    ends = "/" + wanted.strip("/")
    return any(text == wanted or ("/" + text.strip("/")).endswith(ends) for text in (name.topic, name.base))


def _head(name: ImageName, wanted: str) -> str:
    """The robot's part of a topic that ends as the user said."""
    text = name.topic if name.topic.endswith(wanted.strip("/")) else name.base
    return text[: len(text) - len(wanted.strip("/"))].rstrip("/")


def _cameras(
    path: Path, images: dict[ImageName, Topic], own: Sequence[ImageName], config: RecordingConfig
) -> tuple[ImageName, ImageName | None]:
    """The left and the right images of one robot, among its ``own``."""
    if config.image_topic is not None:
        return min(own, key=lambda name: (name.rank, _coded(images[name]), name.topic)), None
    views = _one_each([name for name in own if not name.is_depth], images)
    if not views:
        raise FrontendError(f"{path}: no images but depth: {_listed(images)}")
    pairs = [(name, right) for name in views if (right := right_of(name, views)) is not None]
    if len(views) == 1:
        return views[0], None
    if len(pairs) == 1 and all(name in pairs[0] or _is_colour_of(name, pairs[0][0]) for name in views):
        return pairs[0]
    raise FrontendError(f"{path}: which images are to be read? {_OPTION} names the topic: {_listed(images)}")


def _is_colour_of(name: ImageName, left: ImageName) -> bool:
    """Whether these are the colour images of the device of a pair (RealSense, OAK-D)."""
    head, _, last = name.camera.rpartition("/")
    return head == left.camera.rpartition("/")[0] and last.lower() in ("color", "colour", "rgb")


def _one_each(names: Sequence[ImageName], images: dict[ImageName, Topic]) -> list[ImageName]:
    """One topic for each camera: of several the one with most images, then the one closest to the sensor."""
    best: dict[str, ImageName] = {}
    for name in sorted(names, key=lambda n: (n.rank, _coded(images[n]), n.topic)):
        known = best.get(name.camera)
        if known is None or images[name].count > 1.5 * images[known].count:
            best[name.camera] = name
    return sorted(best.values(), key=lambda name: name.topic)


def _completed(
    path: Path,
    topics: Sequence[Topic],
    images: dict[ImageName, Topic],
    left: ImageName,
    right: ImageName | None,
    config: RecordingConfig,
    head: str,
) -> RobotTopics:
    """What belongs to the images of one robot, whose topics are ``images`` and begin with ``head``: the user's choice,
    else what is named alike."""
    if config.right_topic is not None:
        right = _chosen(path, images, head, config.right_topic)
    depth, warnings = _depth(path, images, head, config)
    infos: tuple[Topic | None, ...] = tuple(
        None if name is None else _info(path, topics, name, config, name is left) for name in (left, right, depth)
    )
    truth = None if config.truth_topic is None else _truth(path, topics, left, config.truth_topic)
    return RobotTopics(
        images[left],
        None if right is None else images[right],
        None if depth is None else images[depth],
        (infos[0], infos[1], infos[2]),
        truth,
        None,
        left.is_rectified,
        tuple(warnings),
        tuple(topic for name, topic in images.items() if name not in (left, right, depth)),
        _transforms(topics, left),
    )


def _transforms(topics: Sequence[Topic], left: ImageName) -> tuple[Topic, ...]:
    """Topics of tf in a name space in which the images are, too."""
    found = [
        topic
        for topic in topics
        if topic.type in TF_TYPES and topic.count and _shared(topic.name, left) == topic.name.strip("/").count("/")
    ]
    return tuple(sorted(found, key=lambda topic: (not topic.name.endswith("static"), topic.name)))


def _chosen(path: Path, images: dict[ImageName, Topic], head: str, wanted: str) -> ImageName:
    """The topic that the user named, of the robot whose topics begin with ``head``."""
    found = [name for name in images if wanted in (name.topic, name.base)]
    found = found or [n for n in images if _matches(n, wanted) and (not head or _head(n, wanted) == head)]
    if not found:
        raise FrontendError(f"{path}: no image topic {wanted} of {head or 'this robot'}: {_listed(images)}")
    return min(found, key=lambda name: (name.rank, _coded(images[name]), name.topic))


def _depth(
    path: Path, images: dict[ImageName, Topic], head: str, config: RecordingConfig
) -> tuple[ImageName | None, list[str]]:
    if config.depth_topic is not None:
        return _chosen(path, images, head, config.depth_topic), []
    depths = [n for n in images if n.is_depth and not n.is_derived and images[n].type not in VIDEO_TYPES]
    depths = _one_each([name for name in depths if name.is_registered] or depths, images)
    if len(depths) > 1:
        names = ", ".join(name.topic for name in depths)
        return None, [f"{path}: several depth topics ({names}); --recording.depth-topic names one: read without depth"]
    return (depths[0], []) if depths else (None, [])


def _info(path: Path, topics: Sequence[Topic], name: ImageName, config: RecordingConfig, is_left: bool) -> Topic | None:
    infos = {topic.name: topic for topic in topics if topic.type == CAMERA_INFO and topic.count}
    if is_left and config.camera_topic is not None:
        found = _ending(list(infos.values()), name, config.camera_topic)
        if len(found) != 1:
            raise FrontendError(
                f"{path}: no camera_info topic {config.camera_topic}: there are {', '.join(infos) or 'none'}"
            )
        return found[0]
    return next((infos[text] for text in name.camera_info if text in infos), None)


def _truth(path: Path, topics: Sequence[Topic], left: ImageName, wanted: str) -> Topic | None:
    """The topic of true poses that the user named: whole, or its last part, of the robot whose images these are."""
    poses = [topic for topic in topics if topic.type in POSE_TYPES and topic.count]
    found = _ending(poses, left, wanted)
    if len(found) != 1:
        known = ", ".join(f"{topic.name} ({topic.type.rpartition('/')[2]})" for topic in poses[:_SHOWN]) or "none"
        raise FrontendError(f"{path}: no topic of poses {wanted}: there are {known}")
    return found[0]


def _ending(topics: Sequence[Topic], near: ImageName, wanted: str) -> list[Topic]:
    """The topic ``wanted``, whole or its last part; of several those that begin most like ``near``."""
    exact = [topic for topic in topics if topic.name == wanted]
    found = exact or [topic for topic in topics if topic.name.endswith("/" + wanted.strip("/"))]
    shared = [_shared(topic.name, near) for topic in found]
    return [topic for topic, count in zip(found, shared, strict=True) if count == max(shared)]


def _shared(topic: str, name: ImageName) -> int:
    """Number of first parts that both have in common."""
    parts = [part for part in topic.split("/") if part]
    same = [a == b for a, b in zip(parts, name.parts, strict=False)]
    return same.index(False) if False in same else len(same)


def _listed(images: dict[ImageName, Topic]) -> str:
    """Image topics with their types and counts, for messages."""
    shown = [f"{t.name} ({t.type.rpartition('/')[2]}, {t.count})" for t in list(images.values())[:_SHOWN]]
    return ", ".join(shown) + (", …" if len(images) > _SHOWN else "")
