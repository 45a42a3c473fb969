"""Where an agent's key-frames come from: a sequence that was made before, or a camera that goes on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from queue import SimpleQueue
from threading import Event

from .observed import Observed
from .recorded_agent import RecordedAgent


class Drive(ABC):
    """The drive of one agent."""

    @abstractmethod
    def observe(self, now_ns: int) -> None:
        """Give the agent the key-frames that have come by now (logical time)."""

    @property
    @abstractmethod
    def over(self) -> bool:
        """Whether the agent has all key-frames that there will be."""

    @property
    @abstractmethod
    def keyframes(self) -> int:
        """How many there are, as far as is known: of a camera that goes on those that the agent has."""


class RecordedDrive(Drive):
    """Key-frames of a sequence, each at its own time."""

    def __init__(self, agent: RecordedAgent) -> None:
        self._agent = agent
        self._keyframes = agent.inputs.keyframes

    def observe(self, now_ns: int) -> None:
        """See :meth:`Drive.observe`."""
        inputs = self._agent.inputs
        while not self.over and self._keyframes[inputs.seen].time_ns <= now_ns:
            self._agent.observe(now_ns)

    @property
    def over(self) -> bool:
        """See :attr:`Drive.over`."""
        return self._agent.inputs.seen >= len(self._keyframes)

    @property
    def keyframes(self) -> int:
        """See :attr:`Drive.keyframes`."""
        return len(self._keyframes)


class LiveDrive(Drive):
    """Key-frames that a front end passes on, in another thread, until it calls :meth:`end`."""

    def __init__(self, agent: RecordedAgent) -> None:
        self._agent = agent
        self._come: SimpleQueue[Observed] = SimpleQueue()
        self._ended = Event()

    def put(self, observed: Observed) -> None:
        """A key-frame for the agent; from any thread."""
        self._come.put(observed)

    def end(self) -> None:
        """No more key-frames come; from any thread, after the last of them."""
        self._ended.set()

    def observe(self, now_ns: int) -> None:
        """See :meth:`Drive.observe`."""
        while not self._come.empty():
            self._agent.see(self._come.get(), now_ns)

    @property
    def over(self) -> bool:
        """See :attr:`Drive.over`."""
        return self._ended.is_set() and self._come.empty()

    @property
    def keyframes(self) -> int:
        """See :attr:`Drive.keyframes`."""
        return self._agent.inputs.seen
