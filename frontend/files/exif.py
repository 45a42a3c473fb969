"""What a photograph says of its lens: a few of EXIF's tags, from JPEG and PNG files.

The format is TIFF's: EXIF 2.32 (CIPA DC-008), sections 4.5 and 4.6.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

from .text_tables import read_bytes

_EXIF_IFD, _FOCAL_MM, _FOCAL_35, _WIDTH = 0x8769, 0x920A, 0xA405, 0xA002
_PLANE_X, _PLANE_UNIT = 0xA20E, 0xA210
_SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 7: 1, 9: 4, 10: 8}
_MM_OF_UNIT = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
_MOST_TAGS = 500


@dataclass(frozen=True)
class LensTags:
    """``focal_35_mm``: equivalent focal length for 36 x 24 mm film; ``focal_mm`` with ``plane_px_mm`` (pixels of the
    sensor per millimetre) and ``plane_width_px`` (width that these count in); None where the file does not say."""

    focal_35_mm: float | None = None
    focal_mm: float | None = None
    plane_px_mm: float | None = None
    plane_width_px: float | None = None

    def focal_px(self, width: int, height: int) -> float | None:
        """Focal length in pixels of an image of this size; None where the tags do not tell it."""
        if self.focal_mm and self.plane_px_mm and self.plane_width_px:
            wide = max(width, height) if self.plane_width_px >= 1 else width
            return _plausible(self.focal_mm * self.plane_px_mm * wide / self.plane_width_px, wide)
        if self.focal_35_mm:
            diagonal = float((width**2 + height**2) ** 0.5)
            return _plausible(self.focal_35_mm * diagonal / float((36**2 + 24**2) ** 0.5), max(width, height))
        return None


def lens_tags(path: Path) -> LensTags:
    """The tags of an image file; all None where there are none, or where they are damaged."""
    try:
        tiff = _tiff(read_bytes(path))
        return LensTags() if tiff is None else _tags(tiff)
    except (struct.error, IndexError, ValueError, ZeroDivisionError, OverflowError):
        return LensTags()


def _plausible(focal_px: float, side_px: float) -> float | None:
    """A focal length that a camera has: 0.2 to 20 times the longer side."""
    return focal_px if 0.2 * side_px < focal_px < 20.0 * side_px else None


def _tiff(data: bytes) -> bytes | None:
    """The TIFF structure inside a JPEG's APP1 segment or a PNG's eXIf chunk."""
    if data.startswith(b"\x89PNG\r\n\x1a\n"):
        at = data.find(b"eXIf", 8)
        return None if at < 12 else data[at + 4 : at + 4 + int.from_bytes(data[at - 4 : at], "big")]
    at = 2
    while data.startswith(b"\xff\xd8") and at + 4 <= len(data) and data[at] == 0xFF and data[at + 1] != 0xDA:
        length = int.from_bytes(data[at + 2 : at + 4], "big")
        if data[at + 1] == 0xE1 and data[at + 4 : at + 10] == b"Exif\0\0":
            return data[at + 10 : at + 2 + length]
        at += 2 + max(length, 2)
    return None


def _tags(tiff: bytes) -> LensTags:
    order = {b"II": "<", b"MM": ">"}.get(tiff[:2])
    if order is None:
        return LensTags()
    first = _directory(tiff, struct.unpack(order + "I", tiff[4:8])[0], order)
    inner = _directory(tiff, int(first[_EXIF_IFD]), order) if _EXIF_IFD in first else {}
    per_unit, unit_mm = inner.get(_PLANE_X), _MM_OF_UNIT.get(int(inner.get(_PLANE_UNIT, 2)))
    return LensTags(
        inner.get(_FOCAL_35) or None,
        inner.get(_FOCAL_MM) or None,
        per_unit / unit_mm if per_unit and unit_mm else None,
        inner.get(_WIDTH) or None,
    )


def _directory(tiff: bytes, at: int, order: str) -> dict[int, float]:
    """First number of each tag of an image file directory."""
    found = {}
    count = struct.unpack(order + "H", tiff[at : at + 2])[0]
    for k in range(min(count, _MOST_TAGS)):
        entry = tiff[at + 2 + 12 * k : at + 14 + 12 * k]
        tag, kind, number = struct.unpack(order + "HHI", entry[:8])
        if kind not in _SIZES or number < 1:
            continue
        place = entry[8:] if _SIZES[kind] * number <= 4 else tiff[struct.unpack(order + "I", entry[8:])[0] :]
        if kind in (3, 4, 9):
            found[tag] = float(struct.unpack(order + {3: "H", 4: "I", 9: "i"}[kind], place[: _SIZES[kind]])[0])
        elif kind in (5, 10):
            above, below = struct.unpack(order + ("II" if kind == 5 else "ii"), place[:8])
            found[tag] = above / below if below else 0.0
    return found
