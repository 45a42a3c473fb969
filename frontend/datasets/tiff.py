"""The first directory of a TIFF file: size, depth and orientation; EXIF, in whatever file, is laid out the same."""

from __future__ import annotations

import struct
from dataclasses import dataclass

STARTS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_SHORT, _LONG, _LONG8 = 3, 4, 16
_CODES = {1: "B", _SHORT: "H", _LONG: "I", _LONG8: "Q"}
_WIDTH, _HEIGHT, _BITS, _ORIENTATION, _SAMPLES, _FORMAT = 256, 257, 258, 274, 277, 339
_FLOAT = 3
_MOST_ENTRIES = 4096


@dataclass(frozen=True)
class TiffLayout:
    """Size in pixels, ``channels``, ``bits`` of one value, whether they are ``real``; EXIF's ``orientation``."""

    width: int
    height: int
    channels: int
    bits: int
    real: bool
    orientation: int


def read_layout(data: bytes) -> TiffLayout | None:
    """The first image of a TIFF file; None where its directory cannot be read."""
    tags = _first_directory(data)
    if _WIDTH not in tags or _HEIGHT not in tags:
        return None
    return TiffLayout(
        width=tags[_WIDTH],
        height=tags[_HEIGHT],
        channels=tags.get(_SAMPLES, 1),
        bits=tags.get(_BITS, 1),
        real=tags.get(_FORMAT) == _FLOAT,
        orientation=_orientation(tags),
    )


def exif_orientation(data: bytes) -> int:
    """1 to 8: how an EXIF block, which begins as a TIFF file does, wants its picture turned; 1 is as stored."""
    return _orientation(_first_directory(data))


def _orientation(tags: dict[int, int]) -> int:
    value = tags.get(_ORIENTATION, 1)
    return value if 1 <= value <= 8 else 1


def _first_directory(data: bytes) -> dict[int, int]:
    """First value of each whole-number tag; empty for what is no TIFF."""
    if data[:4] not in STARTS:
        return {}
    order, big = ("<" if data[:2] == b"II" else ">"), data[:4] in STARTS[2:]
    offset, count, entry = ("Q", "Q", 20) if big else ("I", "H", 12)
    try:
        (at,) = struct.unpack_from(order + offset, data, 8 if big else 4)
        (entries,) = struct.unpack_from(order + count, data, at)
        at += struct.calcsize(order + count)
        tags = [_tag(data, at + k * entry, order, offset) for k in range(min(entries, _MOST_ENTRIES))]
    except struct.error:
        return {}
    return {tag: value for tag, value in tags if value is not None}


def _tag(data: bytes, at: int, order: str, offset: str) -> tuple[int, int | None]:
    """Number and first value of the entry at ``at``; None where it is no whole number."""
    tag, kind, count = struct.unpack_from(f"{order}HH{offset}", data, at)
    if kind not in _CODES or not count:
        return tag, None
    at += 4 + struct.calcsize(order + offset)
    if count * struct.calcsize(_CODES[kind]) > struct.calcsize(order + offset):
        (at,) = struct.unpack_from(order + offset, data, at)
    return tag, int(struct.unpack_from(order + _CODES[kind], data, at)[0])
