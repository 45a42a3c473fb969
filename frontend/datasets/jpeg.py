"""A JPEG file walked segment by segment to its own end (ITU-T T.81): what lies behind it, or inside a segment, is
another matter (a phone's film, a thumbnail)."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from .tiff import exif_orientation

START = b"\xff\xd8"
_MARKER = re.compile(rb"\xff[^\x00\xff]")
_AFTER_SCAN = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
"""The next marker behind coded data: in it FF is followed by 00, or by a restart marker."""
_EOI, _SOS, _APP1 = 0xD9, 0xDA, 0xE1
_ALONE = frozenset({0x01, 0xD8, *range(0xD0, 0xD8)})
"""Markers without a segment."""
_FRAMES = {
    0xC0: "baseline",
    0xC1: "extended",
    0xC2: "progressive",
    0xC3: "lossless",
    0xC5: "hierarchical",
    0xC6: "hierarchical",
    0xC7: "hierarchical",
    0xC9: "arithmetic-coded",
    0xCA: "arithmetic-coded",
    0xCB: "arithmetic-coded",
    0xCD: "arithmetic-coded",
    0xCE: "arithmetic-coded",
    0xCF: "arithmetic-coded",
}


@dataclass(frozen=True)
class JpegLayout:
    """``coding``: the frame's, by its marker; ``width``, ``height`` in pixels (0: none stated), ``channels``, ``bits``
    of one value; ``orientation``: EXIF's, 1 where none is stated. ``end``: bytes up to and with the end marker that
    follows the last scan; None where the file stops before it."""

    coding: str = ""
    width: int = 0
    height: int = 0
    channels: int = 0
    bits: int = 0
    orientation: int = 1
    end: int | None = None

    @property
    def decodable(self) -> bool:
        """Whether usual decoders have this coding."""
        return self.coding in ("baseline", "extended", "progressive")


def walk(data: bytes) -> JpegLayout:
    """What the segments of ``data`` say, from its start marker to its end marker; bytes between segments that belong to
    none are passed over, as decoders do."""
    found, position, scans = JpegLayout(), len(START), 0
    while (mark := _MARKER.search(data, position)) is not None:
        marker, position = data[mark.start() + 1], mark.end()
        if marker == _EOI:
            return replace(found, end=position if scans else None)
        if marker in _ALONE:
            continue
        length = max(int.from_bytes(data[position : position + 2], "big"), 2)
        body = data[position + 2 : position + length]
        position += length
        if marker in _FRAMES and not found.coding and len(body) >= 6:
            height, width = (int.from_bytes(body[k : k + 2], "big") for k in (1, 3))
            found = replace(found, coding=_FRAMES[marker], width=width, height=height, channels=body[5], bits=body[0])
        elif marker == _APP1 and body.startswith(b"Exif\0\0"):
            found = replace(found, orientation=exif_orientation(body[6:]))
        elif marker == _SOS:
            scans += 1
            after = _AFTER_SCAN.search(data, position)
            position = len(data) if after is None else after.start()
    return found
