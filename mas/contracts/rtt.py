"""How long to wait for an answer before a word is said again: as long as answers take, and no shorter than set."""

from __future__ import annotations

from collections import deque

from ..config import LinkConfig

# Answers that count, and how much longer than the quickest of them to wait.
_ANSWERS = 8
_PATIENCE = 1.5


class RttEstimator:
    """The quickest of the last answers of each other agent. A lost word makes an answer late, never early: so the
    quickest one tells what a word there and back takes."""

    def __init__(self, config: LinkConfig) -> None:
        self.config = config
        self._took: dict[int, deque[int]] = {}

    def answered(self, other: int, took_ns: int) -> None:
        """An answer came so long after the word was said first."""
        self._took.setdefault(other, deque(maxlen=_ANSWERS)).append(took_ns)

    def wait_ns(self, other: int, tries: int = 0) -> int:
        """Until the word is said again that was said again ``tries`` times already: twice as long each time."""
        first = max(self.config.repeat_s * 1e9, _PATIENCE * min(self._took.get(other, (0,))))
        return round(min(first * 2**tries, max(first, self.config.repeat_max_s * 1e9)))
