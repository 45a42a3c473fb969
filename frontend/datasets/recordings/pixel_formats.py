"""Pixels of ROS image messages (sensor_msgs), by the name of their encoding."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...errors import FrontendError

_MOST_PIXELS = 1 << 28
_PNG = b"\x89PNG\r\n\x1a\n"
_DEPTH_HEAD = 12  # of compressedDepth: an enumeration and two floats
_UNKNOWN_DEPTH = 65535
DEPTH_ENCODINGS = frozenset({"16UC1", "32FC1"})


@dataclass(frozen=True)
class _Encoding:
    """``channels`` of numbers of type ``dtype``; ``conversion``: OpenCV's, to BGR; None where it is grey or BGR."""

    dtype: str
    channels: int
    conversion: int | None = None


def _bayer(dtype: str, bits: int) -> dict[str, _Encoding]:
    """OpenCV names a mosaic by its second row's second and third pixel, ROS by the first two rows."""
    return {
        f"bayer_rggb{bits}": _Encoding(dtype, 1, cv2.COLOR_BayerBG2BGR),
        f"bayer_bggr{bits}": _Encoding(dtype, 1, cv2.COLOR_BayerRG2BGR),
        f"bayer_gbrg{bits}": _Encoding(dtype, 1, cv2.COLOR_BayerGR2BGR),
        f"bayer_grbg{bits}": _Encoding(dtype, 1, cv2.COLOR_BayerGB2BGR),
    }


_ENCODINGS: dict[str, _Encoding] = {
    "mono8": _Encoding("u1", 1),
    "8UC1": _Encoding("u1", 1),
    "bgr8": _Encoding("u1", 3),
    "8UC3": _Encoding("u1", 3),
    "rgb8": _Encoding("u1", 3, cv2.COLOR_RGB2BGR),
    "bgra8": _Encoding("u1", 4, cv2.COLOR_BGRA2BGR),
    "8UC4": _Encoding("u1", 4, cv2.COLOR_BGRA2BGR),
    "rgba8": _Encoding("u1", 4, cv2.COLOR_RGBA2BGR),
    "mono16": _Encoding("u2", 1),
    "16UC1": _Encoding("u2", 1),
    "bgr16": _Encoding("u2", 3),
    "rgb16": _Encoding("u2", 3, cv2.COLOR_RGB2BGR),
    "32FC1": _Encoding("f4", 1),
    "yuv422": _Encoding("u1", 2, cv2.COLOR_YUV2BGR_UYVY),
    "uyvy": _Encoding("u1", 2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422_yuy2": _Encoding("u1", 2, cv2.COLOR_YUV2BGR_YUY2),
    "yuyv": _Encoding("u1", 2, cv2.COLOR_YUV2BGR_YUY2),
    **_bayer("u1", 8),
    **_bayer("u2", 16),
}


def raw_pixels(message: Any, name: object) -> NDArray[Any]:
    """``(H, W)`` or ``(H, W, 3)`` BGR, uint8, uint16 or float32, of a ``sensor_msgs/Image``. :class:`FrontendError`
    that names the image for an encoding that is not known, or too few bytes."""
    encoding = _ENCODINGS.get(message.encoding)
    if encoding is None:
        raise FrontendError(f"{name}: pixels encoded as {message.encoding!r}, which is not read ({_known()})")
    width, height, step = int(message.width), int(message.height), int(message.step)
    dtype = np.dtype((">" if message.is_bigendian else "<") + encoding.dtype)
    row = width * encoding.channels * dtype.itemsize
    if not 0 < width * height <= _MOST_PIXELS or step < row or len(message.data) < step * (height - 1) + row:
        raise FrontendError(
            f"{name}: {len(message.data)} bytes in rows of {step} are no image of {width}x{height} {message.encoding}"
        )
    rows = np.zeros(step * height, dtype=np.uint8)
    given = np.frombuffer(message.data, dtype=np.uint8)[: step * height]
    rows[: len(given)] = given
    pixels = np.ascontiguousarray(rows.reshape(height, step)[:, :row]).view(dtype)
    pixels = pixels.reshape(height, width, encoding.channels) if encoding.channels > 1 else pixels
    pixels = pixels.astype(dtype.newbyteorder("="), copy=False)
    return pixels if encoding.conversion is None else cv2.cvtColor(pixels, encoding.conversion)


def _known() -> str:
    return ", ".join(sorted(name for name in _ENCODINGS if not name.startswith("bayer"))) + ", bayer_*"


def depth_metres(pixels: NDArray[Any], unit_m: float, name: object) -> NDArray[np.float32]:
    """``(H, W)`` float32 metres, 0 = unknown, of depth in steps of ``unit_m`` (uint16) or in metres (float32)."""
    if pixels.ndim != 2 or pixels.dtype not in (np.uint16, np.float32):
        channels = 1 if pixels.ndim == 2 else pixels.shape[2]
        raise FrontendError(
            f"{name}: a depth image has one channel of 16 bits, or of 32-bit floats, found {channels} of "
            f"{pixels.dtype.itemsize * 8} bits"
        )
    if pixels.dtype == np.float32:
        return np.where(np.isfinite(pixels) & (pixels > 0), pixels, np.float32(0.0)).astype(np.float32)
    depth = pixels.astype(np.float32) * np.float32(unit_m)
    depth[pixels == _UNKNOWN_DEPTH] = 0.0
    return depth


def compressed_depth(message: Any, name: object) -> NDArray[Any]:
    """Depth, uint16 steps or float32 metres, of a ``compressedDepth`` message: a head, then a PNG of 16 bits, which for
    metres holds the inverse depth in steps (compressed_depth_image_transport)."""
    data = bytes(message.data)
    if data[_DEPTH_HEAD : _DEPTH_HEAD + len(_PNG)] != _PNG:
        raise FrontendError(f"{name}: depth compressed as {message.format!r}, of which only png is read")
    steps = cv2.imdecode(np.frombuffer(data[_DEPTH_HEAD:], dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if steps is None or steps.dtype != np.uint16 or steps.ndim != 2:
        raise FrontendError(f"{name}: the PNG of 16 bits in it is damaged")
    if not str(message.format).startswith("32FC1"):
        return steps
    a, b = np.frombuffer(data[4:_DEPTH_HEAD], dtype="<f4").astype(np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(steps > 0, a / (steps - b), 0.0).astype(np.float32)
