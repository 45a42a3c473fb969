"""The bags of a folder as recordings: parts that go on where another ends are one, bags without images are none."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from ...files.timestamps import NS_PER_S
from ...recording_config import RecordingConfig
from .bag import Bag
from .robot_topics import RobotTopics, find_robots, has_images

_PART_GAP_NS = 2 * NS_PER_S
_PART_NUMBER = re.compile(r"[-_. ]\d+$")
_PART = (
    "{}: begins where the bag before it ends, under another name: read as a robot of its own; if it is a part of one "
    "recording, call them run_0, run_1, …"
)


@dataclass(frozen=True)
class RecordedBag:
    """``name`` of the recording; ``robots`` in it. ``notes``: what to know about it, ``warnings``: what to look at."""

    bag: Bag
    name: str
    robots: dict[str, RobotTopics]
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()


def recordings(paths: Sequence[Path], config: RecordingConfig) -> list[RecordedBag]:
    """The recordings in bags at ``paths``, in natural order. Bags without images are passed over where others have
    some, which is noted."""
    bags = [Bag(path) for path in paths]
    without = [bag.path.name for bag in bags if not has_images(bag.topics())]
    if len(without) == len(bags):
        without = []
    found: list[RecordedBag] = []
    for bag in bags:
        if bag.path.name in without:
            continue
        one = _recorded(bag, config)
        if found and _goes_on(found[-1], one):
            if _alike(found[-1].bag.parts[-1], bag.path):
                joined = _recorded(Bag(found[-1].bag.path, (*found[-1].bag.parts, bag.path)), config)
                found[-1] = replace(joined, name=_PART_NUMBER.sub("", found[-1].bag.path.stem))
                continue
            one = replace(one, warnings=(_PART.format(bag.path),))
        found.append(one)
    note = (f"bags without images, not read: {', '.join(without)}",) if without else ()
    return [replace(one, notes=(*one.bag.notes, *note)) for one in found]


def _recorded(bag: Bag, config: RecordingConfig) -> RecordedBag:
    robots = find_robots(bag.path, bag.topics(), config)
    bag.index([topic for robot in robots.values() for topic in robot.all])
    name = bag.path.resolve().name if bag.path.is_dir() else bag.path.stem
    return RecordedBag(bag, name, robots)


def _alike(one: Path, other: Path) -> bool:
    """Whether names are those of parts, as `rosbag record --split` gives them: alike but for numbers."""
    return re.sub(r"\d+", "0", one.name) == re.sub(r"\d+", "0", other.name) and not one.is_dir()


def _goes_on(first: RecordedBag, second: RecordedBag) -> bool:
    """Whether the images of the second bag begin where those of the first one end."""
    others = {topics.left.name: topics for topics in second.robots.values()}
    gaps = [
        int(second.bag.messages(others[one.left.name].left).stamps_ns[0])
        - int(first.bag.messages(one.left).stamps_ns[-1])
        for one in first.robots.values()
        if one.left.name in others
    ]
    return bool(gaps) and min(gaps) > 0 and min(gaps) < _PART_GAP_NS
