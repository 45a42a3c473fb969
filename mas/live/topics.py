"""Topics of a live agent that others can read: its current pose in the team's frame, and the team's map as it has it.

Whoever has a certificate of the team can listen; the agent knows nobody of them. So each sample is signed by the agent
(ECDSA with the key of its certificate). Bodies are MessagePack arrays with bounds; numbers in bytes are little-endian.
A sample's number grows within a process, ``began_ns`` from process to process of one agent.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated

import msgspec
import numpy as np
from numpy.typing import NDArray

from ..errors import MasError
from ..protocol.ids import FrameId, Index, Members, Stamp
from .team_pose import TeamMap, TeamPose

PART_POINTS = 2000
MOST_PARTS = 250
"""Of a map; it travels in parts of at most 28 kB. One with more points is thinned evenly."""
_SIGNED_TOPIC = b"maslam topic 1"
_HEAD = struct.Struct("<IqQ")
_ROTATION_TOLERANCE = 1e-6
_LARGEST_M = 1e9
_Bounded = Annotated[float, msgspec.Meta(ge=-_LARGEST_M, le=_LARGEST_M)]
_Pose = Annotated[tuple[_Bounded, ...], msgspec.Meta(min_length=12, max_length=12)]


class TopicError(MasError):
    """A sample that cannot be read, or that nobody of the team signed."""


class LiveTopic(StrEnum):
    """Last word but one of a key expression: ``maslam/TEAM/pose/3`` is agent 3's."""

    POSE = "pose"
    MAP = "map"


def topics_named(names: Collection[str]) -> frozenset[LiveTopic]:
    """The topics of these names; :class:`TopicError` where there is none of a name."""
    known = [topic.value for topic in LiveTopic]
    wrong = [name for name in names if name not in known]
    if wrong:
        raise TopicError(f"no topic {wrong[0]!r}: only {', '.join(known)}")
    return frozenset(LiveTopic(name) for name in names)


class TopicSample(msgspec.Struct, frozen=True, array_like=True):
    """What travels. ``certificate``: the agent's (DER), in some samples only; ``signature``: over all but it."""

    began_ns: Stamp
    number: Index
    body: Annotated[bytes, msgspec.Meta(max_length=64 * 1024)]
    signature: Annotated[bytes, msgspec.Meta(max_length=128)]
    certificate: Annotated[bytes, msgspec.Meta(max_length=8192)] = b""

    def digest(self, topic: LiveTopic, agent: int) -> bytes:
        """32 bytes that stand for what the agent says on this topic."""
        head = _HEAD.pack(agent, self.began_ns, self.number)
        return hashlib.blake2b(_SIGNED_TOPIC + topic.encode() + head + self.body, digest_size=32).digest()


class PoseBody(msgspec.Struct, frozen=True, array_like=True):
    """``T_F_C``: upper three rows one after the other, camera to ``frame``; the rest as in
    :class:`~.team_pose.TeamPose`."""

    stamp_ns: Stamp
    T_F_C: _Pose
    frame: FrameId
    members: Members
    metric: bool


class MapPartBody(msgspec.Struct, frozen=True, array_like=True):
    """Part ``part`` of ``parts`` of version ``version`` of a map of ``total`` points before it was thinned. ``points``:
    float32 x, y, z in ``frame``; ``owners``: uint16 numbers of agents."""

    version: Index
    part: Annotated[int, msgspec.Meta(ge=0, lt=MOST_PARTS)]
    parts: Annotated[int, msgspec.Meta(ge=1, le=MOST_PARTS)]
    total: Index
    frame: FrameId
    points: Annotated[bytes, msgspec.Meta(max_length=12 * PART_POINTS)]
    owners: Annotated[bytes, msgspec.Meta(max_length=2 * PART_POINTS)]


@dataclass(frozen=True, eq=False)
class MapPart:
    """A part that was read: ``points`` ``(n, 3)``, ``owners`` ``(n,)``."""

    version: int
    part: int
    parts: int
    total: int
    frame: FrameId
    points: NDArray[np.float32]
    owners: NDArray[np.int32]


_samples = msgspec.msgpack.Decoder(TopicSample)
_poses = msgspec.msgpack.Decoder(PoseBody)
_parts = msgspec.msgpack.Decoder(MapPartBody)


def encode_pose(pose: TeamPose) -> bytes:
    """The body of a pose."""
    rows = tuple(pose.T_F_C[:3].ravel().tolist())
    return msgspec.msgpack.encode(PoseBody(pose.stamp_ns, rows, pose.frame, tuple(sorted(pose.members)), pose.metric))


def decode_pose(data: bytes) -> TeamPose:
    """The pose in a body; :class:`TopicError` where there is none."""
    try:
        body = _poses.decode(data)
    except msgspec.MsgspecError as error:
        raise TopicError(f"a pose that cannot be read: {error}") from error
    T_F_C = np.eye(4)
    T_F_C[:3] = np.reshape(body.T_F_C, (3, 4))
    rotation = T_F_C[:3, :3]
    if not np.allclose(rotation @ rotation.T, np.eye(3), atol=_ROTATION_TOLERANCE) or np.linalg.det(rotation) < 0:
        raise TopicError("a pose whose rotation is none")
    return TeamPose(body.stamp_ns, T_F_C, body.frame, frozenset(body.members), body.metric)


def encode_map(whole: TeamMap, version: int) -> Iterator[bytes]:
    """The bodies of a map's parts."""
    total = len(whole.points)
    most = PART_POINTS * MOST_PARTS
    kept = np.arange(total) if total <= most else np.linspace(0, total - 1, most).astype(np.int64)
    points = np.ascontiguousarray(whole.points[kept], dtype="<f4")
    owners = np.ascontiguousarray(whole.owners[kept], dtype="<u2")
    parts = max(-(-len(kept) // PART_POINTS), 1)
    for part in range(parts):
        rows = slice(part * PART_POINTS, (part + 1) * PART_POINTS)
        body = MapPartBody(version, part, parts, total, whole.frame, points[rows].tobytes(), owners[rows].tobytes())
        yield msgspec.msgpack.encode(body)


def decode_map_part(data: bytes) -> MapPart:
    """The part in a body; :class:`TopicError` where there is none."""
    try:
        body = _parts.decode(data)
    except msgspec.MsgspecError as error:
        raise TopicError(f"a part of a map that cannot be read: {error}") from error
    count = len(body.owners) // 2
    if body.part >= body.parts or len(body.points) != 12 * count or len(body.owners) != 2 * count:
        raise TopicError(f"part {body.part} of {body.parts} of a map: {len(body.points)} and {len(body.owners)} bytes")
    points = np.frombuffer(body.points, dtype="<f4").reshape(-1, 3).astype(np.float32)
    if not np.isfinite(points).all():
        raise TopicError("a part of a map with points that are nowhere")
    owners = np.frombuffer(body.owners, dtype="<u2").astype(np.int32)
    return MapPart(body.version, body.part, body.parts, body.total, body.frame, points, owners)


def decode_sample(data: bytes) -> TopicSample:
    """What stands in the bytes of a sample; :class:`TopicError` where nothing does."""
    try:
        return _samples.decode(data)
    except msgspec.MsgspecError as error:
        raise TopicError(f"a sample that cannot be read: {error}") from error
