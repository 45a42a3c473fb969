"""The elected robot's memory of a group: its graph, what members have, and the corrections that a new edge asks for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...central.minimum import minimum
from ...central.similarity_edges import SimilarityEdges
from ...components import parts
from ...errors import BackendError
from ...geometry import Array, se3_inverse
from ...pose_graph.graph import NodeId
from ..condense import Known, freedom_of, noise_of
from ..contribution import Between, Contribution
from .corrections import encode_correction
from .refinement import far, refined, stiffness

# Attempts with ever finer steps, and how much finer each is; then places go in full.
_ATTEMPTS, _FINER = 4, 8.0
# Edges that may wait for poses of others.
_MOST_WAITING = 4096
# Share of what corrections may leave the cost above its optimum that is for rounding.
_FOR_ROUNDING = 0.25


@dataclass(frozen=True, eq=False)
class Correction:
    """Of one robot: its ``body``, and the places that the robot will read."""

    robot: int
    body: bytes
    read: Known


@dataclass(frozen=True, eq=False)
class Corrected:
    """``optimum``: F of the whole graph at best; ``cost``: with these corrections; ``late``: robots whose correction
    has to wait until they have received the one before."""

    corrections: tuple[Correction, ...]
    optimum: float
    cost: float
    late: frozenset[int] = frozenset()


class GroupEstimate:
    """``poses`` and ``log_units`` of all nodes as the robots have them: exact for shared poses, for the others up to
    the rounding of their edges."""

    def __init__(
        self,
        contributions: Mapping[int, Contribution],
        places: Known,
        anchor: int,
        leader: int,
        arbitrary_scale: frozenset[int],
    ) -> None:
        self._leader, self._arbitrary_scale = leader, arbitrary_scale
        self._scaled = bool(arbitrary_scale)
        self._nodes: list[NodeId] = []
        self._row: dict[NodeId, int] = {}
        self._last: dict[int, int] = {}
        self._waiting: list[tuple[Between, int]] = []
        self._poses, self._log_units = np.zeros((0, 4, 4)), np.zeros(0)
        self._placed = np.zeros(0, dtype=bool)
        self._edges: SimilarityEdges | None = None
        self._known = {robot: Known() for robot in contributions}
        first = contributions[anchor].first
        for robot in sorted(contributions):
            c = contributions[robot]
            self._append(c.graph.nodes, places.also(first) if robot == anchor else places)
            self._join(c.graph.edges.moved_to(np.array([self._row[n] for n in c.graph.nodes], dtype=np.intp)))
        for robot in sorted(contributions):
            between = contributions[robot].between
            inside = between.only([i in self._row and j in self._row for i, j in between.nodes])
            self._join(inside.edges.moved_to(self._rows_of(inside)))
        self._anchored = self._row[contributions[anchor].graph.nodes[0]]
        for n, T in places.poses.items():
            self._known[n.robot].poses[n] = T
            self._known[n.robot].log_units[n] = places.log_units.get(n, 0.0)

    @property
    def nodes(self) -> int:
        """Number of poses."""
        return len(self._nodes)

    @property
    def waits(self) -> bool:
        """Whether an edge to another robot's newest poses came before these."""
        return bool(self._waiting)

    def add(self, given: Between, sender: int) -> None:
        """Take new edges in; nodes that are new must be the sender's own, or come later from whom they are.
        :class:`BackendError` where they cannot be: then nothing is changed."""
        waiting: list[tuple[Between, int]] = []
        for between, whose in [(given, sender), *self._waiting]:
            later = [self._comes_later(pair, whose) for pair in between.nodes]
            self._take(between.only([not wait for wait in later]))
            if any(later):
                waiting.append((between.only(later), whose))
        if sum(len(between.nodes) for between, _ in waiting) > _MOST_WAITING:
            raise BackendError(f"more than {_MOST_WAITING} edges to poses that nobody has sent")
        self._waiting = waiting

    def _comes_later(self, pair: tuple[NodeId, NodeId], sender: int) -> bool:
        """Whether an edge has to wait for a pose; :class:`BackendError` where it cannot be."""
        if all(n.robot != sender for n in pair):
            raise BackendError(f"robot {sender} brings an edge of others: {pair[0]} - {pair[1]}")
        for n in pair:
            if n in self._row or n.robot == sender:
                continue
            last = self._last.get(n.robot)
            if last is None or n.index < last:
                raise BackendError(f"an edge to {n}, which was left out of what its robot contributed")
            return True
        return False

    def _take(self, given: Between) -> None:
        new = [n for n in dict.fromkeys(n for pair in given.nodes for n in pair) if n not in self._row]
        self._append(new, Known())
        edges = given.edges.moved_to(self._rows_of(given))
        for k, (i, j) in enumerate(edges.ends.tolist()):
            # The start of a new pose; the optimum is found from there.
            for a, b, forward in ((i, j, True), (j, i, False)):
                if self._placed[a] and not self._placed[b]:
                    T = edges.measured[k] if forward else se3_inverse(edges.measured[k])
                    grown = float(edges.log_scale[k]) if forward else -float(edges.log_scale[k])
                    self._log_units[b] = self._log_units[a] + grown
                    step = T.copy()
                    step[:3, 3] *= np.exp(self._log_units[a] if forward else self._log_units[b])
                    self._poses[b], self._placed[b] = self._poses[a] @ step, True
        self._join(edges)

    def place(self, nodes: Iterable[NodeId]) -> Known:
        """Where these poses are now, those of them that have a place."""
        rows = [(n, self._row[n]) for n in nodes if n in self._row and self._placed[self._row[n]]]
        return Known({n: self._poses[k] for n, k in rows}, {n: float(self._log_units[k]) for n, k in rows})

    def corrected(self, share: float, busy: Set[int] = frozenset()) -> Corrected:
        """Corrections to as few robots as leave F at most ``share`` above its optimum; they count as made.

        ``busy``: robots that may get none yet. The elected robot's own poses need none: they are at the optimum.
        """
        best, log_units, joined = self._optimum()
        edges = self._all.only(joined[self._all.ends[:, 0]])
        robot_of = np.array([n.robot for n in self._nodes], dtype=np.intp)
        separators = self._separators(joined)
        optimum = float(edges.costs(best, log_units).sum())
        freedom = freedom_of(edges.ends, self._fixed[joined], [0])
        allowed = share * max(optimum, noise_of(0.0, freedom) ** 2 * max(freedom, 1))
        # What robots that get nothing keep; what has no place yet is sent in any case.
        now, now_units = self._poses.copy(), self._log_units.copy()
        own = joined & (robot_of == self._leader)
        now[own], now_units[own] = best[own], log_units[own]
        unplaced = sorted(set(robot_of[joined & ~self._placed].tolist()))
        made: dict[int, Correction] = {}
        full, full_units = best, log_units
        for attempt in range(_ATTEMPTS + 1):
            step = None if attempt == _ATTEMPTS else _FINER**-attempt
            made = self._encoded(best, log_units, separators, allowed, step)
            full, full_units = self._completed(best, log_units, robot_of, joined, made)
            if float(edges.costs(full, full_units).sum()) <= optimum + 2.0 * _FOR_ROUNDING * allowed:
                break
        keeps = self._spared(edges, (full, full_units), (now, now_units), robot_of, made, optimum + allowed, unplaced)
        late = frozenset(r for r in made if r not in keeps and r in busy)
        sent = [r for r in sorted(made) if r not in keeps and r not in busy]
        moved = joined & np.isin(robot_of, sent)
        now[moved], now_units[moved] = full[moved], full_units[moved]
        self._poses, self._log_units = now, now_units
        self._placed |= moved | own
        for r in sent:
            self._known[r] = self._known[r].also(made[r].read)
        cost = float(edges.costs(now, now_units).sum())
        return Corrected(tuple(made[r] for r in sent), optimum, cost, late)

    @property
    def _all(self) -> SimilarityEdges:
        assert self._edges is not None
        return self._edges

    @property
    def _fixed(self) -> NDArray[np.bool_]:
        """Nodes whose unit stays."""
        return np.array([n.robot not in self._arbitrary_scale for n in self._nodes], dtype=bool)

    def _append(self, nodes: Iterable[NodeId], places: Known) -> None:
        for n in nodes:
            self._row[n] = len(self._nodes)
            self._nodes.append(n)
            self._last[n.robot] = max(n.index, self._last.get(n.robot, 0))
        new = self._nodes[len(self._poses) :]
        poses = [places.poses.get(n, np.eye(4)) for n in new]
        self._poses = np.concatenate([self._poses, np.array(poses).reshape(-1, 4, 4)])
        units = np.array([places.log_units.get(n, 0.0) for n in new], dtype=np.float64)
        self._log_units = np.concatenate([self._log_units, units])
        self._placed = np.concatenate([self._placed, np.array([n in places.poses for n in new], dtype=bool)])

    def _join(self, edges: SimilarityEdges) -> None:
        self._edges = edges if self._edges is None else self._edges.and_also(edges)

    def _rows_of(self, between: Between) -> NDArray[np.intp]:
        return np.array([self._row[n] for pair in between.nodes for n in pair], dtype=np.intp)

    def _separators(self, joined: NDArray[np.bool_]) -> dict[int, list[NodeId]]:
        """By robot, the elected one left out, its poses with an edge to another robot."""
        robot = np.array([n.robot for n in self._nodes], dtype=np.intp)
        i, j = self._all.ends.T
        across = (robot[i] != robot[j]) & joined[i]
        out: dict[int, list[NodeId]] = {}
        for k in np.unique(self._all.ends[across]).tolist():
            out.setdefault(self._nodes[k].robot, []).append(self._nodes[k])
        out.pop(self._leader, None)
        return {robot: sorted(nodes) for robot, nodes in sorted(out.items())}

    def _optimum(self) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Poses and log units at F's optimum, and the nodes joined to the anchor; the others stay."""
        label = parts(self._all.ends, len(self._nodes))
        joined = label == label[self._anchored]
        held = np.unique([self._anchored, *np.flatnonzero(~joined).tolist()])
        kept = self._fixed
        kept[held] = True
        found, units = refined(self._all, self._poses, self._log_units, held, kept)
        if self._placed[joined].all() and not far(self._all, self._poses, found):
            return found, units, joined
        anew = minimum(self._all, self._poses, self._log_units, held.tolist(), kept)
        costs = [float(self._all.costs(*at).sum()) for at in ((found, units), (anew.poses, anew.log_units))]
        return (found, units, joined) if costs[0] <= costs[1] else (anew.poses, anew.log_units, joined)

    def _encoded(
        self, best: Array, log_units: Array, separators: Mapping[int, list[NodeId]], allowed: float, step: float | None
    ) -> dict[int, Correction]:
        """Corrections of all robots; ``step``: their steps over those whose rounding adds up to its share of what is
        ``allowed`` above the optimum; None: in full."""
        count = sum(map(len, separators.values()))
        # A number's rounding has a variance of a twelfth of its step's square, and costs that times its stiffness.
        one = (12.0 * _FOR_ROUNDING * allowed / (max(count, 1) * (7 if self._scaled else 6))) ** 0.5
        stiff = stiffness(self._all, log_units, len(self._nodes))
        out: dict[int, Correction] = {}
        for robot, nodes in separators.items():
            rows = [self._row[n] for n in nodes]
            places = Known(
                {n: best[k] for n, k in zip(nodes, rows, strict=True)},
                {n: float(log_units[k]) for n, k in zip(nodes, rows, strict=True)},
            )
            sizes = None if step is None else step * one / np.sqrt(stiff[rows].max(axis=0))
            out[robot] = Correction(robot, *encode_correction(nodes, places, self._known[robot], sizes, self._scaled))
        return out

    def _completed(
        self,
        best: Array,
        log_units: Array,
        robot_of: NDArray[np.intp],
        joined: NDArray[np.bool_],
        made: Mapping[int, Correction],
    ) -> tuple[Array, Array]:
        """Poses and log units once robots have placed the rest of their own poses around the corrected ones."""
        poses, units = best.copy(), log_units.copy()
        held = ~joined | (robot_of == self._leader)
        held[self._anchored] = True
        for correction in made.values():
            for n, T in correction.read.poses.items():
                k = self._row[n]
                poses[k], units[k], held[k] = T, correction.read.log_units[n], True
        poses[self._anchored], units[self._anchored] = self._poses[self._anchored], self._log_units[self._anchored]
        i, j = self._all.ends.T
        within = self._all.only((robot_of[i] == robot_of[j]) & ~(held[i] & held[j]))
        if held.all() or not len(within.ends):
            return poses, units
        rows = np.flatnonzero(held)
        kept = self._fixed
        kept[rows] = True
        return refined(within, poses, units, rows, kept)

    def _spared(
        self,
        edges: SimilarityEdges,
        full: tuple[Array, Array],
        now: tuple[Array, Array],
        robot_of: NDArray[np.intp],
        made: Mapping[int, Correction],
        most: float,
        unplaced: Iterable[int],
    ) -> set[int]:
        """Robots that can keep what they have, so many that F is ``most`` at most; those that cost least first."""

        def cost(without: Iterable[int]) -> float:
            keep = np.isin(robot_of, list(without))
            poses, units = full[0].copy(), full[1].copy()
            poses[keep], units[keep] = now[0][keep], now[1][keep]
            return float(edges.costs(poses, units).sum())

        alone = {r: cost([r]) for r in made if r not in set(unplaced)}
        spared: set[int] = set()
        for r in sorted(alone, key=lambda r: (alone[r], r)):
            if cost([*spared, r]) <= most:
                spared.add(r)
        return spared
