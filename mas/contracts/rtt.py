"""Retransmission timeout from recent round-trip times, and no shorter than set.

An answer to a message that was sent once tells how long answers take (Karn and Partridge, SIGCOMM 1987): their mean and
four times their mean deviation is the timeout, as TCP's (RFC 6298). Until there is one, the quickest of the other
answers has to do: a lost message makes an answer late, never early. Where there are too few of those either, the
quickest answer of any agent is taken: one that was late by bad luck would make this agent wait for seconds.
"""

from __future__ import annotations

from collections import deque

from ..config import LinkConfig

# Answers that count; deviations beyond their mean that an answer may take; and how much longer than the quickest answer
# to wait where none is sure.
_ANSWERS, _DEVIATIONS = 8, 4.0
_PATIENCE, _FEW = 1.5, 3


class RttEstimator:
    """The last answers of each other agent."""

    def __init__(self, config: LinkConfig) -> None:
        self.config = config
        self._took: dict[int, deque[int]] = {}
        self._surely: dict[int, deque[int]] = {}

    def answered(self, other: int, took_ns: int, repeated: bool) -> None:
        """An answer came ``took_ns`` after the message was sent first; ``repeated``: it was sent again meanwhile."""
        kept = self._took if repeated else self._surely
        kept.setdefault(other, deque(maxlen=_ANSWERS)).append(took_ns)

    def wait_ns(self, other: int, tries: int = 0) -> int:
        """Timeout, ns, of a message that was sent again ``tries`` times already: twice as long each time."""
        first = max(self.config.repeat_s * 1e9, self._answer_ns(other))
        return round(min(first * 2**tries, max(first, self.config.repeat_max_s * 1e9)))

    def _answer_ns(self, other: int) -> float:
        """How long an answer may take."""
        surely = self._surely.get(other)
        if not surely:
            took = list(self._took.get(other, ()))
            if len(took) < _FEW:
                took = [t for kept in (*self._took.values(), *self._surely.values()) for t in kept]
            return _PATIENCE * min(took, default=0)
        mean = sum(surely) / len(surely)
        return mean + _DEVIATIONS * sum(abs(took - mean) for took in surely) / len(surely)
