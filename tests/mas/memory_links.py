"""Links between agents in one process, which lose what a test wants to be lost."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from maslam.mas.transport.link import Arrived, Link, Presence


class MemoryNetwork:
    """``lost(sender, recipient, data)`` says what does not arrive."""

    def __init__(self, lost: Callable[[int, int, bytes], bool] = lambda sender, recipient, data: False) -> None:
        self.lost = lost
        self.sent: list[tuple[int, int, bytes]] = []
        self._links: dict[int, MemoryLink] = {}

    def link(self, me: int) -> MemoryLink:
        """A new agent is there: all others notice."""
        link = MemoryLink(self, me)
        for other, known in self._links.items():
            known.queue.append(Presence(me, True))
            link.queue.append(Presence(other, True))
        self._links[me] = link
        return link

    def leave(self, me: int) -> None:
        del self._links[me]
        for known in self._links.values():
            known.queue.append(Presence(me, False))

    def carry(self, sender: int, recipient: int, data: bytes) -> None:
        self.sent.append((sender, recipient, data))
        if recipient in self._links and not self.lost(sender, recipient, data):
            self._links[recipient].queue.append(Arrived(sender, data))


class MemoryLink(Link):
    def __init__(self, network: MemoryNetwork, me: int) -> None:
        self.network = network
        self.me = me
        self.queue: deque[Arrived | Presence] = deque()

    def send(self, other: int, data: bytes) -> None:
        self.network.carry(self.me, other, data)

    def receive(self, wait_s: float) -> Arrived | Presence | None:
        return self.queue.popleft() if self.queue else None

    @property
    def connected(self) -> bool:
        return len(self.network._links) > 1
