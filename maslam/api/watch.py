"""Whoever listens to a team: current poses and maps of its live agents."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Literal

from maslam.mas.live.credentials import Credentials
from maslam.mas.live.topic_reader import AgentMap, AgentPose, TopicReader
from maslam.mas.live.topics import LiveTopic, topics_named
from maslam.mas.transport.zenoh_link import LinkAddresses
from maslam.mas.transport.zenoh_topics import ZenohTopics

from .common import PathLike


class Watch:
    """Listens to agents that were started with ``--publish``::

        with maslam.Watch("keys/agent_09", connect=["tls/192.168.1.10:7447"]) as watch:
            while True:
                one = watch.next(10.0)
                if isinstance(one, maslam.AgentPose):
                    print(one.agent, one.pose.frame, one.pose.T_F_C)

    Each is proven to be of the agent that it names. Agents do not notice who listens, and wait for nobody.

    Args:
        credentials: a folder that ``maslam keys`` made for the team; the agent of that name may run, too.
        listen, connect: addresses, as ``maslam agent`` takes them; one agent that is reached is enough.
        topics: of ``pose`` and ``map``, what to listen to.

    Raises:
        MaslamError: no such credentials, an address that cannot be used, no such topic.
    """

    def __init__(
        self,
        credentials: PathLike,
        *,
        listen: Sequence[str] = (),
        connect: Sequence[str] = (),
        topics: Sequence[Literal["pose", "map"]] = ("pose", "map"),
    ) -> None:
        wanted = sorted(topics_named(topics))
        mine = Credentials(Path(credentials))
        self._reader = TopicReader(mine)
        self._topics = ZenohTopics(mine.team, LinkAddresses(listen, connect, Path(credentials)), wanted)

    def __enter__(self) -> Watch:
        self._topics.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._topics.__exit__(kind, error, trace)

    def next(self, wait_s: float = 1.0) -> AgentPose | AgentMap | None:
        """The next pose or map that came; None when there is none after ``wait_s``, seconds, or only what is not
        believed."""
        until_s = time.monotonic() + wait_s
        while (came := self._topics.receive(max(until_s - time.monotonic(), 0.0))) is not None:
            found = self._reader.take(LiveTopic(came.topic), came.agent, came.data)
            if found is not None or time.monotonic() >= until_s:
                return found
        return None

    @property
    def dropped(self) -> int:
        """Samples that came faster than :meth:`next` took them, the newest ones."""
        return self._topics.dropped

    @property
    def refused(self) -> int:
        """Samples that were not believed: another's signature, a revoked certificate, damaged."""
        return self._reader.refused

    @property
    def reason(self) -> str:
        """Why the last of them was not; empty if there was none."""
        return self._reader.reason
