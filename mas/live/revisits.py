"""Times from a key-frame's coming to the match that it yields, and to poses that hold this match."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Lock

from ..agent import Agent
from ..protocol.ids import MatchId


@dataclass(frozen=True)
class RevisitTimes:
    """Of ``revisits``, accepted matches of key-frames that came while this process ran: seconds from the coming of the
    key-frame's image to the agent's acting on it, to the match's acceptance and to the first pose that holds it, on
    average and at most. ``uncorrected``: no pose holds them yet; they count for the first two times only."""

    revisits: int = 0
    uncorrected: int = 0
    passed_on_mean_s: float = 0.0
    accepted_mean_s: float = 0.0
    corrected_mean_s: float = 0.0
    corrected_most_s: float = 0.0


@dataclass
class _Revisit:
    came_s: float
    passed_on_s: float
    accepted_s: float
    corrected_s: float | None = None


class Revisits:
    """Of each match the agent's own key-frame counts that asked for it: that of the place which was seen again. Other
    agents measure theirs, so no two clocks are compared."""

    def __init__(self, agent: Agent, clock: Callable[[], float] = time.monotonic) -> None:
        self._agent, self._clock = agent, clock
        self._known = set(agent.state.accepted)
        self._came: dict[int, float] = {}
        self._acted: dict[int, float] = {}
        self._found: dict[MatchId, _Revisit] = {}
        self._lock = Lock()

    def came(self, keyframe: int, came_s: float) -> None:
        """When the image of a key-frame came, on the clock; before the agent acts on it, from any thread."""
        with self._lock:
            self._came[keyframe] = came_s

    def look(self) -> None:
        """After a step of the agent: what it has accepted since, and what its poses hold now."""
        now_s, state = self._clock(), self._agent.state
        for index in range(len(self._acted), len(state.keyframes)):
            self._acted[index] = now_s
        held: frozenset[MatchId] | None = None
        with self._lock:
            for match in sorted(state.accepted - self._known):
                self._known.add(match)
                if match.query_agent == state.me and match.query in self._came:
                    self._found[match] = _Revisit(self._came[match.query], self._acted[match.query], now_s)
            for match, one in self._found.items():
                if one.corrected_s is None:
                    held = self._agent.held_matches if held is None else held
                    one.corrected_s = now_s if match in held else None

    def times(self) -> RevisitTimes:
        """The times by now; any thread may ask."""
        with self._lock:
            found = list(self._found.values())
            done = [r.corrected_s - r.came_s for r in found if r.corrected_s is not None]
        return RevisitTimes(
            revisits=len(found),
            uncorrected=len(found) - len(done),
            passed_on_mean_s=_mean([r.passed_on_s - r.came_s for r in found]),
            accepted_mean_s=_mean([r.accepted_s - r.came_s for r in found]),
            corrected_mean_s=_mean(done),
            corrected_most_s=max(done, default=0.0),
        )


def _mean(values: list[float]) -> float:
    return sum(values) / len(values) if values else 0.0
