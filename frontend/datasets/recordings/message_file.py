"""One file of recorded messages: which topics it has, where each message lies, and any of them read on demand."""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any, ClassVar

from ...errors import FrontendError

MOST_BYTES = 1 << 31
"""Of a block or message: what says more is damaged."""
_KEPT_BLOCKS = 4


@dataclass(frozen=True)
class Topic:
    """A topic of one file: ``type`` as ROS 2 writes it (``sensor_msgs/msg/Image``), ``count`` messages; ``ids``: the
    file's own numbers for it."""

    name: str
    type: str
    count: int
    ids: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Place:
    """Where a message lies: ``offset`` in the block of ``size`` bytes at ``start``, which ``codec`` compresses (empty:
    as it is). In a database, ``start`` is the row."""

    start: int
    size: int = 0
    codec: str = ""
    offset: int = 0


class MessageFile(ABC):
    """One file of a bag. A process opens it when a message is first asked for; threads take turns; nothing of it is
    kept but the blocks unpacked last. ``packed``: each message is compressed by itself (zstd). ``location``: of the
    copy to be opened, where the file at ``path`` is compressed as a whole; None: itself."""

    ros1: ClassVar[bool]
    """Whether messages are serialised as ROS 1 does, else as CDR."""

    def __init__(self, path: Path, packed: bool = False, location: Path | None = None) -> None:
        self.path, self.packed, self.location = path, packed, location or path
        self._forget()

    def _forget(self) -> None:
        self._lock, self._process = Lock(), os.getpid()
        self._handle: Any = None
        self._indexed: Any = None
        self._blocks: OrderedDict[int, bytes] = OrderedDict()

    def __getstate__(self) -> dict[str, Any]:
        return {"path": self.path, "packed": self.packed, "location": self.location}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.path, self.packed, self.location = state["path"], state["packed"], state["location"]
        self._forget()

    @abstractmethod
    def topics(self) -> list[Topic]:
        """All topics, in no order. :class:`FrontendError` for a file that is damaged, or has no index."""

    @abstractmethod
    def places(self, topic: Topic) -> list[tuple[int, Place]]:
        """Time of reception in nanoseconds, and place, of each message of a topic, in no order."""

    @abstractmethod
    def _open(self) -> Any:
        """The file, to read messages from."""

    @abstractmethod
    def _message(self, place: Place, most: int) -> bytes:
        """The first ``most`` bytes of a message, or more."""

    def _block(self, start: int, unpack: Callable[[], bytes]) -> bytes:
        """The unpacked block at ``start``; some are kept, as left and right images of a moment may lie in two."""
        if start not in self._blocks:
            self._blocks[start] = unpack()
            while len(self._blocks) > _KEPT_BLOCKS:
                self._blocks.popitem(last=False)
        return self._blocks[start]

    def read(self, place: Place, most: int = MOST_BYTES) -> bytes:
        """A message as it is serialised, or its beginning where no more than ``most`` bytes are asked for.
        :class:`FrontendError` where the file is damaged there."""
        if self._process != os.getpid():  # a place in the file is shared by processes that fork
            self._forget()
        with self._lock, unreadable(self.path, "a message cannot be read"):
            if self._handle is None:
                self._handle = self._open()
            if self.packed:
                return unpacked_zstd(self._message(place, MOST_BYTES))
            return self._message(place, most)


def topics_of(connections: Iterable[Any]) -> list[Topic]:
    """Topics of the connections that a reader of rosbags found; several publishers of a topic are one."""
    found: dict[tuple[str, str], list[tuple[int, int]]] = {}
    for one in connections:
        found.setdefault((one.topic, one.msgtype), []).append((one.id, one.msgcount))
    return [
        Topic(name, kind, sum(count for _, count in ids), tuple(number for number, _ in ids))
        for (name, kind), ids in found.items()
    ]


@contextmanager
def unreadable(path: Path, what: str) -> Iterator[None]:
    """Say ``what`` of ``path`` in one line, whatever is raised in the block: the readers of others raise anything from
    ``KeyError`` to ``MemoryError`` on damaged files."""
    try:
        yield
    except FrontendError:
        raise
    except Exception as error:
        said = " ".join(str(error).split()) or type(error).__name__
        raise FrontendError(f"{path}: {what}: {said[:160]}") from error


def exactly(handle: Any, start: int, size: int) -> bytes:
    """``size`` bytes from ``start`` on; ``ValueError`` where the file has fewer."""
    if not 0 <= size <= MOST_BYTES:
        raise ValueError(f"{size} bytes at {start} are too many")
    handle.seek(start)
    data: bytes = handle.read(size)
    if len(data) != size:
        raise ValueError(f"it ends after {start + len(data)} bytes, where {start + size} are expected")
    return data


def need_rosbags() -> None:
    """:class:`FrontendError` that says what to install, where the package that reads bags is missing."""
    try:
        import rosbags.interfaces  # noqa: F401
    except ImportError as error:
        raise FrontendError(f'bags are read by the package rosbags: pip install "maslam[bags]" ({error})') from None


def unpacked_zstd(data: bytes) -> bytes:
    """Decompressed by the package that rosbags brings along, or Python itself from 3.14 on."""
    try:
        from compression import zstd
    except ImportError:
        from backports import zstd
    unpacked: bytes = zstd.decompress(data)
    return unpacked
