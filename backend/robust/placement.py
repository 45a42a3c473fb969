"""Where pieces of trajectory stand in one frame: what most meetings agree with, over all pieces at once.

Between two pieces a wrong group of edges may outnumber the right one; round any third piece it closes no cycle. So
pieces are put in place one after the other where most edges to *all* pieces placed before want them, beginning with
each of the best-supported meetings in turn; then each is asked again, given all others. The placement with most edges
behind it wins. The same input gives the same answer: whoever has the meetings finds it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ..components import parts
from ..geometry import Array, project_to_so3, se3, se3_inverse, so3_log
from .meetings import Meeting

# Placements tried, each from another meeting.
_STARTS = 24
_FEWEST_STARTS = 4
# Pieces put in place by all tries together, about.
_PIECES = 2000
# Times that every piece is asked again, and that places are averaged, at most.
_ROUNDS = 10
# Pieces stand where others' drift put them: a meeting's own variances are a third of what it is tested under.
_OTHERS = 3.0


def placed_pieces(meetings: Sequence[Meeting], anchor: int, limit: float) -> dict[int, Array]:
    """Poses ``(4, 4)`` of all pieces that meetings join to ``anchor``, which stands at the origin. ``limit``: squared
    distance up to which a meeting agrees with a placement.
    """
    pieces = sorted({anchor, *(m.first for m in meetings), *(m.second for m in meetings)})
    row = {piece: k for k, piece in enumerate(pieces)}
    ends = np.array([(row[m.first], row[m.second]) for m in meetings], dtype=np.intp).reshape(-1, 2)
    joined = parts(ends, len(pieces))
    inside = [m for m, (i, _) in zip(meetings, ends, strict=True) if joined[i] == joined[row[anchor]]]
    if not inside:
        return {anchor: np.eye(4)}
    ballot = _Ballot(inside, row, limit)
    tries = max(_FEWEST_STARTS, min(_STARTS, _PIECES // len(pieces)))
    starts = sorted(range(len(inside)), key=lambda k: (-inside[k].support, k))[:tries]
    best, most = {row[anchor]: np.eye(4)}, -1.0
    for start in starts:
        places = ballot.settled(ballot.grown(start))
        score = ballot.score(places)
        if score > most + 1e-9:
            best, most = places, score
    best = ballot.settled(ballot.averaged(best))
    to_anchor = se3_inverse(best[row[anchor]])
    return {pieces[k]: to_anchor @ T for k, T in sorted(best.items())}


def agreeing(meetings: Sequence[Meeting], places: Mapping[int, Array], limit: float) -> NDArray[np.bool_]:
    """Mask ``(n,)`` of the meetings that agree with ``places``; one with a piece that has none does."""
    out = np.ones(len(meetings), dtype=bool)
    known = [k for k, m in enumerate(meetings) if m.first in places and m.second in places]
    if known:
        rows = {piece: row for row, piece in enumerate(sorted(places))}
        ballot = _Ballot([meetings[k] for k in known], rows, limit)
        out[known] = ballot.first_distances({rows[piece]: T for piece, T in places.items()}) <= limit
    return out


class _Ballot:
    """Meetings as arrays, each of them from both sides: ``[k]`` puts piece ``there`` where piece ``here`` stands."""

    def __init__(self, meetings: Sequence[Meeting], row: Mapping[int, int], limit: float) -> None:
        T = np.array([m.T_first_second for m in meetings])
        at = np.array([m.at for m in meetings])
        back = se3_inverse(T)
        first = np.array([row[m.first] for m in meetings], dtype=np.intp)
        second = np.array([row[m.second] for m in meetings], dtype=np.intp)
        self._count = len(meetings)
        self._here, self._there = np.concatenate([first, second]), np.concatenate([second, first])
        self._T = np.concatenate([T, back])
        # Where they met, in the frame of the piece that is put in place.
        self._at = np.concatenate([np.einsum("nab,nb->na", back[:, :3, :3], at) + back[:, :3, 3], at])
        self._turn = np.tile([_OTHERS * m.turn for m in meetings], 2)
        self._shift = np.tile([_OTHERS * m.shift for m in meetings], 2)
        self._support = np.tile(np.array([m.support for m in meetings], dtype=np.float64), 2)
        self._limit = limit
        self._of = [np.flatnonzero(self._there == piece) for piece in range(len(row))]

    def grown(self, start: int) -> dict[int, Array]:
        """Places of all pieces, from the one meeting on: always the piece with most edges behind its place next."""
        first = int(self._here[start])
        second = int(self._there[start])
        places = {first: np.eye(4), second: self._T[start]}
        waiting: dict[int, tuple[float, Array]] = {}
        placed: Iterable[int] = (first, second)
        while True:
            for piece in sorted({int(p) for n in placed for p in self._here[self._of[n]]} - set(places)):
                waiting[piece] = self._asked(piece, places)
            if not waiting:
                return places
            piece = max(sorted(waiting), key=lambda p: waiting[p][0])
            places[piece] = waiting.pop(piece)[1]
            placed = (piece,)

    def settled(self, places: dict[int, Array]) -> dict[int, Array]:
        """Every piece is asked again, given all others, until none moves."""
        places = dict(places)
        for _ in range(_ROUNDS):
            moved = False
            for piece in sorted(places):
                others = {p: T for p, T in places.items() if p != piece}
                votes, T = self._asked(piece, others)
                if votes > self._votes(piece, places[piece][None], others)[0] + 1e-9:
                    places[piece] = T
                    moved = True
            if not moved:
                break
        return places

    def averaged(self, places: dict[int, Array]) -> dict[int, Array]:
        """Every piece in the mean of the places where the meetings that agree want it."""
        places = dict(places)
        for _ in range(_ROUNDS):
            for piece in sorted(places)[1:]:
                k = self._known(piece, places)
                here = np.array([places[p] for p in self._here[k].tolist()])
                k = k[self._distances(k, here, places[piece][None])[0] <= self._limit]
                if not len(k):
                    continue
                wanted = np.array([places[p] for p in self._here[k].tolist()]) @ self._T[k]
                R = project_to_so3((wanted[:, :3, :3] * (self._support[k] / self._turn[k])[:, None, None]).sum(axis=0))
                met = np.einsum("nab,nb->na", wanted[:, :3, :3], self._at[k]) + wanted[:, :3, 3]
                weight = self._support[k] / self._shift[k]
                places[piece] = se3(R, weight @ (met - self._at[k] @ R.T) / weight.sum())
        return places

    def first_distances(self, places: Mapping[int, Array]) -> Array:
        """Squared distance of each meeting ``(n,)`` from a placement of all pieces."""
        k = np.arange(self._count)
        here = np.array([places[p] for p in self._here[k].tolist()])
        there = np.array([places[p] for p in self._there[k].tolist()])
        return self._squared(k, here @ self._T[k], there)

    def score(self, places: Mapping[int, Array]) -> float:
        """Edges behind a placement, each the more the nearer its meeting is."""
        return float(self._worth(np.arange(self._count), self.first_distances(places)).sum())

    def _known(self, piece: int, places: Mapping[int, Array]) -> NDArray[np.intp]:
        k = self._of[piece]
        return k[[p in places for p in self._here[k].tolist()]]

    def _asked(self, piece: int, places: Mapping[int, Array]) -> tuple[float, Array]:
        """The place with most votes among those that one meeting alone wants, and these."""
        k = self._known(piece, places)
        if not len(k):
            return -1.0, np.eye(4)
        here = np.array([places[p] for p in self._here[k].tolist()])
        candidates = here @ self._T[k]
        votes = self._votes(piece, candidates, places)
        best = int(np.argmax(votes))
        return float(votes[best]), candidates[best]

    def _votes(self, piece: int, candidates: Array, places: Mapping[int, Array]) -> Array:
        k = self._known(piece, places)
        if not len(k):
            return np.zeros(len(candidates))
        here = np.array([places[p] for p in self._here[k].tolist()])
        return np.asarray(self._worth(k, self._distances(k, here, candidates)).sum(axis=1))

    def _worth(self, k: NDArray[np.intp], squared: Array) -> Array:
        return np.asarray(self._support[k] * np.maximum(0.0, 1.0 - squared / self._limit))

    def _distances(self, k: NDArray[np.intp], here: Array, candidates: Array) -> Array:
        """``(c, k)``: of each meeting from each candidate place."""
        return np.array([self._squared(k, here @ self._T[k], T[None]) for T in candidates])

    def _squared(self, k: NDArray[np.intp], wanted: Array, stands: Array) -> Array:
        turn = np.swapaxes(wanted[:, :3, :3], 1, 2) @ stands[:, :3, :3]
        away = wanted - stands
        gap = np.einsum("nab,nb->na", away[:, :3, :3], self._at[k]) + away[:, :3, 3]
        angle = (so3_log(turn) ** 2).sum(axis=1)
        return np.asarray(angle / self._turn[k] + (gap**2).sum(axis=1) / self._shift[k])
