"""Links between agents in one process, which lose what a test wants to be lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from maslam.mas.transport.link import Arrived, Link, Presence


class MemoryNetwork:
    """``lost(sender, recipient, data)`` says what does not arrive; ``delay_s``: one way, by the clock ``now_s``."""

    def __init__(
        self,
        lost: Callable[[int, int, bytes], bool] = lambda sender, recipient, data: False,
        delay_s: float = 0.0,
        now_s: Callable[[], float] = lambda: 0.0,
    ) -> None:
        self.lost = lost
        self.delay_s, self.now_s = delay_s, now_s
        self._flying: deque[tuple[float, MemoryLink, Arrived]] = deque()
        self.sent: list[tuple[int, int, bytes]] = []
        self.links: list[MemoryLink] = []

    def link(self, me: int) -> MemoryLink:
        return MemoryLink(self, me)

    def join(self, link: MemoryLink) -> None:
        """A process is there: all others notice, and it notices them and itself, as over a real link."""
        self.links.append(link)
        for known in self.links:
            known.queue.append(Presence(link.me, True, link.process))
            if known is not link:
                link.queue.append(Presence(known.me, True, known.process))

    def leave(self, link: MemoryLink) -> None:
        self.links.remove(link)
        self.cut(link)

    def cut(self, link: MemoryLink) -> None:
        """The others no longer see it, whether it is there or not."""
        for known in self.links:
            if known is not link:
                known.queue.append(Presence(link.me, False, link.process))

    @staticmethod
    def seen(link: MemoryLink) -> Presence:
        """What the others get when it is there."""
        return Presence(link.me, True, link.process)

    def carry(self, sender: int, recipient: int, data: bytes) -> None:
        self.sent.append((sender, recipient, data))
        for link in self.links:
            if link.me == recipient and not self.lost(sender, recipient, data):
                self._flying.append((self.now_s() + self.delay_s, link, Arrived(sender, data)))
        self.deliver()

    def deliver(self) -> None:
        """What has been on its way for long enough arrives."""
        while self._flying and self._flying[0][0] <= self.now_s():
            _, link, arrived = self._flying.popleft()
            link.queue.append(arrived)


class MemoryLink(Link):
    def __init__(self, network: MemoryNetwork, me: int) -> None:
        self.network = network
        self.me = me
        self.process = ""
        self.queue: deque[Arrived | Presence] = deque()
        self.listened: set[str] = set()
        self.published: list[tuple[str, bytes]] = []

    def appear(self, process: str) -> None:
        self.process = process
        self.network.join(self)

    def send(self, other: int, data: bytes) -> None:
        self.network.carry(self.me, other, data)

    def receive(self, wait_s: float) -> Arrived | Presence | None:
        self.network.deliver()
        return self.queue.popleft() if self.queue else None

    def publish(self, topic: str, data: bytes) -> None:
        self.published.append((topic, data))

    def listened_to(self, topic: str) -> bool:
        return topic in self.listened

    @property
    def connected(self) -> bool:
        return len(self.network.links) > 1
