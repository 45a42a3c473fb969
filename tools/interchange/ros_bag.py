"""A run as a ROS 2 bag in an MCAP file: for Foxglove, RViz, ``ros2 bag play``. No ROS is needed to write it.

/tf, /tf_static           map -> agent_00/odom -> agent_00/camera
/agent_00/pose            the camera in the map, at each placed frame
/agent_00/path            all of them, once, at its first frame; /agent_00/truth where it is known
/agent_00/points          its own map points, once
/agent_00/camera/…        camera_info and image/compressed of each placed frame, where images are wanted
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from maslam.backend.geometry import Array
from maslam.frontend.files.trajectory import NS_PER_S
from maslam.mas.manifest import CameraEntry

from ..common.errors import ToolError
from ..common.progress import Progress
from ..common.text_table import counted
from ..report.rerun_recording import own_points
from ..report.run_data import RunData
from .export_request import ExportRequest
from .frame_tree import FramePath, frame_paths
from .source_images import AgentImages, find_images
from .tf_files import frame_notes, xyz_xyzw
from .units import agent_records

BAG = "rosbag2"
_FLOAT32 = 7  # PointField


@dataclass(frozen=True)
class _Message:
    stamp_ns: int
    topic: str
    content: Any


def write_bag(
    folder: Path, data: RunData, members: Sequence[int], request: ExportRequest, tell: Progress
) -> tuple[list[str], dict[str, Any]]:
    """Write the bag ``rosbag2/``: ``rosbag2.mcap`` and ``metadata.yaml``. ``ToolError`` where rosbags is missing."""
    try:
        from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
        from rosbags.rosbag2 import StoragePlugin, Writer
        from rosbags.typesys import Stores, get_typestore
    except ModuleNotFoundError as error:
        raise ToolError("a recording needs rosbags: pip install 'maslam[bags]'") from error
    paths = frame_paths(data, members)
    if not paths:
        raise ToolError(f"{data.folder}: no frame has a place, so there is nothing to record")
    images = {}
    if request.with_images:
        images = find_images(data.manifest, request.images, request.readers, [path.agent for path in paths])
    store = get_typestore(Stores.ROS2_HUMBLE)
    forever = QosTime(2147483647, 4294967295)
    latched = Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL, forever, forever,
        QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip
    maker = _Maker(store.types, data)
    sources = [maker.messages(path, images.get(path.agent)) for path in paths]
    task, written = tell.start("messages", sum(maker.count(path, path.agent in images) for path in paths)), 0
    with Writer(folder / BAG, version=8, storage_plugin=StoragePlugin.MCAP) as bag:
        topics: dict[str, Any] = {}
        for message in _in_time(sources):
            kind = message.content.__msgtype__
            if message.topic not in topics:
                once = (latched,) if kind in _ONCE or message.topic == "/tf_static" else ()
                topics[message.topic] = bag.add_connection(
                    message.topic, kind, typestore=store, offered_qos_profiles=once
                )
            bag.write(topics[message.topic], message.stamp_ns, store.serialize_cdr(message.content, kind))
            written += 1
            tell.advance(task, written)
    line = f"{{out}}/{BAG}: {counted(written, 'message')} on {counted(len(topics), 'topic')}; Foxglove opens {BAG}.mcap"
    record = {"agents": agent_records(data, members), "messages": written, "topics": sorted(topics)}
    return [line, *frame_notes(data, members, paths)], record


_ONCE = {"nav_msgs/msg/Path", "sensor_msgs/msg/PointCloud2"}


def _in_time(sources: Sequence[Iterator[_Message]]) -> Iterator[_Message]:
    """All messages in order of time; images are made when their turn comes."""
    from heapq import merge

    return merge(*sources, key=lambda message: message.stamp_ns)


class _Maker:
    """Makes the messages of each agent, in order of time; ``types``: ROS's message classes by name."""

    def __init__(self, types: Any, data: RunData) -> None:
        self._types, self._data = types, data

    def count(self, path: FramePath, with_images: bool) -> int:
        """Messages of an agent."""
        frames = len(path.T_odom_camera)
        return 3 + (self._true(path) is not None) + frames * (4 if with_images else 2)

    def messages(self, path: FramePath, images: AgentImages | None) -> Iterator[_Message]:
        """Of one agent: what stands still at its first frame, then each frame."""
        agent = self._data.agents[path.agent]
        estimate, name = agent.estimate, agent.name
        first = int(estimate.stamps_ns[0])
        yield _Message(first, "/tf_static", self._tf(first, path.map, path.odom, xyz_xyzw(path.T_map_odom[None])[0]))
        poses = xyz_xyzw(estimate.poses)
        yield _Message(first, f"/{name}/path", self._path(path.map, estimate.stamps_ns.tolist(), poses, first))
        truth = self._true(path)
        if truth is not None and agent.truth is not None:
            yield _Message(first, f"/{name}/truth", self._path(path.map, agent.truth.stamps_ns.tolist(), truth, first))
        cloud = own_points(self._data.folder / name / "map.ply", path.agent)
        yield _Message(first, f"/{name}/points", self._cloud(first, path.map, cloud))
        rows = None if images is None else images.rows(estimate.stamps_ns)
        moving = xyz_xyzw(path.T_odom_camera.poses)
        for k, stamp in enumerate(estimate.stamps_ns.tolist()):
            yield _Message(stamp, "/tf", self._tf(stamp, path.odom, path.camera, moving[k]))
            yield _Message(stamp, f"/{name}/pose", self._pose(stamp, path.map, poses[k]))
            if images is not None and rows is not None:
                info = self._info(stamp, path.camera, self._data.manifest.agents[path.agent].camera)
                yield _Message(stamp, f"/{name}/camera/camera_info", info)
                image = self._image(stamp, path.camera, images, int(rows[k]))
                yield _Message(stamp, f"/{name}/camera/image/compressed", image)

    def _true(self, path: FramePath) -> Array | None:
        """True poses ``(n, 7)`` brought into the agent's map; None where it is not known how the two stand."""
        agent = self._data.agents[path.agent]
        if agent.truth is None or not len(agent.truth) or not self._data.is_aligned(path.agent):
            return None
        T_map_truth = self._data.T_world_agent[path.agent].inverse()
        poses = agent.truth.poses.copy()
        poses[:, :3, 3] = T_map_truth @ agent.truth.centres
        poses[:, :3, :3] = T_map_truth.rotation @ poses[:, :3, :3]
        return xyz_xyzw(poses)

    def _new(self, kind: str, *fields: Any) -> Any:
        return self._types[kind](*fields)

    def _header(self, stamp_ns: int, frame: str) -> Any:
        return self._new(
            "std_msgs/msg/Header", self._new("builtin_interfaces/msg/Time", *divmod(stamp_ns, NS_PER_S)), frame
        )

    def _tf(self, stamp_ns: int, parent: str, child: str, values: Array) -> Any:
        x, y, z, *q = values.tolist()
        moved = self._new(
            "geometry_msgs/msg/Transform",
            self._new("geometry_msgs/msg/Vector3", x, y, z),
            self._new("geometry_msgs/msg/Quaternion", *q),
        )
        one = self._new("geometry_msgs/msg/TransformStamped", self._header(stamp_ns, parent), child, moved)
        return self._new("tf2_msgs/msg/TFMessage", [one])

    def _pose(self, stamp_ns: int, frame: str, values: Array) -> Any:
        x, y, z, *q = values.tolist()
        pose = self._new(
            "geometry_msgs/msg/Pose",
            self._new("geometry_msgs/msg/Point", x, y, z),
            self._new("geometry_msgs/msg/Quaternion", *q),
        )
        return self._new("geometry_msgs/msg/PoseStamped", self._header(stamp_ns, frame), pose)

    def _path(self, frame: str, stamps_ns: Sequence[int], poses: Array, at_ns: int) -> Any:
        steps = [self._pose(stamp, frame, pose) for stamp, pose in zip(stamps_ns, poses, strict=True)]
        return self._new("nav_msgs/msg/Path", self._header(at_ns, frame), steps)

    def _cloud(self, stamp_ns: int, frame: str, points: Array) -> Any:
        fields = [self._new("sensor_msgs/msg/PointField", n, 4 * k, _FLOAT32, 1) for k, n in enumerate("xyz")]
        data = np.ascontiguousarray(points, dtype="<f4").view(np.uint8).reshape(-1)
        size = (1, len(points), fields, False, 12, 12 * len(points), data, True)
        return self._new("sensor_msgs/msg/PointCloud2", self._header(stamp_ns, frame), *size)

    def _info(self, stamp_ns: int, frame: str, c: CameraEntry) -> Any:
        K = np.array([c.fx, 0.0, c.cx, 0.0, c.fy, c.cy, 0.0, 0.0, 1.0])
        P = np.array([c.fx, 0.0, c.cx, 0.0, 0.0, c.fy, c.cy, 0.0, 0.0, 0.0, 1.0, 0.0])
        roi = self._new("sensor_msgs/msg/RegionOfInterest", 0, 0, 0, 0, False)
        head = (self._header(stamp_ns, frame), c.height, c.width, "plumb_bob", np.zeros(5))
        return self._new("sensor_msgs/msg/CameraInfo", *head, K, np.eye(3).ravel(), P, 0, 0, roi)

    def _image(self, stamp_ns: int, frame: str, images: AgentImages, row: int) -> Any:
        data, _ = images.encoded(row)
        kind = "png" if images.name(row).lower().endswith(".png") else "jpeg"
        pixels = np.frombuffer(data, dtype=np.uint8)
        return self._new("sensor_msgs/msg/CompressedImage", self._header(stamp_ns, frame), kind, pixels)
