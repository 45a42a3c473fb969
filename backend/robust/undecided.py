"""Where a selection could as well have gone the other way: rejected edges with as many behind them as the kept ones.

Edges are selected by how many agree. A rejected edge asks for one part of the graph to be moved against the rest; what
stands against that are the kept edges that join the two, at least as many as the smallest cut between the edge's ends.
Where nearly as many rejected edges hold after the move as kept ones break, nothing in the graph tells which are the
wrong ones, and whoever uses the result must know. Odometry is trusted: pieces that it joins are not cut.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order, maximum_flow

from ..central.trust_region import anchors
from ..config import CentralConfig, RobustConfig
from ..geometry import Array, se3_inverse
from ..pose_graph.graph import PoseGraph
from .gnc import squared_residuals
from .meetings import Meeting
from .noise import Noise
from .placement import agreeing
from .voting import PiecePairs, piece_pairs

# So many rejected edges, as a share of the kept ones that they contradict, leave it open which are wrong.
_AS_MANY = 0.75


@dataclass(frozen=True)
class Undecided:
    """Rows of a graph's edges: the ``rejected`` ones hold where ``robots`` are moved against the rest, and the ``kept``
    ones break then. Nothing tells which are wrong."""

    robots: tuple[int, ...]
    kept: tuple[int, ...]
    rejected: tuple[int, ...]


def undecided_edges(graph: PoseGraph, config: RobustConfig) -> tuple[Undecided, ...]:
    """Of a solved ``graph`` with the weights of its selection: each group of rejected edges once, the largest first."""
    kept = np.array([e.weight > 0.5 for e in graph.edges], dtype=bool)
    if kept.all():
        return ()
    pieces = piece_pairs(graph)
    if not pieces.pairs:
        return ()
    found: dict[tuple[int, ...], Undecided] = {}
    rivals = _Rivals(graph, pieces, kept, _noise(graph, config).limit(1.0 - config.confidence))
    for rival in rivals.found():
        known = found.get(rival.rejected)
        if known is None or len(rival.kept) < len(known.kept):
            found[rival.rejected] = rival
    largest = sorted(found.values(), key=lambda u: (-len(u.rejected), u.rejected))
    out: list[Undecided] = []
    for one in largest:
        if not any(set(one.rejected) <= set(other.rejected) for other in out):
            out.append(one)
    return tuple(out)


class _Rivals:
    """The graph's pieces as nodes, its judged edges between them as what joins these, or would."""

    def __init__(self, graph: PoseGraph, pieces: PiecePairs, kept: NDArray[np.bool_], limit: float) -> None:
        self._graph, self._pieces, self._kept, self._limit = graph, pieces, kept, limit
        nodes = graph.nodes
        self._places = {k: graph.poses[nodes[row]] for k, row in enumerate(pieces.middles)}
        self._robots = [nodes[row].robot for row in pieces.middles]
        self._rows = np.concatenate([rows for _, rows in pieces.pairs])
        self._meetings: list[Meeting] = [m for between, _ in pieces.pairs for m in between.alone()]
        self._ends = np.array([(m.first, m.second) for m in self._meetings], dtype=np.intp).reshape(-1, 2)
        count = len(pieces.middles)
        joined = self._ends[kept[self._rows]]
        both = np.concatenate([joined, joined[:, ::-1]])
        self._capacity = csr_array((np.ones(len(both), dtype=np.int32), both.T), shape=(count, count))
        self._capacity.sum_duplicates()

    def found(self) -> Iterator[Undecided]:
        """Each group of rejected edges that agree, against the smallest cuts between its two pieces."""
        for between, rows in self._pieces.pairs:
            rejected = ~self._kept[rows]
            if not rejected.any():
                continue
            for side in _cuts(self._capacity, between.first, between.second):
                across = np.flatnonzero(side[self._ends[:, 0]] != side[self._ends[:, 1]])
                out = int((~self._kept[self._rows[across]]).sum())
                if out >= _AS_MANY * (len(across) - out) > 0:
                    for meeting in between.only(rejected).meetings(self._limit):
                        yield from self._judged(meeting, side, across)

    def _judged(self, meeting: Meeting, side: NDArray[np.bool_], across: NDArray[np.intp]) -> Iterator[Undecided]:
        """What holds and what breaks if the pieces of one ``side`` move such that the meeting holds."""
        wanted = self._places[meeting.second] @ se3_inverse(meeting.T_first_second)
        move = wanted @ se3_inverse(self._places[meeting.first])
        places = {k: move @ T if side[k] else T for k, T in self._places.items()}
        holds = agreeing([self._meetings[k] for k in across], places, self._limit)
        kept = self._kept[self._rows[across]]
        holding, breaking = self._rows[across[holds & ~kept]], self._rows[across[~holds & kept]]
        if len(breaking) and len(holding) >= _AS_MANY * len(breaking):
            moved = {r for k, r in enumerate(self._robots) if side[k]}
            rest = {r for k, r in enumerate(self._robots) if not side[k]}
            robots = min(sorted(moved), sorted(rest), key=lambda group: (len(group), group))
            yield Undecided(tuple(robots), tuple(sorted(breaking.tolist())), tuple(sorted(holding.tolist())))


def _cuts(capacity: csr_array, first: int, second: int) -> Sequence[NDArray[np.bool_]]:
    """The smallest cuts nearest to either of two nodes: masks ``(n,)`` of the side of ``first``. None where nothing
    joins the two."""
    found = maximum_flow(capacity, first, second)
    if not found.flow_value:
        return ()
    left = csr_array(capacity - found.flow)
    left.eliminate_zeros()
    near, far = np.zeros(capacity.shape[0], dtype=bool), np.ones(capacity.shape[0], dtype=bool)
    near[breadth_first_order(left, first, return_predecessors=False)] = True
    far[breadth_first_order(csr_array(left.T), second, return_predecessors=False)] = False
    return (near,) if (near == far).all() else (near, far)


def _noise(graph: PoseGraph, config: RobustConfig) -> Noise:
    """As the residuals of what is kept tell it."""
    a, noise, central = graph.arrays(), Noise.stated(graph.dimension), CentralConfig()
    weights: Array = np.array([e.weight for e in graph.edges])
    freedom = noise.full * (int((weights > 0.5).sum()) + len(graph.priors) - len(a.poses) + len(anchors(a)))
    if freedom <= 0:
        return noise
    squared = squared_residuals(graph, central)
    return noise.grown(noise.full * float(weights @ squared) / freedom, freedom, config)
