"""Bags of ROS 1 (format 2.0): chunks of messages, each with an index."""

from __future__ import annotations

import bz2
from io import BufferedReader, BytesIO
from typing import Any

from .message_file import MessageFile, Place, Topic, exactly, topics_of, unreadable

_MESSAGE, _CONNECTION = 2, 7  # op codes of records


class Ros1Bag(MessageFile):
    """A ``.bag`` file."""

    ros1 = True

    def topics(self) -> list[Topic]:
        """See :meth:`MessageFile.topics`."""
        return topics_of(self._index().connections)

    def places(self, topic: Topic) -> list[tuple[int, Place]]:
        """See :meth:`MessageFile.places`."""
        index, codecs = self._index(), self._codecs()
        found = []
        for number in topic.ids:
            for time, chunk_at, offset in index.indexes[number]:
                chunk = index.chunks[chunk_at]
                place = Place(chunk.datapos, chunk.datasize, codecs[chunk.decompressor], offset)
                found.append((time, place))
        return found

    def _index(self) -> Any:
        """The opened reader of rosbags, which holds the index."""
        if self._indexed is None:
            from rosbags.rosbag1 import Reader

            with unreadable(self.path, "no bag that can be read (`rosbag reindex` mends one that was not closed)"):
                reader = Reader(self.location)
                reader.open()
            self._indexed = reader
        return self._indexed

    def _codecs(self) -> dict[Any, str]:
        from rosbags.rosbag1.reader import decompressors

        return {unpack: "" if name == "none" else name for name, unpack in decompressors.items()}

    def _open(self) -> BufferedReader:
        return open(self.location, "rb")

    def _message(self, place: Place, most: int) -> bytes:
        if not place.codec:
            return _record(self._handle, place.start + place.offset, most)
        block = self._block(place.start, lambda: _unpacked(exactly(self._handle, place.start, place.size), place.codec))
        return _record(BytesIO(block), place.offset, most)


def _unpacked(data: bytes, codec: str) -> bytes:
    if codec == "bz2":
        return bz2.decompress(data)
    import lz4.frame

    unpacked: bytes = lz4.frame.decompress(data)
    return unpacked


def _record(handle: Any, at: int, most: int) -> bytes:
    """Data of the message at ``at``; records of connections may stand before it."""
    while True:
        length = int.from_bytes(exactly(handle, at, 4), "little")
        fields = _fields(exactly(handle, at + 4, length))
        size = int.from_bytes(exactly(handle, at + 4 + length, 4), "little")
        if fields.get(b"op") != bytes([_CONNECTION]):
            break
        at += 8 + length + size
    if fields.get(b"op") != bytes([_MESSAGE]):
        raise ValueError(f"no message at {at}")
    return exactly(handle, at + 8 + length, min(size, most))


def _fields(header: bytes) -> dict[bytes, bytes]:
    found, at = {}, 0
    while at + 4 <= len(header):
        size = int.from_bytes(header[at : at + 4], "little")
        name, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        found[name] = value
        at += 4 + size
    return found
