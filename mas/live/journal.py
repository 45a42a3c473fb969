"""The journal of one agent: everything that came in, in its order and at its time, written before it is acted on.

An agent is a state machine without I/O. So its journal, read again, makes the same agent once more: after a crash, or
for the figures of a run. Each entry is checked by itself; what a crash tore off at the end is cut away. Each entry also
carries a checksum of all that the agent had sent by then: an agent that is made anew, and differs, is found out.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from types import TracebackType
from typing import IO

from ..errors import MasError

_MAGIC = b"maslam journal 1\n"
# Kind, logical time, length of the data, checksum of what was sent before, checksum of this entry.
_HEAD = struct.Struct("<BqIII")
_MOST_BYTES = 256 * 2**20


class EntryKind(IntEnum):
    """What came in."""

    BEGIN = 0
    """A process began; data: a digest of what it was given."""
    MEET = 1
    """Another agent is there; data: its number."""
    OBSERVE = 2
    """The next key-frame of the agent's own sequence; data: its index."""
    MESSAGE = 3
    """A message, as it is in the protocol."""
    TICK = 4
    REMIND = 5
    FINISH = 6
    """Nobody present has anything new to see."""
    REFUSE = 7
    """Bytes of another agent that are no message of its own; data: its number, and what is wrong."""
    SEE = 8
    """The next key-frame of a live camera; data: the key-frame itself."""
    SIGNED = 9
    """Signatures of maps in the message that follows."""


@dataclass(frozen=True)
class JournalEntry:
    """``now_ns``: logical time of the agent; ``sent``: checksum (CRC-32) of all messages that it sent before."""

    kind: EntryKind
    now_ns: int
    data: bytes
    sent: int


class JournalError(MasError):
    """A file that is no journal, or the journal of something else."""


class Journal:
    """``with Journal(path) as journal``: entries are added at the end, each in one write, so that they survive the end
    of the process. :meth:`flush` makes sure that they survive a loss of power."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file: IO[bytes] | None = None

    def __enter__(self) -> Journal:
        whole = _whole_bytes(self.path) if self.path.exists() else 0
        file = open(self.path, "ab", buffering=0)
        file.truncate(whole)
        if whole == 0:
            file.write(_MAGIC)
        self._file = file
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        assert self._file is not None
        self._file.close()

    def append(self, entry: JournalEntry) -> None:
        """Add an entry; ``OSError`` where the disk is full, and the journal ends before it."""
        assert self._file is not None
        head = _HEAD.pack(entry.kind, entry.now_ns, len(entry.data), entry.sent, 0)
        check = zlib.crc32(entry.data, zlib.crc32(head))
        data = head[:-4] + struct.pack("<I", check) + entry.data
        view = memoryview(data)
        while view:  # a write may take less
            view = view[self._file.write(view) :]

    def flush(self) -> None:
        """Have the disk keep what was written."""
        assert self._file is not None
        os.fsync(self._file.fileno())


def read_journal(path: Path) -> Iterator[JournalEntry]:
    """The entries of a journal, up to the last whole one; :class:`JournalError` where it is none."""
    with open(path, "rb") as file:
        begin = file.read(len(_MAGIC))
        if begin != _MAGIC:
            if _MAGIC.startswith(begin):
                return  # torn off at its very beginning
            raise JournalError(f"{path}: not the journal of an agent, or of another version")
        while (entry := _next(file)) is not None:
            yield entry


def _next(file: IO[bytes]) -> JournalEntry | None:
    """The next whole entry, None at the end or where the rest is torn or damaged."""
    head = file.read(_HEAD.size)
    if len(head) < _HEAD.size:
        return None
    kind, now_ns, length, sent, check = _HEAD.unpack(head)
    if length > _MOST_BYTES or kind not in iter(EntryKind):
        return None
    data = file.read(length)
    blank = head[:-4] + bytes(4)
    if len(data) < length or zlib.crc32(data, zlib.crc32(blank)) != check:
        return None
    return JournalEntry(EntryKind(kind), now_ns, data, sent)


def _whole_bytes(path: Path) -> int:
    """How many bytes from the beginning are whole entries."""
    whole = 0
    for entry in read_journal(path):
        whole += _HEAD.size + len(entry.data)
    return whole + len(_MAGIC) if whole or path.stat().st_size >= len(_MAGIC) else 0
