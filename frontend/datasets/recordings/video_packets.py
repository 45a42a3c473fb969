"""Packets of compressed video in messages: where their data begins, which codec it is, where decoding can begin."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass

COMPRESSED_VIDEO, FFMPEG_PACKET = "foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
VIDEO_DEFINITIONS = {
    COMPRESSED_VIDEO: "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n",
    FFMPEG_PACKET: "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
    "bool is_bigendian\nuint8[] data\n",
}
"""As their packages publish them; ROS's own set lacks them."""
VIDEO_TYPES = frozenset(VIDEO_DEFINITIONS)
HEAD_BYTES = 4096
"""Of a message, in which its first units are: parameters, and the kind of picture."""
_START = re.compile(rb"\x00\x00\x01(.)", re.DOTALL)  # of a unit (ITU-T H.264, H.265: Annex B)
_H264_PARAMETERS, _H264_KEYS = frozenset({7, 8}), frozenset({5, 7})
_H265_PARAMETERS, _H265_KEYS = frozenset({32, 33, 34}), frozenset(range(16, 22)) | {32, 33}


@dataclass(frozen=True)
class Packet:
    """The beginning of a packet: ``key``: decoding can begin here; ``parameters`` the units that decoding needs before
    any picture, where it has them."""

    key: bool
    parameters: bytes


def codec_of(named: str) -> str | None:
    """``h264`` or ``h265`` of what a message says (``h264``, ``libx264``, ``hevc_nvenc;yuv420p``); None of others."""
    text = named.lower().partition(";")[0].partition("/")[0]
    if "264" in text or "avc" in text.split("_"):
        return "h264"
    return "h265" if "265" in text or "hevc" in text else None


def packet_of(head: bytes, kind: str, ros1: bool, codec: str) -> Packet:
    """What the first bytes of a serialised message tell. ``ValueError`` where they are none."""
    data = head[_data_at(head, kind, ros1) :]
    parameters, keys = (_H264_PARAMETERS, _H264_KEYS) if codec == "h264" else (_H265_PARAMETERS, _H265_KEYS)
    units = list(_START.finditer(data))
    kept, key = [], False
    for i, unit in enumerate(units):
        number = unit[1][0] & 0x1F if codec == "h264" else unit[1][0] >> 1 & 0x3F
        key = key or number in keys
        if number in parameters:
            end = units[i + 1].start() if i + 1 < len(units) else len(data)
            kept.append(b"\x00" + data[unit.start() : end])
    return Packet(key, b"".join(kept))


def _data_at(head: bytes, kind: str, ros1: bool) -> int:
    """Where the data of a message begins: one of these types, or a ``sensor_msgs/CompressedImage`` with a picture."""
    cursor = _Cursor(head, ros1)
    if kind == COMPRESSED_VIDEO:
        cursor.skip(4, 2)
        cursor.text()
    else:
        cursor.skip(4, 3 if ros1 else 2)  # ROS 1 counts headers
        cursor.text()
        if kind == FFMPEG_PACKET:
            cursor.skip(4, 2)
        cursor.text()
        if kind == FFMPEG_PACKET:
            cursor.skip(8, 1)
            cursor.skip(1, 2)
    cursor.number()
    return cursor.at


class _Cursor:
    """A place in a serialised message: CDR, or ROS 1's form, which knows no alignment."""

    def __init__(self, data: bytes, ros1: bool) -> None:
        self._data, self._ros1 = data, ros1
        self._start = self.at = 0 if ros1 else 4
        self._order = "<" if ros1 or data[1] & 1 else ">"

    def skip(self, size: int, count: int) -> None:
        """Past ``count`` numbers of ``size`` bytes."""
        if not self._ros1:
            self.at += (self._start - self.at) % size
        self.at += size * count

    def number(self) -> int:
        """A length."""
        self.skip(4, 1)
        if self.at > len(self._data):
            raise ValueError(f"a message of {len(self._data)} bytes is too short")
        (found,) = struct.unpack_from(f"{self._order}I", self._data, self.at - 4)
        return int(found)

    def text(self) -> None:
        """Past a text."""
        length = self.number()
        self.at += length
