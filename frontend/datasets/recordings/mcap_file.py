"""MCAP files (mcap.dev/spec) of ROS 2: messages in chunks with an index, or one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from io import BufferedReader, BytesIO
from typing import Any

import numpy as np

from ...errors import FrontendError
from .message_file import MOST_BYTES, MessageFile, Place, Topic, exactly, topics_of, unpacked_zstd, unreadable

_MESSAGE, _CHUNK, _MESSAGE_INDEX = 0x05, 0x06, 0x07  # op codes of records
_MAGIC = b"\x89MCAP0\r\n"
_HEAD_BYTES = 256  # with the profile
_HEAD = 9  # op code and length of a record
_MESSAGE_HEAD = 22  # channel, sequence, two times
_CHUNK_HEAD = 32  # two times, size, checksum, length of the codec's name
_ENTRY = np.dtype([("time", "<u8"), ("offset", "<u8")])


class McapFile(MessageFile):
    """An ``.mcap`` file."""

    ros1 = False

    def topics(self) -> list[Topic]:
        """See :meth:`MessageFile.topics`."""
        return topics_of(self._index().connections)

    def places(self, topic: Topic) -> list[tuple[int, Place]]:
        """See :meth:`MessageFile.places`."""
        index, wanted = self._index(), set(topic.ids)
        found: list[tuple[int, Place]] = []
        with unreadable(self.path, f"the messages of {topic.name} cannot be listed"), self._open() as handle:
            if not index.chunks:
                return list(_scanned(handle, index.data_start, index.data_end, wanted))
            for chunk in index.chunks:
                start = chunk.chunk_start_offset + _HEAD + _CHUNK_HEAD + len(chunk.compression) + 8
                size, codec = chunk.compressed_size, chunk.compression
                if chunk.message_index_offsets:
                    for number in wanted & set(chunk.message_index_offsets):
                        for time, offset in _entries(handle, chunk.message_index_offsets[number]):
                            found.append((time, Place(start, size, codec, offset)))
                else:
                    block = BytesIO(_unpacked(exactly(handle, start, size), codec))
                    found += [
                        (time, Place(start, size, codec, place.start))
                        for time, place in _scanned(block, 0, chunk.uncompressed_size, wanted)
                    ]
        return found

    def _index(self) -> Any:
        """The opened reader of rosbags, which holds channels and chunks."""
        if self._indexed is None:
            from rosbags.rosbag2.storage_mcap import McapReader

            self._check_profile()
            with unreadable(self.path, "no MCAP that can be read (`mcap recover` mends one that was not closed)"):
                reader = McapReader(self.location)
                reader.open()
            self._indexed = reader
        return self._indexed

    def _check_profile(self) -> None:
        """Refuse messages that are none of ROS 2, by the profile with which the file begins."""
        with unreadable(self.path, "no MCAP that can be read"), self._open() as handle:
            head = handle.read(_HEAD_BYTES)
            at = len(_MAGIC) + _HEAD
            length = int.from_bytes(head[at : at + 4], "little")
            profile = head[at + 4 : at + 4 + length].decode("utf-8", "replace")
        if head.startswith(_MAGIC) and profile != "ros2":
            raise FrontendError(
                f"{self.path}: an MCAP of profile {profile!r}: messages of ROS 2 are read (profile 'ros2'), no "
                "protobuf, JSON or ROS 1: convert it (`mcap convert`, `rosbags-convert`), or save its images as files"
            )

    def _open(self) -> BufferedReader:
        return open(self.location, "rb")

    def _message(self, place: Place, most: int) -> bytes:
        if not place.size:
            return _record(self._handle, place.start, most)
        if not place.codec:
            return _record(self._handle, place.start + place.offset, most)
        block = self._block(place.start, lambda: _unpacked(exactly(self._handle, place.start, place.size), place.codec))
        return _record(BytesIO(block), place.offset, most)


def _unpacked(data: bytes, codec: str) -> bytes:
    if not codec:
        return data
    if codec == "zstd":
        return unpacked_zstd(data)
    if codec != "lz4":
        raise ValueError(f"compressed by {codec}, which is not read")
    import lz4.frame

    unpacked: bytes = lz4.frame.decompress(data)
    return unpacked


def _head(handle: Any, at: int) -> tuple[int, int]:
    """Op code and length of the record at ``at``."""
    head = exactly(handle, at, _HEAD)
    return head[0], int.from_bytes(head[1:], "little")


def _record(handle: Any, at: int, most: int) -> bytes:
    """Data of the message whose record begins at ``at``."""
    code, length = _head(handle, at)
    if code != _MESSAGE or not _MESSAGE_HEAD <= length <= MOST_BYTES:
        raise ValueError(f"no message at {at}")
    return exactly(handle, at + _HEAD + _MESSAGE_HEAD, min(length - _MESSAGE_HEAD, most))


def _entries(handle: Any, at: int) -> list[tuple[int, int]]:
    """Time and offset of each message in the index record at ``at``."""
    code, length = _head(handle, at)
    if code != _MESSAGE_INDEX:
        raise ValueError(f"no index of messages at {at}")
    body = exactly(handle, at + _HEAD, length)
    table = np.frombuffer(body[6 : 6 + int.from_bytes(body[2:6], "little")], dtype=_ENTRY)
    return list(zip(table["time"].tolist(), table["offset"].tolist(), strict=True))


def _scanned(handle: Any, start: int, end: int, wanted: set[int]) -> Iterator[tuple[int, Place]]:
    """Messages of the channels ``wanted`` found by going from record to record, in blocks without an index too."""
    at = start
    while at + _HEAD <= end:
        code, length = _head(handle, at)
        if code == _MESSAGE:
            head = exactly(handle, at + _HEAD, _MESSAGE_HEAD)
            if int.from_bytes(head[:2], "little") in wanted:
                yield int.from_bytes(head[6:14], "little"), Place(at)
        elif code == _CHUNK:
            head = exactly(handle, at + _HEAD, _CHUNK_HEAD)
            name = int.from_bytes(head[28:], "little")
            codec = exactly(handle, at + _HEAD + _CHUNK_HEAD, name).decode("ascii")
            size_at = at + _HEAD + _CHUNK_HEAD + name
            size = int.from_bytes(exactly(handle, size_at, 8), "little")
            block = _unpacked(exactly(handle, size_at + 8, size), codec)
            for time, place in _scanned(BytesIO(block), 0, len(block), wanted):
                yield time, Place(size_at + 8, size, codec, place.start)
        at += _HEAD + length
