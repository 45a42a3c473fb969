"""Retransmission timeout from recent round-trip times, and no shorter than set.

An answer to a message that was sent once tells how long answers take (Karn and Partridge, SIGCOMM 1987): their mean and
four times their mean deviation is the timeout, as TCP's (RFC 6298). Until there is one, the quickest of the other
answers has to do: a lost message makes an answer late, never early. Where there are too few of those either, the
quickest answer of any agent is taken: one that was late by bad luck would make this agent wait for seconds.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

from ..config import LinkConfig

# Answers that count; deviations beyond their mean that an answer may take; and how much longer than the quickest answer
# to wait where none is sure.
_ANSWERS, _DEVIATIONS = 8, 4.0
_PATIENCE, _FEW = 1.5, 3
# And no longer than so many of the quickest answers: one that met a queue says little of the next.
_MOST = 3.0
# Quickest answers that a small question waits for.
_IN_DOUBT = 2.0
# A repeat was in vain if the answer came after less than this share of the quickest one.
_IN_VAIN = 0.8
# The wait grows to so many times the first one where answers take longer than the longest that is set.
_LONGEST = 2.0


class RttEstimator:
    """The last answers of each other agent."""

    def __init__(self, config: LinkConfig) -> None:
        self.config = config
        self._took: dict[int, deque[int]] = {}
        self._surely: dict[int, deque[int]] = {}

    def answered(self, other: int, now_ns: int, sent_ns: Sequence[int]) -> None:
        """An answer came now to a message that was sent at these times, the first one first. Where no answer ever came
        so soon after the last of them, it answers an earlier one: that repeat was in vain, and tells nothing."""
        soonest = _IN_VAIN * min(self._surely.get(other, ()), default=0)
        answered = next((at for at in reversed(sent_ns) if now_ns - at >= soonest), sent_ns[0])
        surely = len(sent_ns) == 1 or answered < sent_ns[-1]
        kept = self._surely if surely else self._took
        kept.setdefault(other, deque(maxlen=_ANSWERS)).append(now_ns - (answered if surely else sent_ns[0]))

    def wait_ns(self, other: int, tries: int = 0) -> int:
        """Timeout, ns, of a message that was sent again ``tries`` times already: twice as long each time."""
        return self._backed_off(self._answer_ns(other), tries)

    def ask_ns(self, other: int, tries: int = 0) -> int:
        """The same for a question of a few bytes with an answer of a few bytes, which costs little where that is only
        late: twice as long as the quickest answer takes."""
        quickest = min(self._surely.get(other, ()), default=0)
        return self._backed_off(_IN_DOUBT * quickest or self._answer_ns(other), tries)

    def _backed_off(self, answer_ns: float, tries: int) -> int:
        first = max(self.config.repeat_s * 1e9, answer_ns)
        return round(min(first * 2**tries, max(_LONGEST * first, self.config.repeat_max_s * 1e9)))

    @property
    def slowest_ns(self) -> int:
        """The longest timeout of all agents that have answered."""
        return max((self.wait_ns(other) for other in {*self._took, *self._surely}), default=0)

    def _answer_ns(self, other: int) -> float:
        """How long an answer may take."""
        surely = self._surely.get(other)
        if not surely:
            took = list(self._took.get(other, ()))
            if len(took) < _FEW:
                took = [t for kept in (*self._took.values(), *self._surely.values()) for t in kept]
            return _PATIENCE * min(took, default=0)
        mean = sum(surely) / len(surely)
        waits = mean + _DEVIATIONS * sum(abs(took - mean) for took in surely) / len(surely)
        return min(waits, max(_MOST * min(surely), float(self.config.repeat_max_s * 1e9)))
