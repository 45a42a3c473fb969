"""Losing, delaying, repeating and reordering messages on purpose, slow radios, and agents that come late, leave or
cannot be reached for a while: everything drawn from the seed, in the order in which messages are sent."""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..config import FaultsConfig
from .transport import HandedOver, Sent, Transport

# A message out of order falls behind at most so many others that were sent later.
_BEHIND = 16


@dataclass(frozen=True, order=True)
class _HeldMessage:
    """An encoded message on its way: when it is ``due``, its ``place`` among those due at once, and its ``number``."""

    due_ns: int
    place: int
    number: int
    sender: int
    recipient: int
    data: bytes


class FaultyTransport(Transport):
    """Any transport, made worse. What is sent counts as sent, whether it arrives or not. ``lost``, ``doubled``: how
    many messages that befell; those from and to agents that are not there are lost too. ``lost_bytes``: of the lost
    ones."""

    def __init__(
        self, inner: Transport, config: FaultsConfig, seed: int, record: Callable[[Sent], None] | None = None
    ) -> None:
        super().__init__(inner.max_message_bytes, record)
        self.inner = inner
        self.config = config
        self.lost = self.doubled = self.lost_bytes = 0
        self._rng = np.random.default_rng([seed, 0xFA])
        self._now_ns = 0
        self._number = 0
        self._held: list[_HeldMessage] = []
        self._radio_free_ns: dict[int, int] = {}

    def carry(self, sender: int, recipient: int, data: bytes) -> None:
        # Always the same number of draws a message, so that one setting does not change what another one does.
        lost, doubled, disorder, *late = self._rng.random(5)
        config = self.config
        sent_ns = self._transmitted_ns(sender, len(data))
        if lost < config.loss or not reachable(config, sender, self._now_ns):
            self._lose(data)
            return
        behind = 1 + int(disorder / config.reorder * _BEHIND) if disorder < config.reorder else 0
        copies = 1 + (doubled < config.duplicate)
        self.doubled += copies - 1
        for drawn in late[:copies]:
            due = sent_ns + round((config.delay_s + config.jitter_s * drawn) * 1e9)
            held = _HeldMessage(due, self._number + behind, self._number, sender, recipient, data)
            heapq.heappush(self._held, held)
            self._number += 1

    def arrive(self) -> HandedOver | None:
        while self._held and self._held[0].due_ns <= self._now_ns:
            held = heapq.heappop(self._held)
            if reachable(self.config, held.recipient, self._now_ns):
                self.inner.carry(held.sender, held.recipient, held.data)
                break
            self._lose(held.data)
        return self.inner.arrive()

    def _lose(self, data: bytes) -> None:
        self.lost += 1
        self.lost_bytes += len(data)

    def advance(self, now_ns: int) -> None:
        self._now_ns = now_ns
        self.inner.advance(now_ns)

    def _transmitted_ns(self, sender: int, length: int) -> int:
        """When the last bit of a message of so many bytes has left the sender's radio, whether it arrives or not."""
        if self.config.rate_kbit is None:
            return self._now_ns
        begins_ns = max(self._now_ns, self._radio_free_ns.get(sender, 0))
        self._radio_free_ns[sender] = begins_ns + round(8e6 * length / self.config.rate_kbit)
        return self._radio_free_ns[sender]

    @property
    def waiting(self) -> bool:
        return bool(self._held) or self.inner.waiting


def present(config: FaultsConfig, agent: int, now_ns: int) -> bool:
    """Whether an agent is there at this time: it came already and has not left."""
    joins, leaves = config.late_s.get(agent, 0.0), config.leave_s.get(agent)
    return now_ns >= round(joins * 1e9) and (leaves is None or now_ns < round(leaves * 1e9))


def reachable(config: FaultsConfig, agent: int, now_ns: int) -> bool:
    """Whether messages from and to an agent can arrive: it is there, and not cut off for a while."""
    from_s = config.blackout_s.get(agent)
    if from_s is None or not present(config, agent, now_ns):
        return present(config, agent, now_ns)
    return not round(from_s * 1e9) <= now_ns < round((from_s + config.blackout_for_s) * 1e9)


def gone(config: FaultsConfig, agent: int, now_ns: int) -> bool:
    """Whether an agent has left for good."""
    leaves = config.leave_s.get(agent)
    return leaves is not None and now_ns >= round(leaves * 1e9)
