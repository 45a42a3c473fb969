"""Films and bags with known content, written by OpenCV and rosbags; nothing here reads through the code under test."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

IMAGE, COMPRESSED, INFO = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
TRANSFORMS = "tf2_msgs/msg/TFMessage"
VIDEO, PACKET = "foxglove_msgs/msg/CompressedVideo", "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
_OTHER_TYPES = {
    TRANSFORMS: "geometry_msgs/TransformStamped[] transforms\n",
    VIDEO: "builtin_interfaces/Time timestamp\nstring frame_id\nuint8[] data\nstring format\n",
    PACKET: "std_msgs/Header header\nint32 width\nint32 height\nstring encoding\nuint64 pts\nuint8 flags\n"
    "bool is_bigendian\nuint8[] data\n",
    "theora_image_transport/msg/Packet": "std_msgs/Header header\nuint8[] data\nint32 b_o_s\n",
}
POSE = "geometry_msgs/msg/PoseStamped"


def write_film(path: Path, images: Iterable[NDArray[np.uint8]], rate_hz: float = 10.0, codec: str = "mp4v") -> None:
    """Grey or BGR images as a film; MJPG keeps them nearly as they are."""
    writer = None
    for image in images:
        colour = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
        if writer is None:
            size = (colour.shape[1], colour.shape[0])
            writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), rate_hz, size, True)
            assert writer.isOpened()
        writer.write(colour)
    assert writer is not None
    writer.release()


def turn_film(path: Path, degrees: int) -> None:
    """Set the flag of an mp4 by which players turn it clockwise, as phones do (ISO 14496-12, track header)."""
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40  # version and flags, times, track, duration, layer, volume
    cos, sin = {90: (0, 1), 180: (-1, 0), 270: (0, -1)}[degrees]
    one = 1 << 16
    matrix = (cos * one, sin * one, 0, -sin * one, cos * one, 0, 0, 0, 1 << 30)
    data[at : at + 36] = struct.pack(">9i", *matrix)
    path.write_bytes(bytes(data))


def retime_film(path: Path, durations: Sequence[int]) -> None:
    """Give each frame of an mp4 a duration of its own, in units of the shortest (ISO 14496-12, stts): a variable rate,
    as phones write it."""
    data = path.read_bytes()
    at = data.index(b"stts") - 4
    size, entries = struct.unpack_from(">I", data, at)[0], struct.unpack_from(">I", data, at + 12)[0]
    count, step = struct.unpack_from(">II", data, at + 16)
    assert entries == 1 and count == len(durations)
    table = struct.pack(">II", 0, len(durations)) + b"".join(struct.pack(">II", 1, step * d) for d in durations)
    grown = 8 + len(table) - size
    new = bytearray(data[:at] + struct.pack(">I", 8 + len(table)) + b"stts" + table + data[at + size :])
    for name in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        box = data.index(name) - 4
        struct.pack_into(">I", new, box, struct.unpack_from(">I", data, box)[0] + grown)
    assert data.index(b"moov") > data.index(b"mdat")  # so that frames stay where they are
    edits = new.find(b"edts")  # which end where the film ended before
    if edits >= 0:
        new[edits : edits + 4] = b"free"
    path.write_bytes(bytes(new))


@dataclass(frozen=True)
class Channel:
    """A topic to be written: ``make(store, i)`` gives message i; ``received_ns`` when each was recorded."""

    topic: str
    type: str
    received_ns: Sequence[int]
    make: Callable[[Any, int], Any]


def header(store: Any, stamp_ns: int, frame: str = "camera") -> Any:
    time = store.types["builtin_interfaces/msg/Time"](sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    kind = store.types["std_msgs/msg/Header"]
    return (
        kind(seq=0, stamp=time, frame_id=frame) if "seq" in kind.__annotations__ else kind(stamp=time, frame_id=frame)
    )


def image_message(store: Any, stamp_ns: int, pixels: NDArray[Any], encoding: str) -> Any:
    raw = np.ascontiguousarray(pixels)
    return store.types[IMAGE](
        header=header(store, stamp_ns),
        height=raw.shape[0],
        width=raw.shape[1],
        encoding=encoding,
        is_bigendian=0,
        step=raw.nbytes // raw.shape[0],
        data=np.frombuffer(raw.tobytes(), dtype=np.uint8),
    )


def compressed_message(store: Any, stamp_ns: int, data: bytes, form: str) -> Any:
    return store.types[COMPRESSED](
        header=header(store, stamp_ns), format=form, data=np.frombuffer(data, dtype=np.uint8)
    )


def video_message(store: Any, stamp_ns: int, data: bytes, coded: str, kind: str, frame: str = "camera") -> Any:
    raw, head = np.frombuffer(data, dtype=np.uint8), header(store, stamp_ns, frame)
    if kind == VIDEO:
        return store.types[VIDEO](timestamp=head.stamp, frame_id=frame, data=raw, format=coded)
    return store.types[PACKET](
        header=head, width=96, height=64, encoding=coded, pts=stamp_ns, flags=0, is_bigendian=False, data=raw
    )


def info_message(
    store: Any, stamp_ns: int, size: tuple[int, int], K: NDArray[Any], model: str = "plumb_bob",
    D: Sequence[float] = (0.0,) * 5, R: NDArray[Any] | None = None, P: NDArray[Any] | None = None,
    frame: str = "camera",
) -> Any:  # fmt: skip
    P = np.hstack([K, np.zeros((3, 1))]) if P is None else P
    values = {
        "k": np.asarray(K, dtype=np.float64).ravel(),
        "d": np.array(D, dtype=np.float64),
        "r": np.asarray(np.eye(3) if R is None else R, dtype=np.float64).ravel(),
        "p": np.asarray(P, dtype=np.float64).ravel(),
    }
    kind = store.types[INFO]
    if "K" in kind.__annotations__:
        values = {name.upper(): value for name, value in values.items()}
    region = store.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    return kind(
        header=header(store, stamp_ns, frame), height=size[1], width=size[0], distortion_model=model, binning_x=0,
        binning_y=0, roi=region, **values,
    )  # fmt: skip


def pose_message(store: Any, stamp_ns: int, pose: NDArray[np.float64]) -> Any:
    x, y, z, w = _quaternion(pose[:3, :3])
    kinds = store.types
    point = kinds["geometry_msgs/msg/Point"](*map(float, pose[:3, 3]))
    turn = kinds["geometry_msgs/msg/Quaternion"](x, y, z, w)
    return kinds[POSE](header=header(store, stamp_ns, "map"), pose=kinds["geometry_msgs/msg/Pose"](point, turn))


def transforms_message(store: Any, links: Sequence[tuple[str, str, NDArray[np.float64]]]) -> Any:
    """``links``: parent, child and ``T_parent_child``."""
    kinds, found = store.types, []
    for parent, child, pose in links:
        place = kinds["geometry_msgs/msg/Vector3"](*map(float, pose[:3, 3]))
        turn = kinds["geometry_msgs/msg/Quaternion"](*_quaternion(pose[:3, :3]))
        found.append(
            kinds["geometry_msgs/msg/TransformStamped"](
                header=header(store, 1, parent),
                child_frame_id=child,
                transform=kinds["geometry_msgs/msg/Transform"](translation=place, rotation=turn),
            )
        )
    return kinds[TRANSFORMS](transforms=found)


def known_store(store_name: Any) -> Any:
    """ROS's own types, and those of packages beside it."""
    from rosbags.typesys import get_types_from_msg, get_typestore

    store = get_typestore(store_name)
    for name, definition in _OTHER_TYPES.items():
        if name not in store.fielddefs:
            store.register(get_types_from_msg(definition, name))
    return store


def _quaternion(R: NDArray[np.float64]) -> tuple[float, float, float, float]:
    vector, _ = cv2.Rodrigues(R)
    angle = float(np.linalg.norm(vector))
    axis = vector.ravel() / angle if angle > 0 else np.zeros(3)
    x, y, z = np.sin(angle / 2) * axis
    return float(x), float(y), float(z), float(np.cos(angle / 2))


def _in_order(channels: Sequence[Channel]) -> list[tuple[int, int, int]]:
    return sorted((time, c, i) for c, channel in enumerate(channels) for i, time in enumerate(channel.received_ns))


def write_ros1(path: Path, channels: Sequence[Channel], compression: str = "") -> None:
    """``compression``: ``bz2`` or ``lz4``; empty for none."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores

    store = known_store(Stores.ROS1_NOETIC)
    writer = Writer(path)
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression.upper()])
    with writer:
        connections = [writer.add_connection(c.topic, c.type, typestore=store) for c in channels]
        for time, c, i in _in_order(channels):
            data = store.serialize_ros1(channels[c].make(store, i), channels[c].type)
            writer.write(connections[c], time, data)


def write_ros2(path: Path, channels: Sequence[Channel], storage: str = "sqlite3", compression: str = "") -> None:
    """``storage``: ``sqlite3`` or ``mcap``; ``compression``: ``message``, ``file``, or ``storage`` (mcap's own)."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores

    store = known_store(Stores.ROS2_HUMBLE)
    writer = Writer(path, version=9, storage_plugin=StoragePlugin[storage.upper()])
    if compression:
        writer.set_compression(CompressionMode[compression.upper()], CompressionFormat.ZSTD)
    with writer:
        connections = [writer.add_connection(c.topic, c.type, typestore=store) for c in channels]
        for time, c, i in _in_order(channels):
            data = store.serialize_cdr(channels[c].make(store, i), channels[c].type)
            writer.write(connections[c], time, data)
