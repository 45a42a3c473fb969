"""Messages in transit on links of a given delay and rate, in logical time."""

from __future__ import annotations

import heapq
from dataclasses import dataclass


@dataclass(frozen=True)
class DueMessage:
    """Bytes that arrive at ``at_s``, seconds."""

    at_s: float
    data: bytes


class TimedLink:
    """Every robot has one radio, which sends one message after the other at ``rate_kbit`` kbit/s; each then takes
    ``delay_s`` seconds. Nothing is lost. Equal times: first sent, first delivered."""

    def __init__(self, delay_s: float, rate_kbit: float) -> None:
        self.messages = self.bytes_sent = 0
        self._delay_s, self._rate_kbit = delay_s, rate_kbit
        self._free_s: dict[int, float] = {}
        self._transit: list[tuple[float, int, bytes]] = []

    def send(self, sender: int, data: bytes, now_s: float) -> None:
        """Queue a message at its sender's radio."""
        begins = max(now_s, self._free_s.get(sender, 0.0))
        self._free_s[sender] = ends = begins + 8.0 * len(data) / (1000.0 * self._rate_kbit)
        self.messages, self.bytes_sent = self.messages + 1, self.bytes_sent + len(data)
        heapq.heappush(self._transit, (ends + self._delay_s, self.messages, data))

    def next(self) -> DueMessage | None:
        """The message that arrives next; None: there is none in transit."""
        if not self._transit:
            return None
        at_s, _, data = heapq.heappop(self._transit)
        return DueMessage(at_s, data)
