"""Topics of a team's agents over Zenoh, for whoever listens."""

from __future__ import annotations

import queue
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Any

from .zenoh_link import LinkAddresses, close_session, number_of, open_session, root_of

_MOST_WAITING = 4096


@dataclass(frozen=True)
class TopicArrived:
    """Bytes that came on a topic, by their key of agent ``agent``."""

    topic: str
    agent: int
    data: bytes


class ZenohTopics:
    """``with ZenohTopics(team, addresses, ["pose"]) as topics``. ``dropped``: samples that came faster than they were
    received."""

    def __init__(self, team: str, addresses: LinkAddresses, topics: Sequence[str]) -> None:
        self.dropped = 0
        self._root, self._addresses, self._topics = root_of(team), addresses, topics
        self._arrivals: queue.Queue[TopicArrived] = queue.Queue(_MOST_WAITING)
        self._session: Any = None
        self._kept: list[Any] = []

    def __enter__(self) -> ZenohTopics:
        self._session = open_session(self._addresses)
        self._kept = [self._session.declare_subscriber(f"{self._root}/{t}/*", self._came) for t in self._topics]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for one in self._kept:
            one.undeclare()
        close_session(self._session)

    def receive(self, wait_s: float) -> TopicArrived | None:
        """What came next; None when nothing has after ``wait_s``, seconds."""
        try:
            return self._arrivals.get(timeout=wait_s) if wait_s > 0 else self._arrivals.get_nowait()
        except queue.Empty:
            return None

    def _came(self, sample: Any) -> None:
        key = str(sample.key_expr)
        agent, topic = number_of(key), key.split("/")[-2]
        if agent is None:
            return
        try:
            self._arrivals.put_nowait(TopicArrived(topic, agent, sample.payload.to_bytes()))
        except queue.Full:
            self.dropped += 1
