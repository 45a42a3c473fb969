"""An agent's memory of places: vectors of its key-frames, candidate matches and what became of them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.geometry import Sim3
from mas.identities import MatchId
from mas.keyframe import KeyFrame
from mas.matches import Fate
from mas.state import AgentState


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place match on its way: a row of ``matches.csv``. ``distance`` of the vectors; ``reason``: why it was not
    verified or not accepted, in words that can be counted; ``detail``: with figures."""

    id: MatchId
    now_ns: int
    distance: float
    verified: bool = False
    reason: str = ""
    detail: str = ""
    matches: int = 0
    inliers: int = 0
    rmse: float | None = None
    T_M_Q: Sim3 | None = None


class PlaceIndex:
    """Place vectors of the agent's own key-frames, searched exactly."""

    def __init__(self) -> None:
        self._vectors: NDArray[np.float32] = np.zeros((0, 0), dtype=np.float32)
        self._count = 0
        self._rows: list[int] = []

    def add(self, keyframe: KeyFrame) -> None:
        """Key-frames without texture are left out: their vectors say nothing."""
        if not keyframe.textured:
            return
        if self._count == len(self._vectors):
            grown = np.zeros((max(64, 2 * self._count), len(keyframe.vector)), dtype=np.float32)
            if self._count:
                grown[: self._count] = self._vectors[: self._count]
            self._vectors = grown
        self._vectors[self._count] = keyframe.vector
        self._count += 1
        self._rows.append(keyframe.index)

    def nearest(self, vector: NDArray[np.float32], below: int | None = None) -> tuple[int, float] | None:
        """Index and Euclidean distance of the nearest key-frame (among those with index < ``below``); the older one
        of equals."""
        count = self._count if below is None else int(np.searchsorted(self._rows, below))
        if not count:
            return None
        apart = np.linalg.norm(self._vectors[:count] - vector, axis=1)
        best = int(np.argmin(apart))
        return self._rows[best], min(float(apart[best]), 2.0)


@dataclass
class PlaceBook:
    """Candidates of the agent's own queries, and when it was last matched with whom."""

    state: AgentState
    index: PlaceIndex = field(default_factory=PlaceIndex)
    candidates: dict[MatchId, Candidate] = field(default_factory=dict)
    last_matched: dict[int, int] = field(default_factory=dict)
    verified: dict[int, list[int]] = field(default_factory=dict)

    def propose(self, candidate: Candidate) -> bool:
        """Enter a candidate; whether it is worth a verification. If not, the reason stands in the book."""
        if candidate.id in self.candidates:
            return False
        reason = self._why_not(candidate.id)
        self.candidates[candidate.id] = replace(candidate, reason=reason)
        return not reason

    def update(self, match: MatchId, **changes: Any) -> None:
        """Change a candidate of mine; matches found by others are not in my book."""
        if match in self.candidates:
            self.candidates[match] = replace(self.candidates[match], **changes)
            if self.candidates[match].verified:
                self.verified.setdefault(match.match_agent, []).append(match.query)

    def matched(self, match: MatchId) -> None:
        """An accepted match: from now on the gap to the next verification with the other agent counts."""
        me = self.state.me
        mine = match.query if match.query_agent == me else match.match
        other = match.match_agent if match.query_agent == me else match.query_agent
        self.last_matched[other] = max(mine, self.last_matched.get(other, mine))

    def fate(self, candidate: Candidate) -> tuple[Fate, str]:
        """What became of a candidate, and why, as it stands now."""
        if candidate.id in self.state.accepted:
            return Fate.ACCEPTED, "accepted"
        if candidate.verified:
            return Fate.REJECTED, "no agreeing match"
        return Fate.REJECTED, candidate.reason or "not verified"

    def _why_not(self, match: MatchId) -> str:
        turned = MatchId(match.match_agent, match.match, match.query_agent, match.query)
        if turned in self.state.verified or turned in self.candidates:
            return "known already"
        config = self.state.config.places
        recent = [q for q in self.verified.get(match.match_agent, []) if 0 <= match.query - q <= config.gap_keyframes]
        if len(recent) > self.state.config.consistency.min_support:
            return "soon after verified matches"
        last = self.last_matched.get(match.match_agent)
        if last is None or match.query < last:
            return ""
        if match.query - last <= config.gap_keyframes:
            return "soon after an accepted match"
        if self.state.travelled[match.query] - self.state.travelled[last] < config.gap_m:
            return "soon after an accepted match"
        return ""
