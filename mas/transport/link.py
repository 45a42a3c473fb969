"""A link to other agents on a real network: bytes for a number come and go; whose they are, only seals can prove."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass


@dataclass(frozen=True)
class Arrived:
    """Bytes that came, by their own word from agent ``sender``."""

    sender: int
    data: bytes


@dataclass(frozen=True)
class Presence:
    """Process ``process`` of agent ``other`` can be reached now, or cannot any more."""

    other: int
    here: bool
    process: str


class Link(ABC):
    """Carries bytes as they are, at most once each, in any order, or not at all."""

    @abstractmethod
    def appear(self, process: str) -> None:
        """Be there, for all others to notice, as this process of the agent: once, before anything is sent. What another
        process of the same agent sends to its own number comes here, too."""

    @abstractmethod
    def send(self, other: int, data: bytes) -> None:
        """Put bytes on the way; never waits."""

    def publish(self, topic: str, data: bytes) -> None:
        """Give bytes out on a topic of this agent, to whoever listens; never waits. Any thread may call it, one for
        each topic. A link without topics does nothing."""
        return None

    def listened_to(self, topic: str) -> bool:
        """Whether somebody listens to a topic of this agent, as far as is known."""
        return False

    @abstractmethod
    def receive(self, wait_s: float) -> Arrived | Presence | None:
        """What came next; None when nothing has come after ``wait_s``, seconds."""

    @property
    @abstractmethod
    def connected(self) -> bool:
        """Whether any other machine or process is connected, whoever it is."""
