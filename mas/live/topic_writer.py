"""An agent's topics as it gives them out: signed, and only while somebody listens."""

from __future__ import annotations

import time
from collections import deque

import msgspec

from ..transport.link import Link
from .credentials import Credentials
from .team_pose import TeamMap, TeamPose
from .topics import LiveTopic, TopicSample, encode_map, encode_pose

_CERTIFICATE_EACH_S = 1.0


class _Stream:
    """The samples of one topic, for one thread."""

    def __init__(self, topic: LiveTopic, credentials: Credentials, link: Link, began_ns: int) -> None:
        self.topic = topic
        self.sent_bytes = 0
        self._credentials, self._link, self._began_ns = credentials, link, began_ns
        self._number = 0
        self._shown_s: float | None = None

    @property
    def wanted(self) -> bool:
        """Whether somebody listens."""
        return self._link.listened_to(self.topic)

    def put(self, body: bytes) -> None:
        """Sign and send a body. The certificate goes along once a second."""
        now_s = time.monotonic()
        shows = self._shown_s is None or now_s - self._shown_s >= _CERTIFICATE_EACH_S
        sample = TopicSample(self._began_ns, self._number, body, b"")
        signature = self._credentials.sign(sample.digest(self.topic, self._credentials.number))
        certificate = self._credentials.certificate if shows else b""
        data = msgspec.msgpack.encode(msgspec.structs.replace(sample, signature=signature, certificate=certificate))
        self._number += 1
        self._shown_s = now_s if shows else self._shown_s
        self.sent_bytes += len(data)
        self._link.publish(self.topic, data)


class TopicWriter:
    """``topics``: those that are given out. ``pose`` is for one thread, and the rest for one, too. A map is given out
    when it has changed, ``map_each_s`` after the one before at the earliest, a part at each call of
    :meth:`next_part`."""

    def __init__(self, topics: frozenset[LiveTopic], credentials: Credentials, link: Link, map_each_s: float) -> None:
        began_ns = time.time_ns()
        self._streams = {topic: _Stream(topic, credentials, link, began_ns) for topic in sorted(topics)}
        self._map_each_s = map_each_s
        self._map_s: float | None = None
        self._changes: int | None = None
        self._version = 0
        self._parts: deque[bytes] = deque()

    @property
    def sent_bytes(self) -> int:
        """Of all samples, with signatures and certificates."""
        return sum(stream.sent_bytes for stream in self._streams.values())

    def pose(self, pose: TeamPose) -> None:
        """Give the current pose out, if somebody listens."""
        stream = self._streams.get(LiveTopic.POSE)
        if stream is not None and stream.wanted:
            stream.put(encode_pose(pose))

    def wants_map(self, changes: int) -> bool:
        """Whether :meth:`map` should be called: somebody listens, and ``changes``, how often it has changed, is another
        number than last time."""
        stream = self._streams.get(LiveTopic.MAP)
        if stream is None or self._parts or changes == self._changes or not stream.wanted:
            return False
        return self._map_s is None or time.monotonic() - self._map_s >= self._map_each_s

    def map(self, whole: TeamMap, changes: int) -> None:
        """Begin to give a map out."""
        self._parts.extend(encode_map(whole, self._version))
        self._version += 1
        self._changes, self._map_s = changes, time.monotonic()

    def next_part(self) -> None:
        """Give the next part of the latest map out, if there is one."""
        if self._parts:
            self._streams[LiveTopic.MAP].put(self._parts.popleft())
