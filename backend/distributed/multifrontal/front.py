"""A robot's front: its own poses, those of others that its edges or earlier robots bring, and which of them it
eliminates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ...central.similarity_edges import SimilarityEdges, edges_of
from ...components import parts
from ...errors import BackendError
from ...pose_graph.graph import Edge, NodeId
from ..held import HeldPriors
from ..places import Places
from ..share import Share
from .boundary import Boundary
from .ordering import smallest_cover


class Front:
    """``nodes``: own ones first, then guests; rows count in these, then in the places of held priors, which stay.

    ``edges``: those that this robot answers for. Rows that are eliminated here (``inner``), passed on (``outer``), or
    passed on by robots before (``brought``); ``shared`` ``(n,)``: rows of which others need to know.
    ``reached`` ``(n,)``: rows that are, or may yet be, tied to the anchor; ``last``: whether this robot is it.
    """

    def __init__(self, share: Share, order: Sequence[int], below: Mapping[int, Boundary]) -> None:
        me, rank = share.robot, {robot: k for k, robot in enumerate(order)}
        usable, arrays = _usable(share)
        own = sorted(share.poses)
        named = {n for b in below.values() for n in b.nodes}
        guests = {n for n in named if n.robot != me}
        if not named - guests <= set(own) or not {n.robot for n in guests} <= set(order):
            raise BackendError(f"robot {me} was sent poses that nobody has: the members' shares do not fit together")
        pushed = _pushed(usable, me, rank)
        mine = np.array([_answers_for(e, me, rank, pushed, guests) for e in usable], dtype=bool)
        guests |= {n for e, m in zip(usable, mine, strict=True) if m for n in (e.i, e.j) if n.robot != me}
        self.nodes: list[NodeId] = own + sorted(guests)
        self.own_count = len(own)
        self.row = {n: k for k, n in enumerate(self.nodes)}
        ends = [(self.row[e.i], self.row[e.j]) for e, m in zip(usable, mine, strict=True) if m]
        self.edges = _placed(arrays.only(mine), ends)
        self.fixed = np.array([n.robot not in share.arbitrary_scale for n in self.nodes], dtype=bool)
        self.last = me == order[-1]
        self._held = share.held
        self.given = np.array([self.row[own[0]]] if self.last and share.held is None else [], dtype=np.intp)
        if share.held is not None:
            self._hold(share.held, self.places(share), share.scaled)
        touching = self._touching(usable, me, rank, pushed, below)
        outer = sorted((n, k) for n, k in self.row.items() if touching[k])
        self.outer = np.array([k for _, k in outer], dtype=np.intp)
        self.brought = {
            robot: np.array([self.row[n] for n in b.nodes], dtype=np.intp) for robot, b in sorted(below.items())
        }
        self.shared = np.zeros(len(self), dtype=bool)
        for rows in self.brought.values():
            self.shared[rows] = True
        self.label = self._parts(below)
        self.grounded = self._grounded(below)
        seen: dict[int, int] = dict.fromkeys(
            (n.robot for e in usable for n in (e.i, e.j) if rank[n.robot] > rank[me]), 1
        )
        for b in below.values():
            for robot, count in b.below.items():
                if robot != me:
                    seen[robot] = seen.get(robot, 0) + count
        labels, renamed = np.unique(self.label[self.outer], return_inverse=True)
        self.boundary = Boundary(
            tuple(self.nodes[k] for k in self.outer),
            tuple(frozenset(touching[k]) for k in self.outer),
            renamed.astype(np.intp),
            seen,
            1 + sum(b.robots for b in below.values()),
            frozenset(k for k, label in enumerate(labels.tolist()) if label in self.grounded),
        )
        later = {robot for t in touching for robot in t}
        self.next_robot = None if self.last else min(later, key=lambda r: rank[r], default=order[-1])
        self.reached = np.ones(len(self), dtype=bool)
        if share.held is None:
            self._lose(self._ends_here())

    @property
    def inner(self) -> NDArray[np.intp]:
        """Rows that are eliminated here: tied to the rest, and neither given nor of held priors."""
        rows = np.flatnonzero(self.reached[: len(self.nodes)])
        return np.setdiff1d(rows, [*self.outer, *self.given])

    @property
    def held(self) -> NDArray[np.intp]:
        """Rows that others find, or that are given."""
        rows = self.given if self.last else self.outer
        return rows[self.reached[rows]]

    def usable_edges(self) -> SimilarityEdges:
        """The edges between rows that are reached."""
        return self.edges.only(np.asarray(self.reached[self.edges.ends].all(axis=1)))

    def lose(self, rows: NDArray[np.intp]) -> None:
        """Mark rows, and what hangs together with them here, as not tied to the anchor."""
        self._lose(np.unique(self.label[rows]))

    def places(self, share: Share) -> Places:
        """Own poses where they are, and held priors; guests unknown."""
        out = Places(np.full((len(self.nodes), 4, 4), np.nan), np.zeros(len(self.nodes)))
        own = self.nodes[: self.own_count]
        out.poses[: self.own_count] = [share.poses[n] for n in own]
        out.log_units[: self.own_count] = share.log_units(own)
        return out if self._held is None else out.and_also(self._held.places)

    def __len__(self) -> int:
        """Number of rows: of nodes, then of held priors."""
        return len(self.fixed)

    def _grounded(self, below: Mapping[int, Boundary]) -> frozenset[int]:
        """Labels of parts that priors hold, held here or by robots before."""
        rows = [np.arange(len(self.nodes), len(self))]
        for robot, b in below.items():
            rows.append(self.brought[robot][np.isin(b.label, sorted(b.grounded))])
        return frozenset(self.label[np.concatenate(rows).astype(np.intp)].tolist())

    def _hold(self, held: HeldPriors, places: Places, scaled: bool) -> None:
        rows = np.array([self.row[n] for n in held.priors.nodes], dtype=np.intp)
        self.edges = self.edges.and_also(held.edges(rows, len(self.nodes), places.at(rows), scaled))
        self.fixed = np.append(self.fixed, np.ones(len(held), dtype=bool))

    def _lose(self, labels: NDArray[np.intp]) -> None:
        self.reached &= ~np.isin(self.label, labels)

    def _ends_here(self) -> NDArray[np.intp]:
        """Parts that nothing ties to poses that are passed on, nor to the anchor."""
        kept = self.label[self.given if self.last else self.outer]
        return np.setdiff1d(self.label, kept)

    def _touching(
        self,
        usable: Sequence[Edge],
        me: int,
        rank: Mapping[int, int],
        pushed: set[NodeId],
        below: Mapping[int, Boundary],
    ) -> list[set[int]]:
        """For each row the robots to come that have edges with it."""
        out: list[set[int]] = [set() for _ in range(len(self))]
        for b in below.values():
            for node, robots in zip(b.nodes, b.touching, strict=True):
                out[self.row[node]] |= robots
        for e in usable:
            for node, other in ((e.i, e.j), (e.j, e.i)):
                if node.robot == me and rank[other.robot] > rank[me]:
                    if node in pushed:
                        out[self.row[node]].add(other.robot)
                    else:
                        out[self.row[other]].add(other.robot)
        for row in out:
            row.discard(me)
            if any(rank[r] < rank[me] for r in row):
                raise BackendError(f"robot {me} was sent poses that a robot before it should have eliminated")
        return out

    def _parts(self, below: Mapping[int, Boundary]) -> NDArray[np.intp]:
        ends = [self.edges.ends]
        for robot, b in sorted(below.items()):
            rows = self.brought[robot]
            first = np.unique(b.label, return_index=True)[1]
            head = dict(zip(b.label[first].tolist(), rows[first].tolist(), strict=True))
            ends.append(np.array([(head[k], row) for k, row in zip(b.label.tolist(), rows.tolist(), strict=True)]))
        return parts(np.concatenate([e.reshape(-1, 2) for e in ends]).astype(np.intp), len(self))


def neighbours_by_edges(share: Share) -> dict[int, int]:
    """Robots with which edges of any weight are shared, and the smaller number of poses at one end of these."""
    ends: dict[int, tuple[set[NodeId], set[NodeId]]] = {}
    for e in _usable(share)[0]:
        if e.is_separator:
            mine, theirs = (e.i, e.j) if e.i.robot == share.robot else (e.j, e.i)
            pair = ends.setdefault(theirs.robot, (set(), set()))
            pair[0].add(mine)
            pair[1].add(theirs)
    return {robot: min(len(a), len(b)) for robot, (a, b) in sorted(ends.items())}


def _usable(share: Share) -> tuple[list[Edge], SimilarityEdges]:
    arrays = edges_of(share.edges, np.zeros((len(share.edges), 2), dtype=np.intp), share.dimension)
    used = (arrays.kappa > 0) & (arrays.tau > 0)
    return [e for e, u in zip(share.edges, used, strict=True) if u], arrays.only(used)


def _pushed(usable: Sequence[Edge], me: int, rank: Mapping[int, int]) -> set[NodeId]:
    """Own poses that go on, with their edges to robots to come: fewer than those at these edges' other ends."""
    pairs = []
    for e in usable:
        for node, other in ((e.i, e.j), (e.j, e.i)):
            if node.robot == me and rank[other.robot] > rank[me]:
                pairs.append((node, other))
    mine, theirs = sorted({a for a, _ in pairs}), sorted({b for _, b in pairs})
    left, right = {n: k for k, n in enumerate(mine)}, {n: k for k, n in enumerate(theirs)}
    return {mine[k] for k in smallest_cover((left[a], right[b]) for a, b in pairs)[0]}


def _answers_for(e: Edge, me: int, rank: Mapping[int, int], pushed: set[NodeId], guests: set[NodeId]) -> bool:
    """Whether this robot, and no other, counts an edge."""
    for node, other in ((e.i, e.j), (e.j, e.i)):
        if other.robot == me:
            continue
        return node not in pushed if rank[other.robot] > rank[me] else other in guests
    return True


def _placed(edges: SimilarityEdges, ends: Sequence[tuple[int, int]]) -> SimilarityEdges:
    return SimilarityEdges(
        np.array(ends, dtype=np.intp).reshape(-1, 2),
        edges.measured,
        edges.log_scale,
        edges.kappa,
        edges.tau,
        edges.precision,
    )
