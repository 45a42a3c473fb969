"""Place queries of other agents: the vectors of the own cluster, and the latest queries of each asker."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .candidates import Candidates

Vector = NDArray[np.float32]

# Key-frames of one agent that a log has room for.
_MOST_KEYFRAMES = 100_000

# By how much squared distances made of products may be off, far more than they are: vectors are of unit length.
_ROUGH = 1e-3


@dataclass(frozen=True)
class LoggedPlace:
    """A key-frame of ``agent`` in a log, and how far its vector is from the one asked about."""

    agent: int
    keyframe: int
    distance: float


@dataclass(frozen=True)
class QueryMatch:
    """The asker's key-frame ``query``, the own ``keyframe`` nearest to it, and the distance of their vectors."""

    query: int
    keyframe: int
    distance: float


@dataclass(frozen=True, eq=False)
class LoggedPlaces:
    """``keyframes``: agent and key-frame of each row; ``vectors`` ``(n, d)``, decoded."""

    keyframes: list[tuple[int, int]]
    vectors: Vector


@dataclass(eq=False)
class ClusterIndex:
    """All key-frames whose vectors fell into the cluster that this agent owns, whoever's they are (thesis sections
    2.2.3 and 3.5; Cieslewski and Scaramuzza 2017)."""

    _who: list[tuple[int, int]] = field(default_factory=list)
    _known: set[tuple[int, int]] = field(default_factory=set)
    _counts: dict[int, int] = field(default_factory=dict)
    # Room for vectors (n, d), whose they are (n,) and their squared lengths (n,), doubled when it is full.
    _vectors: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), dtype=np.float32))
    _agents: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    _squares: NDArray[np.float32] = field(default_factory=lambda: np.zeros(0, dtype=np.float32))

    def remember(self, agent: int, keyframe: int, vector: Vector) -> None:
        """Log a key-frame, decoded ``(d,)``; one that is known stays as it is."""
        if (agent, keyframe) in self._known or self._counts.get(agent, 0) >= _MOST_KEYFRAMES:
            return
        self._counts[agent] = self._counts.get(agent, 0) + 1
        row = len(self._who)
        if row == len(self._agents):
            room = np.empty((max(2 * row, 64), len(vector)), dtype=np.float32)
            if row:
                room[:row] = self._vectors
            self._vectors, self._agents = room, np.resize(self._agents, len(room))
            self._squares = np.resize(self._squares, len(room))
        self._vectors[row], self._agents[row], self._squares[row] = vector, agent, vector @ vector
        self._who.append((agent, keyframe))
        self._known.add((agent, keyframe))

    @property
    def logged(self) -> LoggedPlaces:
        """All that is logged, the oldest first."""
        return LoggedPlaces(list(self._who), self._vectors[: len(self._who)].copy())

    def nearest(self, vector: Vector, asker: int) -> LoggedPlace | None:
        """The nearest key-frame (Euclidean distance) that is not the asker's own; the older of equals; None where there
        is none."""
        count = len(self._who)
        others = self._agents[:count] != asker
        if not others.any():
            return None
        rough = self._squares[:count] - 2.0 * (self._vectors[:count] @ vector)
        near = np.flatnonzero(others & (rough <= rough[others].min() + _ROUGH))
        apart = np.linalg.norm(self._vectors[near] - vector, axis=1)
        best = int(apart.argmin())
        return LoggedPlace(*self._who[int(near[best])], float(apart[best]))


@dataclass(eq=False)
class _Earlier:
    """A query and how many of the own key-frames it has been compared with."""

    keyframe: int
    vector: Vector
    compared: int


@dataclass(eq=False)
class RecentQueries:
    """The latest queries of each asker, compared again with what the asked agent has seen since (thesis sections 3.5
    and 4.3: the latest five frames are matched, for the bytes of one).

    The asker's vectors travel once. Each pair of key-frames is compared once: a new query with all own key-frames, the
    earlier ones with those that came since.
    """

    candidates: Candidates
    latest: int
    _queries: dict[int, deque[_Earlier]] = field(default_factory=dict)

    def nearest(self, asker: int, keyframe: int, vector: Vector) -> QueryMatch | None:
        """The nearest pair of the asker's key-frames, this or an earlier one, and an own one; this one of equals; None
        where there is nothing to compare with."""
        found = self.candidates.nearest_to_decoded(vector)
        best = None if found is None else QueryMatch(keyframe, *found)
        queries = self._queries.setdefault(asker, deque(maxlen=self.latest))
        if self.latest > 1:
            count = len(self.candidates.state.keyframes)
            for repeated in [q for q in queries if q.keyframe == keyframe]:
                queries.remove(repeated)
            queries.append(_Earlier(keyframe, vector, count))
            for earlier in queries:
                new = self.candidates.nearest_of_new(earlier.vector, earlier.compared)
                earlier.compared = count
                if new is not None and (best is None or new[1] < best.distance):
                    best = QueryMatch(earlier.keyframe, *new)
        return best
