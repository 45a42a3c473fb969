"""A bag as a whole: one file of messages, or the files that ``metadata.yaml`` of a ROS 2 bag lists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...cameras.calibration_files import load_fields
from ...errors import FrontendError
from ..images import natural_key
from .bag_image import deserialised, stamp_ns
from .mcap_file import McapFile
from .message_file import MessageFile, Place, Topic, need_rosbags, unreadable
from .ros1_bag import Ros1Bag
from .sqlite_file import SqliteFile
from .unpacked import PACKED_SUFFIXES, unpacked

_FILES: dict[str, type[MessageFile]] = {".bag": Ros1Bag, ".mcap": McapFile, ".db3": SqliteFile}
BAG_SUFFIXES = frozenset(_FILES)
METADATA = "metadata.yaml"
_SHOWN = 4
_HEAD_BYTES = 64  # of a message: enough for the time in its header


@dataclass(frozen=True)
class Messages:
    """Messages of one topic: ``stamps_ns`` ``(N,)`` ascending, of their headers, or of their reception where
    ``received``; ``files`` and ``places`` of each. ``moved``: so many were not in that order."""

    stamps_ns: NDArray[np.int64]
    files: tuple[MessageFile, ...]
    places: tuple[Place, ...]
    received: bool
    moved: int


class Bag:
    """The recording ``path``: a file, or the folder of a ROS 2 bag; or the first of ``parts``, files of one recording
    that go on where the one before ends."""

    def __init__(self, path: Path, parts: Sequence[Path] = ()) -> None:
        """:class:`FrontendError` where it is damaged, or the package that reads it is missing."""
        need_rosbags()
        self.path, self.parts = path, tuple(parts) or (path,)
        self.files = [file for part in self.parts for file in _files_of(part)]
        self._known: dict[Topic, Messages] = {}
        self._topics = [(file, topic) for file in self.files for topic in file.topics()]

    @property
    def notes(self) -> list[str]:
        """How its files were brought together, a sentence each."""
        whole = [file for file in self.files if file.location != file.path]
        notes = []
        if len(self.parts) > 1:
            names = [part.name for part in self.parts]
            shown = ", ".join(names if len(names) <= _SHOWN else [*names[:2], "…", names[-1]])
            notes.append(
                f"{len(names)} bags are read as one recording, in which each goes on where another ends: {shown}"
            )
        if whole:
            size = sum(file.location.stat().st_size for file in whole) / 1e6
            notes.append(f"{len(whole)} files compressed as a whole are unpacked to a temporary folder: {size:.1f} MB")
        return notes

    def topics(self) -> list[Topic]:
        """All topics, with the messages of all files counted, by name. A name with messages of two types is there for
        each."""
        counts: dict[tuple[str, str], int] = {}
        for _, topic in self._topics:
            counts[topic.name, topic.type] = counts.get((topic.name, topic.type), 0) + topic.count
        return [Topic(name, kind, count, ()) for (name, kind), count in sorted(counts.items())]

    def messages(self, topic: Topic) -> Messages:
        """Where the messages of a topic are, in order of the times in their headers."""
        return self.index([topic])[0]

    def index(self, topics: Sequence[Topic]) -> list[Messages]:
        """As :meth:`messages` of several topics, for which the bag is gone through once; what was found is kept."""
        wanted = [topic for topic in dict.fromkeys(topics) if topic not in self._known]
        found = {
            topic: [
                (received, file, place)
                for file, one in self._topics
                if (one.name, one.type) == (topic.name, topic.type)
                for received, place in file.places(one)
            ]
            for topic in wanted
        }
        stamps = {topic: np.zeros(len(found[topic]), dtype=np.int64) for topic in wanted}
        every = [
            (place.start, place.offset, topic, i) for topic in wanted for i, (_, _, place) in enumerate(found[topic])
        ]
        for _, _, topic, i in sorted(every, key=lambda one: one[:2]):  # a block is unpacked once
            _, file, place = found[topic][i]
            head = file.read(place, _HEAD_BYTES)
            with unreadable(file.path, f"a message of {topic.name} is damaged"):
                stamps[topic][i] = stamp_ns(head, file.ros1, topic.type)
        for topic in wanted:
            self._known[topic] = _in_order(found[topic], stamps[topic])
        return [self._known[topic] for topic in topics]

    def ends(self, topic: Topic) -> tuple[Any, Any]:
        """The first and the last message of a topic in order of reception."""
        found = [
            (received, number, file, place)
            for number, (file, one) in enumerate(self._topics)
            if (one.name, one.type) == (topic.name, topic.type)
            for received, place in file.places(one)
        ]
        ends = (choose(found, key=lambda one: one[:2]) for choose in (min, max))
        first, last = (self._decoded(file, place, topic) for _, _, file, place in ends)
        return first, last

    def sample(self, topic: Topic, most: int) -> list[Any]:
        """At most about ``most`` messages of a topic, evenly over the order of reception, the first one among them."""
        found = [
            (received, number, i, file, place)
            for number, (file, one) in enumerate(self._topics)
            if (one.name, one.type) == (topic.name, topic.type)
            for i, (received, place) in enumerate(file.places(one))
        ]
        chosen = sorted(found, key=lambda one: one[:3])[:: 1 + len(found) // most]
        return [self._decoded(file, place, topic) for _, _, _, file, place in chosen]

    def read(self, messages: Messages, i: int, topic: Topic) -> Any:
        """Message ``i`` of ``messages``, of ``topic``. :class:`FrontendError` where it is damaged."""
        return self._decoded(messages.files[i], messages.places[i], topic)

    def _decoded(self, file: MessageFile, place: Place, topic: Topic) -> Any:
        data = file.read(place)
        with unreadable(file.path, f"a message of {topic.name} is damaged"):
            return deserialised(data, topic.type, file.ros1)


def _in_order(found: Sequence[tuple[int, MessageFile, Place]], stamps: NDArray[np.int64]) -> Messages:
    """Messages with their times of reception and the ``stamps`` of their headers ``(N,)``, in order of these."""
    arrival = np.array([received for received, _, _ in found], dtype=np.int64)
    headless = bool((stamps == 0).any())
    chosen = arrival if headless else stamps
    rows = np.lexsort((arrival, chosen))
    as_received = chosen[np.argsort(arrival, kind="stable")]
    return Messages(
        chosen[rows],
        tuple(found[i][1] for i in rows),
        tuple(found[i][2] for i in rows),
        headless,
        int((np.diff(as_received) < 0).sum()),
    )


def is_bag(path: Path) -> bool:
    """Whether ``path`` is a file of messages, or the folder of a ROS 2 bag, by its names."""
    if path.is_dir():
        return (path / METADATA).is_file() and any(p.suffix.lower() in BAG_SUFFIXES for p in _inside(path))
    return path.suffix.lower() in BAG_SUFFIXES and path.is_file()


def bags_in(path: Path) -> list[Path]:
    """The bags at ``path``: itself, or those directly in the folder, in natural order of their names."""
    if is_bag(path):
        return [path]
    return sorted((p for p in _inside(path) if is_bag(p)), key=lambda p: natural_key(p.stem)) if path.is_dir() else []


def _inside(folder: Path) -> Sequence[Path]:
    """What lies in the folder; of a compressed bag's files the names without the last suffix."""
    return [
        p.with_suffix("") if p.suffix in PACKED_SUFFIXES else p for p in folder.iterdir() if not p.name.startswith(".")
    ]


def _files_of(path: Path) -> list[MessageFile]:
    if path.is_file():
        return [_FILES[path.suffix.lower()](path)]
    metadata = path / METADATA
    about = load_fields(metadata).inner("rosbag2_bagfile_information").data
    mode, codec = (str(about.get(key) or "").lower() for key in ("compression_mode", "compression_format"))
    names = about.get("relative_file_paths")
    if not isinstance(names, list) or not names:
        raise FrontendError(f"{metadata}: relative_file_paths: a list of files expected, found {str(names)[:60]!r}")
    if mode in ("message", "file") and codec != "zstd":
        raise FrontendError(f"{metadata}: {mode}s compressed by {codec!r}, which is not read (zstd)")
    files = [path / Path(str(name)).name for name in names]
    missing = [file for file in files if not file.is_file()]
    if missing:
        raise FrontendError(f"{missing[0]}: the file is missing, which {METADATA} lists")
    unknown = [file for file in files if _suffix(file) not in BAG_SUFFIXES]
    if unknown:
        raise FrontendError(f"{unknown[0]}: a bag in a format that is not read ({', '.join(sorted(BAG_SUFFIXES))})")
    whole = [unpacked(file) if file.suffix in PACKED_SUFFIXES else None for file in files]
    return [
        _FILES[_suffix(file)](file, mode == "message", location) for file, location in zip(files, whole, strict=True)
    ]


def _suffix(file: Path) -> str:
    """What the file is, compressed or not."""
    return (file.with_suffix("") if file.suffix in PACKED_SUFFIXES else file).suffix.lower()
