"""What edges between two pieces of trajectory say of where these stand to each other, by groups that agree.

A *piece* is what odometry joins. Its frame is that of its middle node, so that drift is least at its ends. Edges
between two pieces that agree, under the drift between their ends, make one *meeting*: a relative pose of the two, with
its variances and the number of edges behind it. Random wrong edges make meetings of one edge; a street taken for
another one makes a meeting as large as a right one, which only the other pieces can tell from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array, se3_inverse, so3_log
from .clique import largest_clique

# Bound of the search for each group of edges that agree.
_WORK = 50_000
# Meetings kept for each two pieces, the largest first.
_MOST = 8
# Share of a turn's variance, times the distance it acts over squared, that moves the far end: as a walk collects it.
_LEVER = 1.0 / 3.0


@dataclass(frozen=True, eq=False)
class Meeting:
    """``T_first_second`` ``(4, 4)``: frame of the second piece in the first one's; ``at`` ``(3,)``: where they met, in
    the first one's frame; ``turn``, ``shift``: variances there for each axis, rad^2 and m^2, with the drift from the
    pieces' middles; ``support``: edges that say so.
    """

    first: int
    second: int
    T_first_second: Array
    at: Array
    turn: float
    shift: float
    support: int


@dataclass(frozen=True, eq=False)
class Ends:
    """Ends of edges on one side: ``poses`` ``(n, 4, 4)`` in the piece's frame, ``drift`` ``(n, 2)``: variances for each
    axis, of turn and shift, that odometry has collected from the middle, with sign (negative before it).
    """

    poses: Array
    drift: Array

    def at(self, rows: NDArray[np.intp]) -> Ends:
        """Some ``rows``."""
        return Ends(self.poses[rows], self.drift[rows])


@dataclass(frozen=True, eq=False)
class Drift:
    """``middle`` ``(n,)``: row of the middle node of each node's piece; ``collected`` ``(n, 2)``: see :class:`Ends`."""

    middle: NDArray[np.intp]
    collected: Array


def drift_of(ends: NDArray[np.intp], variances: Array, label: NDArray[np.intp]) -> Drift:
    """Along odometry with ``ends`` ``(m, 2)`` and ``variances`` ``(m, 2)`` a step; ``label`` ``(n,)``: nodes' piece."""
    collected = np.zeros((len(label), 2))
    later = ends.max(axis=1) if len(ends) else np.zeros(0, dtype=np.intp)
    for k in np.argsort(later, kind="stable"):
        collected[later[k]] = collected[ends[k].min()] + variances[k]
    middle = np.zeros(len(label), dtype=np.intp)
    for piece in np.unique(label):
        rows = np.flatnonzero(label == piece)
        middle[rows] = rows[len(rows) // 2]
    return Drift(middle, collected - collected[middle])


@dataclass(frozen=True, eq=False)
class PieceEdges:
    """Edges from piece ``first`` to piece ``second``: ends ``here`` and ``there``, ``measured`` ``(n, 4, 4)``, and
    ``variances`` ``(n, 2)`` for each axis, of turn and shift.
    """

    first: int
    second: int
    here: Ends
    there: Ends
    measured: Array
    variances: Array

    @property
    def through(self) -> Array:
        """Where each edge puts its other end ``(n, 4, 4)``, in the first piece's frame."""
        return np.asarray(self.here.poses @ self.measured)

    def meetings(self, limit: float) -> list[Meeting]:
        """Groups that agree: of each two edges what they say is within the squared distance ``limit``."""
        distances = _distances(self, self._relative())
        agree = distances <= limit
        left = np.arange(len(agree))
        groups: list[NDArray[np.intp]] = []
        while len(left) and len(groups) < _MOST:
            members = left[list(largest_clique(agree[np.ix_(left, left)], _WORK).members)]
            groups.append(members)
            left = np.setdiff1d(left, members)
        return [self._meeting(group, distances[np.ix_(group, group)]) for group in groups]

    def only(self, rows: NDArray[np.bool_]) -> PieceEdges:
        """Some of the edges."""
        k = np.flatnonzero(rows)
        here, there = self.here.at(k), self.there.at(k)
        return PieceEdges(self.first, self.second, here, there, self.measured[k], self.variances[k])

    def alone(self) -> list[Meeting]:
        """Each edge by itself, in their order."""
        return [self._meeting(np.array([k]), np.zeros((1, 1))) for k in range(len(self.measured))]

    def _relative(self) -> Array:
        return np.asarray(self.through @ se3_inverse(self.there.poses))

    def _meeting(self, group: NDArray[np.intp], distances: Array) -> Meeting:
        """What the one of a group says that all its others are nearest to; of two, the one that has drifted less."""
        here, there, variances = self.here.at(group), self.there.at(group), self.variances[group]
        turn = variances[:, 0] + np.abs(here.drift[:, 0]) + np.abs(there.drift[:, 0])
        far = np.abs(here.drift[:, 0]) * _squared(here.poses) + np.abs(there.drift[:, 0]) * _squared(there.poses)
        shift = variances[:, 1] + np.abs(here.drift[:, 1]) + np.abs(there.drift[:, 1]) + _LEVER * far
        best = int(np.lexsort((shift, distances.sum(axis=1)))[0])
        k = group[best]
        T, at = self._relative()[k], self.through[k, :3, 3]
        return Meeting(self.first, self.second, T, at, float(turn[best]), float(shift[best]), len(group))


def loop_distances(poses: Array, drift: Array, ends: NDArray[np.intp], measured: Array, variances: Array) -> Array:
    """Squared distances ``(m,)`` from closing of loops within pieces: ``ends`` ``(m, 2)`` rows of ``poses``
    ``(n, 4, 4)`` by odometry, whose nodes stand in its order, with the ``drift`` ``(n, 2)`` collected there.
    """
    out = np.zeros(len(ends))
    for k, (i, j) in enumerate(ends.tolist()):
        error = se3_inverse(measured[k]) @ se3_inverse(poses[i]) @ poses[j]
        collected = np.abs(drift[j] - drift[i])
        # A turn anywhere on the way moves its end by its distance from there.
        way = poses[min(i, j) : max(i, j), :3, 3] - poses[j, :3, 3]
        turn, shift = variances[k] + collected
        shift += collected[0] * (way**2).sum(axis=1).mean()
        out[k] = (so3_log(error[:3, :3]) ** 2).sum() / turn + (error[:3, 3] ** 2).sum() / shift
    return out


def _distances(edges: PieceEdges, Z: Array) -> Array:
    """Squared distance ``(n, n)`` of what each two edges say, ``Z`` ``(n, 4, 4)``, where one of them meets."""
    here, there, variances, at = edges.here.drift, edges.there.drift, edges.variances, edges.through[:, :3, 3]
    out = np.zeros((len(Z), len(Z)))
    for k in range(len(Z)):
        moved = Z @ se3_inverse(Z[k])
        angle = (so3_log(moved[:, :3, :3]) ** 2).sum(axis=1)
        gap = ((moved[:, :3, :3] @ at[k] + moved[:, :3, 3] - at[k]) ** 2).sum(axis=1)
        collected = np.abs(here - here[k]) + np.abs(there - there[k])
        both = variances[k] + variances + collected
        # The other edge's turn and that of the way to it act over the distance between the two.
        lever = ((at - at[k]) ** 2).sum(axis=1) * (variances[:, 0] + _LEVER * collected[:, 0])
        out[k] = angle / both[:, 0] + gap / (both[:, 1] + lever)
    return np.asarray(np.maximum(out, out.T))


def _squared(poses: Array) -> Array:
    return np.asarray((poses[:, :3, 3] ** 2).sum(axis=1))
