"""What an image file says of itself before it is decoded: format, size, depth, orientation, and whether it is whole."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from . import jpeg, tiff

MAX_PIXELS = 100_000_000
"""A larger image is refused before it is decoded: no camera's video has so many pixels, and a few bytes can claim
them."""
_PNG_START = b"\x89PNG\r\n\x1a\n"
_PNG_CHANNELS = {0: 1, 2: 3, 3: 3, 4: 2, 6: 4}
_PNM = re.compile(rb"P([1-6])(?:\s|#[^\n]*\n)+(\d+)(?:\s|#[^\n]*\n)+(\d+)(?:(?:\s|#[^\n]*\n)+(\d+))?")
_BRANDS = {
    "HEIC": (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"),
    "AVIF": (b"avif", b"avis"),
    "the format of a film": (b"isom", b"iso2", b"mp41", b"mp42", b"qt  ", b"M4V ", b"avc1", b"3gp4", b"3gp5"),
    "Canon raw": (b"crx ",),
}
_STARTS = {
    "GIF": (b"GIF87a", b"GIF89a"),
    "JPEG XL": (b"\xff\x0a", b"\x00\x00\x00\x0cJXL "),
    "JPEG 2000": (b"\x00\x00\x00\x0cjP  ", b"\xff\x4f\xff\x51"),
    "OpenEXR": (b"\x76\x2f\x31\x01",),
    "Radiance HDR": (b"#?RADIANCE", b"#?RGBE"),
    "PDF": (b"%PDF",),
}
UNREAD = {
    ".heic": "HEIC",
    ".heif": "HEIC",
    ".avif": "AVIF",
    ".gif": "GIF",
    ".jxl": "JPEG XL",
    ".jp2": "JPEG 2000",
    ".exr": "OpenEXR",
    ".hdr": "Radiance HDR",
    ".dng": "camera raw (DNG)",
    ".cr2": "camera raw (CR2)",
    ".cr3": "camera raw (CR3)",
    ".nef": "camera raw (NEF)",
    ".arw": "camera raw (ARW)",
    ".raw": "camera raw",
}
"""Formats by their names that are not read."""


@dataclass(frozen=True)
class ImageHeader:
    """``format``: by the file's first bytes, whatever its name; ``refusal``: why it is not decoded, empty where it is.

    ``width``, ``height`` in pixels, 0 where unknown; ``channels``; ``bits`` of one value; ``orientation`` as EXIF
    numbers it. ``whole``: False for a file that stops early. ``end``: bytes that belong to the image. ``only_depth``:
    refused as a picture, but depth may be stored so.
    """

    format: str = ""
    width: int = 0
    height: int = 0
    channels: int = 0
    bits: int = 0
    orientation: int = 1
    whole: bool = True
    end: int | None = None
    refusal: str = ""
    only_depth: bool = False


def read_header(data: bytes) -> ImageHeader:
    """The header of an image file's ``data``; of an unknown format nothing is known, and nothing refused."""
    foreign = _foreign(data)
    if foreign:
        return ImageHeader(foreign, refusal=not_read(foreign), only_depth=foreign == "OpenEXR")
    header = _known(data)
    if (header.only_depth or not header.refusal) and header.width * header.height > MAX_PIXELS:
        return ImageHeader(
            header.format,
            refusal=f"{header.width}x{header.height} pixels by its header, more than the {MAX_PIXELS / 1e6:.0f} "
            "million that are decoded",
        )
    return header


def not_read(kind: str) -> str:
    """Why an image of ``kind`` is refused, and what helps."""
    return f"a picture in {kind}, which is not read; convert it to PNG or JPEG, in its stored size"


def _known(data: bytes) -> ImageHeader:
    if data.startswith(_PNG_START):
        return _png(data)
    if data.startswith(jpeg.START):
        return _jpeg(data)
    if data[:4] in tiff.STARTS:
        return _tiff(data)
    if data.startswith(b"BM") and len(data) >= 30:
        width, height = (int.from_bytes(data[k : k + 4], "little", signed=True) for k in (18, 22))
        return ImageHeader("BMP", abs(width), abs(height), 3, 8)
    if data.startswith(b"RIFF") and data[8:12] == b"WEBP":
        return _webp(data)
    pnm = _PNM.match(data[:512])
    if pnm:
        bits = 16 if pnm[4] and pnm[1] not in b"14" and int(pnm[4]) > 255 else 8
        return ImageHeader("PNM", int(pnm[2]), int(pnm[3]), 3 if pnm[1] in b"36" else 1, bits)
    return ImageHeader()


def _png(data: bytes) -> ImageHeader:
    """Walk the chunks (length, name, data, checksum) to the end chunk."""
    position, orientation, whole = len(_PNG_START), 1, False
    while position + 12 <= len(data) and not whole:
        length = int.from_bytes(data[position : position + 4], "big")
        name = data[position + 4 : position + 8]
        if name == b"eXIf":
            orientation = tiff.exif_orientation(data[position + 8 : position + 8 + length])
        position += 12 + length
        whole = name == b"IEND" and position <= len(data)
    if data[12:16] != b"IHDR" or len(data) < 26:
        return ImageHeader("PNG", whole=whole)
    width, height = (int.from_bytes(data[k : k + 4], "big") for k in (16, 20))
    return ImageHeader("PNG", width, height, _PNG_CHANNELS.get(data[25], 0), data[24], orientation, whole)


def _jpeg(data: bytes) -> ImageHeader:
    found = jpeg.walk(data)
    known = ImageHeader(
        "JPEG",
        found.width,
        found.height,
        found.channels,
        found.bits,
        found.orientation,
        found.end is not None,
        found.end,
    )
    if found.coding and not found.decodable:
        return ImageHeader(
            "JPEG", refusal=f"a JPEG that is {found.coding}, which is not read; save it as baseline JPEG"
        )
    if found.coding and found.bits != 8:
        return ImageHeader("JPEG", refusal=f"a JPEG of {found.bits} bits, which is not read; save it as PNG of 16 bits")
    return known


def _tiff(data: bytes) -> ImageHeader:
    found = tiff.read_layout(data)
    if found is None:
        return ImageHeader("TIFF")
    header = ImageHeader("TIFF", found.width, found.height, found.channels, found.bits, found.orientation)
    if found.real or found.bits > 16:
        kind = "real numbers" if found.real else f"{found.bits} bits"
        refusal = f"a TIFF of {kind}, which is not read; save it as 8 or 16 bits"
        return replace(header, refusal=refusal, only_depth=True)
    return header


def _webp(data: bytes) -> ImageHeader:
    kind = data[12:16]
    if kind == b"VP8X" and len(data) >= 30:
        if data[20] & 2:
            return ImageHeader("WebP", refusal=not_read("animated WebP"))
        width, height = (int.from_bytes(data[k : k + 3], "little") + 1 for k in (24, 27))
        return ImageHeader("WebP", width, height, 3, 8)
    if kind == b"VP8 " and len(data) >= 30:
        width, height = (int.from_bytes(data[k : k + 2], "little") & 0x3FFF for k in (26, 28))
        return ImageHeader("WebP", width, height, 3, 8)
    if kind == b"VP8L" and len(data) >= 25:
        packed = int.from_bytes(data[21:25], "little")
        return ImageHeader("WebP", (packed & 0x3FFF) + 1, (packed >> 14 & 0x3FFF) + 1, 3, 8)
    return ImageHeader("WebP")


def _foreign(data: bytes) -> str:
    """Name of a format that is not read; empty for others."""
    if data[4:8] == b"ftyp":
        brands = {data[8:12], *(data[k : k + 4] for k in range(16, min(len(data), 64), 4))}
        main = [kind for kind, known in _BRANDS.items() if data[8:12] in known and data[8:12] not in (b"mif1", b"msf1")]
        if main:
            return main[0]
        return (
            "AVIF"
            if brands & set(_BRANDS["AVIF"])
            else "HEIC"
            if brands & set(_BRANDS["HEIC"])
            else "the format of a film"
        )
    return next((kind for kind, starts in _STARTS.items() if data.startswith(starts)), "")
