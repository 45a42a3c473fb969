"""The vote on where pieces of robots' trajectories stand, by messages: what one robot says, receives, and makes of it.

Neighbours tell each other where their common edges end, each in the frame of its own piece, and how far odometry has
drifted there. The lower of two robots finds the groups of their edges that agree; these go up the tree of members, and
the places that most edges agree with come down (:mod:`maslam.backend.robust.placement`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..errors import BackendError
from ..geometry import Array, se3_inverse
from ..robust.meetings import Ends, Meeting, PieceEdges, drift_of, loop_distances
from ..robust.placement import agreeing, placed_pieces
from .compact import numbers_of, poses_of
from .local import LocalProblem

# Numbers of a meeting: robot and piece of both sides, relative pose, where, variances, support.
_MEETING = 16
# Numbers of a place: robot, piece, pose.
_PLACE = 8
# In place of the support: not a meeting but where the anchor's piece stands.
_ANCHOR = -1.0

Piece = tuple[int, int]
"""Robot, and number of its piece."""


class PieceVote:
    """``label`` ``(own,)``: pieces of the own nodes; ``odometry`` ``(m,)``: edges within these."""

    def __init__(self, problem: LocalProblem, label: NDArray[np.intp], odometry: NDArray[np.bool_]) -> None:
        self._problem, self._label, own = problem, label, problem.own_count
        edges = problem.edges
        kappa, tau = np.maximum(edges.kappa, 1e-12), np.maximum(edges.tau, 1e-12)
        self._variances = np.stack([0.5 / kappa, 1.0 / tau], axis=1)
        inner = odometry & (edges.ends < own).all(axis=1)
        drift = drift_of(edges.ends[inner], self._variances[inner], label)
        self._middles = problem.places.poses[drift.middle]
        poses = numbers_of(se3_inverse(self._middles) @ problem.places.poses[:own])
        # A row for each node: what its owner tells its neighbours, as they read it.
        self._rows = np.full((len(problem.nodes), 9), np.nan)
        self._rows[:own] = np.concatenate([poses, label[:, None], drift.collected], axis=1).astype(np.float32)
        self._places: dict[Piece, Array] = {}
        loops = ~odometry & (edges.ends < own).all(axis=1)
        loops[loops] = label[edges.ends[loops, 0]] == label[edges.ends[loops, 1]]
        self._loops, given = np.flatnonzero(loops), (edges.ends[loops], edges.measured[loops], self._variances[loops])
        self._closing = loop_distances(problem.places.poses[:own], drift.collected, *given)

    def said(self, neighbour: int) -> Array:
        """Rows ``(k, 9)`` for a neighbour: pose in the piece's frame, the piece's number, drift of turn and shift."""
        return self._rows[self._problem.sent_rows[neighbour]]

    def receive(self, neighbour: int, rows: Array) -> None:
        """Inverse of :meth:`said` at the other side."""
        self._rows[self._problem.received_rows[neighbour]] = rows

    def found(self, limit: float) -> tuple[float, ...]:
        """Meetings with higher robots, ``limit`` being the squared distance within which edges agree; and, from the
        anchor, where its piece stands."""
        out: list[float] = []
        me = self._problem.share.robot
        if self._problem.given:
            piece = (float(me), float(self._label[0]))
            at = numbers_of(self._middles[:1])[0].tolist()
            out += [*piece, *piece, *at, *[0.0] * 5, _ANCHOR]
        for between, pair, _ in self._between():
            if me != min(robot for robot, _ in pair):
                continue
            for m in between.meetings(limit):
                pose = numbers_of(m.T_first_second[None])[0].tolist()
                ends = [float(x) for piece in pair for x in piece]
                out += [*ends, *pose, *m.at.tolist(), m.turn, m.shift, float(m.support)]
        return tuple(out)

    def adopt(self, numbers: Sequence[float]) -> NDArray[np.bool_]:
        """Move own pieces to where :func:`elected_places` puts them; returns the own nodes ``(own,)`` that moved."""
        rows = _in_rows(numbers, _PLACE)
        self._places = {(int(r[0]), int(r[1])): poses_of(r[None, 2:])[0] for r in rows}
        own, places = self._problem.own_count, self._problem.places
        done = np.zeros(own, dtype=bool)
        for (robot, piece), T in sorted(self._places.items()):
            mine = np.flatnonzero(self._label == piece)
            if robot == self._problem.share.robot and len(mine):
                done[mine] = True
                if not (self._problem.given and piece == self._label[0]):
                    places.poses[mine] = T @ se3_inverse(self._middles[mine]) @ places.poses[mine]
        return done

    def agreeing(self, limit: float) -> NDArray[np.bool_]:
        """Mask ``(m,)`` of the edges between pieces that agree with the places adopted, the same at both owners of an
        edge; of the loops within one that agree with odometry; and all others."""
        out = np.ones(len(self._problem.edges.ends), dtype=bool)
        out[self._loops] = self._closing <= limit
        for between, pair, rows in self._between():
            places = {k: self._places[piece] for k, piece in enumerate(pair) if piece in self._places}
            out[rows] = agreeing(between.alone(), places, limit)
        return out

    def _between(self) -> list[tuple[PieceEdges, tuple[Piece, Piece], NDArray[np.intp]]]:
        """Edges from one piece to another; the two pieces; the rows of the edges."""
        problem = self._problem
        robots = np.array([n.robot for n in problem.nodes])
        of = np.stack([robots, np.nan_to_num(self._rows[:, 6], nan=-1.0).astype(np.intp)], axis=1)
        ends = problem.edges.ends
        # From the lower piece to the higher, whichever way an edge was measured.
        forward = (of[ends] @ np.array([1 << 16, 1]) @ np.array([1, -1])) <= 0
        ends = np.where(forward[:, None], ends, ends[:, ::-1])
        measured = np.where(forward[:, None, None], problem.edges.measured, se3_inverse(problem.edges.measured))
        both = np.concatenate([of[ends[:, 0]], of[ends[:, 1]]], axis=1)
        across = (both[:, :2] != both[:, 2:]).any(axis=1) & np.isfinite(self._rows[ends]).all(axis=(1, 2))
        poses = np.tile(np.eye(4), (len(self._rows), 1, 1))
        known = np.isfinite(self._rows).all(axis=1)
        poses[known] = poses_of(self._rows[known, :6])
        out = []
        for a, b, c, d in np.unique(both[across], axis=0).tolist():
            k = np.flatnonzero(across & (both == (a, b, c, d)).all(axis=1))
            here, there = (Ends(poses[r], self._rows[r, 7:]) for r in ends[k].T)
            between = PieceEdges(0, 1, here, there, measured[k], self._variances[k])
            out.append((between, ((a, b), (c, d)), k))
        return out


def elected_places(numbers: Sequence[float], limit: float) -> tuple[float, ...]:
    """At the root: places of all pieces that meetings join to the anchor's, from what came up the tree."""
    rows = _in_rows(numbers, _MEETING)
    pieces = sorted({(int(r[k]), int(r[k + 1])) for r in rows for k in (0, 2)})
    number = {piece: k for k, piece in enumerate(pieces)}
    anchored = rows[rows[:, -1] == _ANCHOR]
    if len(anchored) != 1:
        raise BackendError(f"{len(anchored)} robots say that they are the anchor of their group")
    poses = poses_of(rows[:, 4:10])
    meetings = [
        Meeting(number[int(r[0]), int(r[1])], number[int(r[2]), int(r[3])], T, r[10:13], r[13], r[14], int(r[15]))
        for r, T in zip(rows, poses, strict=True)
        if r[15] > 0 and (r[0], r[1]) != (r[2], r[3])
    ]
    anchor = anchored[0]
    T_O_anchor = poses_of(anchor[None, 4:10])[0]
    found = placed_pieces(meetings, number[int(anchor[0]), int(anchor[1])], limit)
    placed = [[*map(float, pieces[k]), *numbers_of((T_O_anchor @ T)[None])[0].tolist()] for k, T in found.items()]
    return tuple(x for row in placed for x in row)


def _in_rows(numbers: Sequence[float], width: int) -> Array:
    if len(numbers) % width:
        raise BackendError(f"{len(numbers)} numbers of a vote, which come {width} at a time")
    return np.array(numbers, dtype=np.float64).reshape(-1, width)
