"""The elected robot's memory of a group: its graph, what members have, and the corrections that a new edge asks for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence, Set
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...central.headings import with_corrections
from ...central.minimum import minimum
from ...central.odometry_steps import steps_of
from ...central.similarity_edges import Descended, SimilarityEdges
from ...errors import BackendError
from ...geometry import Array
from ...pose_graph.graph import NodeId
from ..condense import Known, freedom_of, noise_of
from ..settled import Settled
from ..share import Share
from .belief import most_rise
from .corrections import encode_correction
from .estimated_graph import EstimatedGraph
from .refinement import far, refined, stiffness

# Attempts with ever finer steps, and how much finer each is; then places go in full.
_ATTEMPTS, _FINER = 4, 8.0
# Share of what corrections may leave the cost above its optimum that is for rounding.
_FOR_ROUNDING = 0.25


@dataclass(frozen=True, eq=False)
class Correction:
    """Of one robot: its ``body``, the places that the robot will read, and ``cost``, F over its own edges with them."""

    robot: int
    body: bytes
    read: Known
    cost: float = 0.0


@dataclass(frozen=True, eq=False)
class Corrected:
    """``optimum``: F of the whole graph at best; ``cost``: with these corrections; ``late``: robots whose correction
    has to wait until they have received the one before; ``moved``: whether the elected robot's own poses have."""

    corrections: tuple[Correction, ...]
    optimum: float
    cost: float
    late: frozenset[int] = frozenset()
    moved: bool = True


class GroupEstimate:
    """The elected robot's: it adds edges to the group's graph, and finds whom to correct."""

    def __init__(self, share: Share, settled: Settled, careful: bool = False) -> None:
        """``share``: the elected robot's. ``careful``: an edge between two robots counts once both have named it, and
        new edges must be believable. No update knows lengths or headings of odometry: where edges call for
        them, it is not taken."""
        contributions, places = settled.contributions, settled.places
        self.graph = EstimatedGraph(contributions, places, share.anchor, share.arbitrary_scale, careful)
        self._leader, self._scaled, self._careful = share.robot, share.scaled, careful
        self._length_sigma, self._heading_sigma = share.length_sigma, share.heading_sigma
        self._metric = sorted(set(contributions) - share.arbitrary_scale)
        self._known = {robot: Known() for robot in contributions}
        for n, T in places.poses.items():
            self._known[n.robot].poses[n] = T
            self._known[n.robot].log_units[n] = places.log_units.get(n, 0.0)
        g, joined = self.graph, self.graph.joined
        edges = g.edges.only(joined[g.edges.ends[:, 0]])
        cost = float(edges.costs(g.poses, g.log_units).sum())
        self._before = cost, freedom_of(edges.ends, g.fixed[joined], [0])

    def corrected(self, share: float, busy: Set[int] = frozenset()) -> Corrected:
        """Corrections to as few robots as leave F at most ``share`` above its optimum; they count as made.

        ``busy``: robots that may get none yet. :class:`BackendError` where new edges raise F by more than right ones
        can: then nothing is changed.
        """
        g, joined = self.graph, self.graph.joined
        best, log_units = self._optimum(joined)
        edges, robot_of = g.edges.only(joined[g.edges.ends[:, 0]]), g.robot_of
        optimum = float(edges.costs(best, log_units).sum())
        freedom = freedom_of(edges.ends, g.fixed[joined], [0])
        if self._careful:
            self._believe(optimum, freedom)
        if self._length_sigma > 0 and self._odometry_is_off(best, log_units, joined, freedom):
            raise BackendError("matches call for other lengths or headings of odometry")
        allowed = share * max(optimum, noise_of(0.0, freedom) ** 2 * max(freedom, 1))
        # What has no place yet is sent in any case.
        now, now_units = g.poses.copy(), g.log_units.copy()
        unplaced = set(robot_of[joined & ~g.placed].tolist())
        made, (full, full_units) = self._made(edges, (best, log_units), joined, optimum, allowed)
        may_keep = [r for r in (*made, self._leader) if r not in unplaced]
        keeps = self._spared(edges, (full, full_units), (now, now_units), may_keep, optimum + allowed)
        late = frozenset(r for r in made if r not in keeps and r in busy)
        sent = [r for r in sorted(made) if r not in keeps and r not in busy]
        moves = self._leader not in keeps
        moved = joined & np.isin(robot_of, [*sent, *[self._leader] * moves])
        now[moved], now_units[moved] = full[moved], full_units[moved]
        g.poses, g.log_units = now, now_units
        g.placed |= moved
        for r in sent:
            self._known[r] = self._known[r].also(made[r].read)
        cost = float(edges.costs(now, now_units).sum())
        corrections = tuple(replace(made[r], cost=self._own_cost(r)) for r in sent)
        return Corrected(corrections, optimum, cost, late, moves)

    def _believe(self, optimum: float, freedom: int) -> None:
        """Hold F's rise since the last update against what right edges can raise it by."""
        before, free = self._before
        most = most_rise(before, free, freedom - free)
        if optimum - before > most:
            raise BackendError(
                f"new edges contradict the others: the cost rises by {optimum - before:.4g}, {most:.4g}"
                " at most where they are right"
            )
        self._before = optimum, freedom

    def _odometry_is_off(self, best: Array, log_units: Array, joined: NDArray[np.bool_], freedom: int) -> bool:
        """Whether a whole solution would find that odometry is too long or too short, or turns too much."""
        g = self.graph
        order = sorted(range(len(g.nodes)), key=lambda k: g.nodes[k])
        rank = np.argsort(order)
        edges, held, kept = g.edges.moved_to(rank), ~joined, g.fixed
        held[g.anchored] = True
        kept[held] = True
        number = {robot: k for k, robot in enumerate(self._metric)}
        robots = np.array([number.get(g.nodes[k].robot, -1) for k in order], dtype=np.intp)
        steps = steps_of(edges.ends, robots, len(self._metric), self._length_sigma, self._heading_sigma)
        found = Descended(best[order], log_units[order], 0)
        best_of = with_corrections(edges, found, np.flatnonzero(held[order]).tolist(), kept[order], steps, freedom)
        return best_of.lengths.used or best_of.headings.used

    def _own_cost(self, robot: int) -> float:
        """F over a robot's own edges as it has its poses."""
        g = self.graph
        mine = (g.robot_of[g.edges.ends] == robot).all(axis=1)
        return float(g.edges.only(mine).costs(g.poses, g.log_units).sum())

    def _made(
        self,
        edges: SimilarityEdges,
        best: tuple[Array, Array],
        joined: NDArray[np.bool_],
        optimum: float,
        allowed: float,
    ) -> tuple[dict[int, Correction], tuple[Array, Array]]:
        """Corrections of all robots, and where all poses are with them."""
        separators, robot_of = self._separators(joined), self.graph.robot_of
        made: dict[int, Correction] = {}
        full = best
        for attempt in range(_ATTEMPTS + 1):
            step = None if attempt == _ATTEMPTS else _FINER**-attempt
            made = self._encoded(*best, separators, allowed, step)
            full = self._completed(*best, robot_of, joined, made)
            if float(edges.costs(*full).sum()) <= optimum + 2.0 * _FOR_ROUNDING * allowed:
                break
        return made, full

    def _separators(self, joined: NDArray[np.bool_]) -> dict[int, list[NodeId]]:
        """By robot, the elected one left out, its poses with an edge to another robot."""
        g, robot = self.graph, self.graph.robot_of
        i, j = g.edges.ends.T
        across = (robot[i] != robot[j]) & joined[i]
        out: dict[int, list[NodeId]] = {}
        for k in np.unique(g.edges.ends[across]).tolist():
            out.setdefault(g.nodes[k].robot, []).append(g.nodes[k])
        out.pop(self._leader, None)
        return {robot: sorted(nodes) for robot, nodes in sorted(out.items())}

    def _optimum(self, joined: NDArray[np.bool_]) -> tuple[Array, Array]:
        """Poses and log units at F's optimum; nodes that are not joined to the anchor stay."""
        g = self.graph
        held = np.unique([g.anchored, *np.flatnonzero(~joined).tolist()])
        kept = g.fixed
        kept[held] = True
        found, units = refined(g.edges, g.poses, g.log_units, held, kept)
        if g.placed[joined].all() and not far(g.edges, g.poses, found):
            return found, units
        anew = minimum(g.edges, g.poses, g.log_units, held.tolist(), kept)
        costs = [float(g.edges.costs(*at).sum()) for at in ((found, units), (anew.poses, anew.log_units))]
        return (found, units) if costs[0] <= costs[1] else (anew.poses, anew.log_units)

    def _encoded(
        self, best: Array, log_units: Array, separators: Mapping[int, list[NodeId]], allowed: float, step: float | None
    ) -> dict[int, Correction]:
        """Corrections of all robots; ``step``: their steps over those whose rounding adds up to its share of what is
        ``allowed`` above the optimum; None: in full."""
        count = sum(map(len, separators.values()))
        # A number's rounding has a variance of a twelfth of its step's square, and costs that times its stiffness.
        one = (12.0 * _FOR_ROUNDING * allowed / (max(count, 1) * (7 if self._scaled else 6))) ** 0.5
        stiff = stiffness(self.graph.edges, log_units, len(self.graph.nodes))
        out: dict[int, Correction] = {}
        for robot, nodes in separators.items():
            rows = [self.graph.row[n] for n in nodes]
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
        g, poses, units = self.graph, best.copy(), log_units.copy()
        held = ~joined | (robot_of == self._leader)
        held[g.anchored] = True
        for correction in made.values():
            for n, T in correction.read.poses.items():
                k = g.row[n]
                poses[k], units[k], held[k] = T, correction.read.log_units[n], True
        poses[g.anchored], units[g.anchored] = g.poses[g.anchored], g.log_units[g.anchored]
        i, j = g.edges.ends.T
        within = g.edges.only((robot_of[i] == robot_of[j]) & ~(held[i] & held[j]))
        if held.all() or not len(within.ends):
            return poses, units
        rows = np.flatnonzero(held)
        kept = g.fixed
        kept[rows] = True
        return refined(within, poses, units, rows, kept)

    def _spared(
        self,
        edges: SimilarityEdges,
        full: tuple[Array, Array],
        now: tuple[Array, Array],
        may_keep: Sequence[int],
        most: float,
    ) -> set[int]:
        """Robots that can keep what they have, so many that F is ``most`` at most; those that cost least first, the
        elected one last: its correction costs nothing."""
        robot_of = self.graph.robot_of

        def cost(without: Iterable[int]) -> float:
            keep = np.isin(robot_of, list(without))
            poses, units = full[0].copy(), full[1].copy()
            poses[keep], units[keep] = now[0][keep], now[1][keep]
            return float(edges.costs(poses, units).sum())

        alone = {r: cost([r]) for r in may_keep}
        spared: set[int] = set()
        for r in sorted(alone, key=lambda r: (r == self._leader, alone[r], r)):
            if cost([*spared, r]) <= most:
                spared.add(r)
        return spared
