"""The graph of a group as its elected robot has it: nodes, where robots have them, edges, and edges that wait."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...central.similarity_edges import SimilarityEdges
from ...components import parts
from ...errors import BackendError
from ...geometry import se3_inverse
from ...pose_graph.graph import NodeId
from ..condense import Known
from ..contribution import Between, Contribution

# Edges that may wait for poses of others, or for their other robot.
_MOST_WAITING = 4096

Pair = tuple[NodeId, NodeId]


class EstimatedGraph:
    """``poses`` and ``log_units`` of all ``nodes`` as the robots have them: exact for shared poses, for the others up
    to the rounding of their edges; ``placed`` ``(n,)``: nodes that have a place; ``anchored``: row of the one that
    stays.

    ``both``: an edge between two robots counts once both have named it.
    """

    def __init__(
        self,
        contributions: Mapping[int, Contribution],
        places: Known,
        anchor: int,
        arbitrary_scale: frozenset[int],
        both: bool,
    ) -> None:
        self.nodes: list[NodeId] = []
        self.row: dict[NodeId, int] = {}
        self.poses, self.log_units = np.zeros((0, 4, 4)), np.zeros(0)
        self.placed = np.zeros(0, dtype=bool)
        self._arbitrary_scale, self._both = arbitrary_scale, both
        self._edges: SimilarityEdges | None = None
        self._last: dict[int, int] = {}
        self._waiting: list[tuple[Between, int]] = []
        self._named: set[tuple[int, Pair]] = set()
        first = contributions[anchor].first
        for robot in sorted(contributions):
            c = contributions[robot]
            self._append(c.graph.nodes, places.also(first) if robot == anchor else places)
            self._join(c.graph.edges.moved_to(np.array([self.row[n] for n in c.graph.nodes], dtype=np.intp)))
        for robot in sorted(contributions):
            between = contributions[robot].between
            inside = between.only([i in self.row and j in self.row for i, j in between.nodes])
            self._join(inside.edges.moved_to(self._rows_of(inside)))
        self.anchored = self.row[contributions[anchor].graph.nodes[0]]

    @property
    def edges(self) -> SimilarityEdges:
        """All edges that count."""
        assert self._edges is not None
        return self._edges

    @property
    def fixed(self) -> NDArray[np.bool_]:
        """Nodes whose unit stays."""
        return np.array([n.robot not in self._arbitrary_scale for n in self.nodes], dtype=bool)

    @property
    def robot_of(self) -> NDArray[np.intp]:
        """Each node's robot."""
        return np.array([n.robot for n in self.nodes], dtype=np.intp)

    @property
    def joined(self) -> NDArray[np.bool_]:
        """Nodes that edges join to the anchor."""
        label = parts(self.edges.ends, len(self.nodes))
        return np.asarray(label == label[self.anchored])

    @property
    def waits(self) -> bool:
        """Whether an edge that both its robots have came before the poses of one."""
        return any(self._agreed(pair, whose) for between, whose in self._waiting for pair in between.nodes)

    def add(self, given: Between, sender: int, named: Iterable[Pair] = ()) -> int:
        """Take new edges in, and the ends of those that the sender has, too; returns how many edges count from now on.

        Nodes that are new must be the sender's own, or come later from whom they are. :class:`BackendError` where they
        cannot be: then nothing is changed.
        """
        also = {(sender, pair) for pair in named}
        for pair in (*given.nodes, *(pair for _, pair in also)):
            if all(n.robot != sender for n in pair):
                raise BackendError(f"robot {sender} brings an edge of others: {pair[0]} - {pair[1]}")
        own = {n for pair in given.nodes for n in pair if n.robot == sender}
        ready: list[Between] = []
        waiting: list[tuple[Between, int]] = []
        for between, whose in [(given, sender), *self._waiting]:
            here = [self._here(pair, whose, own) and self._agreed(pair, whose, also) for pair in between.nodes]
            ready.append(between.only(here))
            if not all(here):
                waiting.append((between.only([not h for h in here]), whose))
        if sum(len(between.nodes) for between, _ in waiting) + len(self._named | also) > _MOST_WAITING:
            raise BackendError(f"more than {_MOST_WAITING} edges that wait for what nobody has sent")
        self._waiting, self._named = waiting, self._named | also
        for between in ready:
            self._take(between)
        return sum(len(between.nodes) for between in ready)

    def withdraw(self, pairs: Iterable[Pair], sender: int) -> bool:
        """Edges of these nodes do not count until the sender gives or names them again; returns whether any counted.

        :class:`BackendError` where they are not the sender's, or poses would hang on nothing: then nothing is changed.
        """
        gone = set(pairs)
        if any(all(n.robot != sender for n in pair) for pair in gone):
            raise BackendError(f"robot {sender} withdraws an edge of others")
        rows = {(self.row[i], self.row[j]): (i, j) for i, j in gone if i in self.row and j in self.row}
        hit = np.array([(i, j) in rows for i, j in self.edges.ends.tolist()], dtype=bool)
        label = parts(self.edges.ends[~hit], len(self.nodes))
        if not (label == label[self.anchored])[self.joined].all():
            raise BackendError("without an edge that is withdrawn the group does not hang together")
        taken = self.edges.only(hit)
        nodes = tuple(rows[i, j] for i, j in taken.ends.tolist())
        back = Between(nodes, replace(taken, ends=_in_pairs(len(nodes))), np.zeros(len(nodes)))
        kept = [
            (b.only([whose != sender or pair not in gone for pair in b.nodes]), whose) for b, whose in self._waiting
        ]
        for other in sorted({n.robot for pair in nodes for n in pair} - {sender}):
            # The other robot still has them.
            kept.append((back.only([other in (i.robot, j.robot) for i, j in nodes]), other))
            self._named |= {(other, pair) for pair in nodes if other in (pair[0].robot, pair[1].robot)}
        self._waiting = [(b, whose) for b, whose in kept if b.nodes]
        self._named -= {(sender, pair) for pair in gone}
        self._edges = self.edges.only(~hit)
        return bool(hit.any())

    def place(self, nodes: Iterable[NodeId]) -> Known:
        """Where these poses are now, those of them that have a place."""
        rows = [(n, self.row[n]) for n in nodes if n in self.row and self.placed[self.row[n]]]
        return Known({n: self.poses[k] for n, k in rows}, {n: float(self.log_units[k]) for n, k in rows})

    def _here(self, pair: Pair, sender: int, own: set[NodeId]) -> bool:
        """Whether both poses of an edge are known, or among those that come with it; :class:`BackendError` where one
        never will be."""
        missing = [n for n in pair if n not in self.row and n not in own and n.robot != sender]
        for n in missing:
            last = self._last.get(n.robot)
            if last is None or n.index < last:
                raise BackendError(f"an edge to {n}, which was left out of what its robot contributed")
        return not missing

    def _agreed(self, pair: Pair, sender: int, also: Iterable[tuple[int, Pair]] = ()) -> bool:
        """Whether the other robot of the sender's edge has it, too, as far as it must."""
        other = next((n.robot for n in pair if n.robot != sender), sender)
        return not self._both or other == sender or (other, pair) in self._named or (other, pair) in set(also)

    def _take(self, given: Between) -> None:
        new = [n for n in dict.fromkeys(n for pair in given.nodes for n in pair) if n not in self.row]
        self._append(new, Known())
        edges = given.edges.moved_to(self._rows_of(given))
        for k, (i, j) in enumerate(edges.ends.tolist()):
            # The start of a new pose; the optimum is found from there.
            for a, b, forward in ((i, j, True), (j, i, False)):
                if self.placed[a] and not self.placed[b]:
                    T = edges.measured[k] if forward else se3_inverse(edges.measured[k])
                    grown = float(edges.log_scale[k]) if forward else -float(edges.log_scale[k])
                    self.log_units[b] = self.log_units[a] + grown
                    step = T.copy()
                    step[:3, 3] *= np.exp(self.log_units[a] if forward else self.log_units[b])
                    self.poses[b], self.placed[b] = self.poses[a] @ step, True
        self._join(edges)

    def _append(self, nodes: Iterable[NodeId], places: Known) -> None:
        for n in nodes:
            self.row[n] = len(self.nodes)
            self.nodes.append(n)
            self._last[n.robot] = max(n.index, self._last.get(n.robot, 0))
        new = self.nodes[len(self.poses) :]
        poses = [places.poses.get(n, np.eye(4)) for n in new]
        self.poses = np.concatenate([self.poses, np.array(poses).reshape(-1, 4, 4)])
        units = np.array([places.log_units.get(n, 0.0) for n in new], dtype=np.float64)
        self.log_units = np.concatenate([self.log_units, units])
        self.placed = np.concatenate([self.placed, np.array([n in places.poses for n in new], dtype=bool)])

    def _join(self, edges: SimilarityEdges) -> None:
        self._edges = edges if self._edges is None else self._edges.and_also(edges)

    def _rows_of(self, between: Between) -> NDArray[np.intp]:
        return np.array([self.row[n] for pair in between.nodes for n in pair], dtype=np.intp)


def _in_pairs(count: int) -> NDArray[np.intp]:
    """Ends ``(count, 2)`` of edges whose nodes stand one after the other."""
    return np.arange(2 * count, dtype=np.intp).reshape(-1, 2)
