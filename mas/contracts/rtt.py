"""Retransmission timeout from recent round-trip times, and no shorter than set."""

from __future__ import annotations

from collections import deque

from ..config import LinkConfig

# Answers that count, and how much longer than the quickest of them to wait.
_ANSWERS = 8
_PATIENCE = 1.5


class RttEstimator:
    """The quickest of the last answers of each other agent. A lost message makes an answer late, never early: so the
    quickest one is the best estimate of the round-trip time."""

    def __init__(self, config: LinkConfig) -> None:
        self.config = config
        self._took: dict[int, deque[int]] = {}

    def answered(self, other: int, took_ns: int) -> None:
        """An answer came ``took_ns`` after the message was sent first."""
        self._took.setdefault(other, deque(maxlen=_ANSWERS)).append(took_ns)

    def wait_ns(self, other: int, tries: int = 0) -> int:
        """Timeout, ns, of a message that was sent again ``tries`` times already: twice as long each time."""
        first = max(self.config.repeat_s * 1e9, _PATIENCE * min(self._took.get(other, (0,))))
        return round(min(first * 2**tries, max(first, self.config.repeat_max_s * 1e9)))
