"""A robot's own graph without what its group does not need: stretches of odometry become one edge each.

What stays are the ends of edges to other robots and of loops, and every ``longest``-th node between. An edge made of
several has the weights that F's law of noise gives it, up to the directions: rotation noise early in a stretch moves
its end sideways, which one translation weight for all directions holds only in the mean. Short stretches lose next to
nothing; ``longest`` 1 condenses nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..central.minimum import minimum, near_minimum
from ..central.odometry_steps import steps_of
from ..central.origin import OriginPriors
from ..central.similarity_edges import SimilarityEdges, edges_of
from ..components import first_of_parts, parts
from ..geometry import Array, se3_inverse
from ..pose_graph.graph import NodeId
from .share import Share

# A chain of more edges than this is sent more finely: one loop that others close has all of its rounding to bear.
_IN_A_CHAIN = 10.0


@dataclass(frozen=True, eq=False)
class Condensed:
    """``nodes`` that stay, sorted; ``edges`` between them."""

    nodes: list[NodeId]
    edges: SimilarityEdges


@dataclass(frozen=True, eq=False)
class Known:
    """Nodes that have a place: poses ``T_O_i`` and, where units are variables, their logarithms (0 if not named)."""

    poses: dict[NodeId, Array] = field(default_factory=dict)
    log_units: dict[NodeId, float] = field(default_factory=dict)

    def also(self, other: Known) -> Known:
        """These, and the other's over them."""
        return Known({**self.poses, **other.poses}, {**self.log_units, **other.log_units})


class OwnGraph:
    """A robot's own nodes and the ``edges`` between them, as arrays; ``fixed`` ``(n,)``: nodes whose unit stays."""

    def __init__(self, share: Share) -> None:
        self.nodes = sorted(share.poses)
        self.row = {n: k for k, n in enumerate(self.nodes)}
        self.poses = np.array([share.poses[n] for n in self.nodes])
        self.log_units = share.log_units(self.nodes)
        self.fixed = np.full(len(self.nodes), share.robot not in share.arbitrary_scale)
        own = [e for e in share.edges if e.i.robot == e.j.robot]
        self._dimension = share.dimension
        self._separators = {n for e in share.edges if e.is_separator for n in (e.i, e.j) if n in self.row}
        ends = np.array([(self.row[e.i], self.row[e.j]) for e in own], dtype=np.intp).reshape(-1, 2)
        self.edges = edges_of(own, ends, share.dimension)
        self.priors = OriginPriors.of(share.priors, share.dimension)
        numbers = np.where(self.fixed, 0, -1)
        self.steps = steps_of(ends, numbers, 1, share.length_sigma if self.fixed.all() else 0.0, share.heading_sigma)

    def cost(self, poses: Array, log_units: Array) -> float:
        """F over the own edges, of poses ``(n, 4, 4)`` and log units ``(n,)`` of all own nodes; with the length
        and the turn of odometry that suit them best, where they are unknown."""
        if self.steps.count:
            return self.steps.cost(self.edges, poses, log_units)
        return float(self.edges.costs(poses, log_units).sum())

    def costs(self, known: Known) -> Array:
        """Shares of F ``(m,)`` of the own edges, with these places of all own nodes."""
        poses = np.array([known.poses[n] for n in self.nodes])
        return self.edges.costs(poses, np.array([known.log_units.get(n, 0.0) for n in self.nodes]))

    def length(self, poses: Array, log_units: Array) -> float:
        """What odometry's lengths are to be multiplied by to suit these poses best; 1 where lengths are known."""
        return float(self.steps.factors(self.edges, poses, log_units)[0]) if self.steps.count else 1.0

    def turn(self, poses: Array) -> Array:
        """By how much more ``(3,)`` odometry is to turn to suit these poses best, rad/m; 0 where headings are known."""
        return self.steps.rates(self.edges, poses)[0] if self.steps.count else np.zeros(3)

    def known(self, nodes: Sequence[NodeId]) -> Known:
        """Where these own nodes are now."""
        rows = [self.row[n] for n in nodes]
        poses, log_units = self.poses[rows], self.log_units[rows].tolist()
        return Known(dict(zip(nodes, poses, strict=True)), dict(zip(nodes, log_units, strict=True)))

    def exactness(self) -> float:
        """How many times finer than the stated standard deviations measurements are to be sent: as the residuals are at
        the optimum of the own edges; where these close no loop as many edges' rounding must add up to little.
        """
        edges = self.edges.only(self.edges.kappa > 0)
        held = first_of_parts(edges.ends, len(self.poses))
        freedom = freedom_of(edges.ends, self.fixed, held)
        if freedom <= 0:
            return float(np.sqrt(max(1.0, len(edges.ends) / _IN_A_CHAIN)))
        found = near_minimum(edges, self.poses, self.log_units, held, self._kept(held), steps=2)
        return 1.0 / noise_of(float(edges.costs(found.poses, found.log_units).sum()), freedom)

    def _kept(self, held: Sequence[int]) -> NDArray[np.bool_]:
        kept = self.fixed.copy()
        kept[list(held)] = True
        return kept

    def condensed(self, longest: int) -> Condensed:
        """At most ``longest`` edges made into one."""
        ends, used = self.edges.ends, self.edges.kappa > 0
        degree = np.bincount(ends[used].ravel(), minlength=len(self.nodes))
        following = np.abs(ends[:, 0] - ends[:, 1]) == 1
        kept = degree != 2
        kept[0] = True
        kept[[self.row[n] for n in (*self._separators, *self.priors.nodes)]] = True
        # Loops' ends stay; so what goes has the node before and the node after as its only neighbours.
        kept[ends[used & ~following].ravel()] = True
        rows: list[tuple[int, int, list[int]]] = [
            (int(i), int(j), [k]) for k, (i, j) in enumerate(ends) if used[k] and kept[i] and kept[j]
        ]
        between = {int(min(p)): k for k, p in enumerate(ends) if used[k] and following[k]}
        rows += self._stretches(kept, between, longest)
        stays = np.flatnonzero(kept)
        position = np.full(len(kept), -1)
        position[stays] = np.arange(len(stays))
        new_ends = position[np.array([(i, j) for i, j, _ in rows], dtype=np.intp).reshape(-1, 2)]
        merged = [self._merged(i, edges) for i, _, edges in rows]
        measured = np.array([T for T, _ in merged]).reshape(-1, 4, 4)
        numbers = np.array([numbers for _, numbers in merged], dtype=np.float64).reshape(-1, 4)
        return Condensed([self.nodes[k] for k in stays], SimilarityEdges(new_ends, measured, *numbers.T))

    def _stretches(
        self, kept: NDArray[np.bool_], between: dict[int, int], longest: int
    ) -> list[tuple[int, int, list[int]]]:
        """Start, end and edges of what becomes one edge; marks further nodes in ``kept`` where it would be too long.

        ``between``: by node, its edge to the node after it. What hangs on one end only is left out: it follows.
        """
        first = kept.copy()
        out: list[tuple[int, int, list[int]]] = []
        stretch: list[int] = []
        start = -1
        for n in range(len(kept)):
            if kept[n] or (start >= 0 and len(stretch) == longest):
                if start >= 0 and not (len(stretch) == 1 and first[start] and first[n]):
                    out.append(self._directed(start, n, stretch))
                kept[n] = True
                start, stretch = n, []
            if n not in between:
                start = -1
            elif start >= 0:
                stretch = [*stretch, between[n]]
        return out

    def _directed(self, start: int, end: int, stretch: list[int]) -> tuple[int, int, list[int]]:
        """A single edge keeps its direction: its measurement stays, and F weighs a shift in its first node's frame."""
        if len(stretch) == 1:
            start, end = self.edges.ends[stretch[0]].tolist()
        return start, end, stretch

    def _merged(self, start: int, stretch: list[int]) -> tuple[Array, tuple[float, float, float, float]]:
        """Measurement, log scale and weights of edges in a row from node ``start``: variances add up, and each turn's
        noise is a shift of the end by its distance, each unit's one along it.
        """
        e = self.edges
        if len(stretch) == 1:
            k = stretch[0]
            return e.measured[k], (float(e.log_scale[k]), float(e.kappa[k]), float(e.tau[k]), float(e.precision[k]))
        T, at, log_scale = np.eye(4), start, 0.0
        steps = []
        for k in stretch:
            i, j = e.ends[k]
            step, grown = e.measured[k], float(e.log_scale[k])
            if i != at:
                step, grown = se3_inverse(step), -grown
                step[:3, 3] *= np.exp(grown)
            step = step.copy()
            step[:3, 3] *= np.exp(log_scale)
            T, log_scale = T @ step, log_scale + grown
            at = int(j if i == at else i)
            steps.append(T[:3, 3].copy())
        distance2 = ((T[:3, 3] - np.array(steps)) ** 2).sum(axis=1)
        kappa, tau, precision = e.kappa[stretch], e.tau[stretch], e.precision[stretch]
        # Variance of the turn about each axis is 1 / (2 kappa); about all of them it moves the end in two directions
        # of three (in the plane: about one axis, in one direction of two); a unit's moves it in one.
        share = 1.0 / 3.0 if self._dimension == 3 else 1.0 / 4.0
        spread = 1.0 / tau + share * distance2 / kappa
        if not self.fixed[start]:
            spread = spread + distance2 / precision / self._dimension
        numbers = (log_scale, 1.0 / (1.0 / kappa).sum(), 1.0 / spread.sum(), 1.0 / (1.0 / precision).sum())
        return T, (numbers[0], float(numbers[1]), float(numbers[2]), float(numbers[3]))

    def completed(self, known: Known) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Poses ``(n, 4, 4)`` and log units ``(n,)`` of all own nodes that minimise F with the ``known`` ones held, and
        which ``(n,)`` they are tied to; the others keep theirs.
        """
        poses, log_units = self.poses.copy(), self.log_units.copy()
        held = np.array(sorted(self.row[n] for n in known.poses), dtype=np.intp)
        for n, T in known.poses.items():
            poses[self.row[n]] = T
            log_units[self.row[n]] = known.log_units.get(n, 0.0)
        edges = self._as_long_as(known).only(self.edges.kappa > 0)
        label = parts(edges.ends, len(poses))
        reached = np.isin(label, label[held])
        fixed = sorted({*held.tolist(), *np.flatnonzero(~reached).tolist()})
        if len(fixed) == len(poses):
            return poses, log_units, reached
        found = minimum(edges, poses, log_units, fixed, self._kept(fixed))
        return found.poses, found.log_units, reached

    def _as_long_as(self, known: Known) -> SimilarityEdges:
        """The own edges, odometry with the length and turn that it has between ``known`` nodes."""
        if not self.steps.count:
            return self.edges
        placed = np.full_like(self.poses, np.nan)
        for n, T in known.poses.items():
            placed[self.row[n]] = T
        return self.steps.fitting(self.edges, placed, self.log_units)


def freedom_of(ends: NDArray[np.intp], fixed: NDArray[np.bool_], held: Sequence[int]) -> int:
    """Degrees of freedom that residuals of edges have left, with the nodes ``held`` given and the units of those
    ``fixed`` ``(n,)`` no variables."""
    turns = 6 * (len(ends) - len(fixed) + len(held))
    free = ~fixed
    free[list(held)] = False
    measured = int((~fixed[ends].all(axis=1)).sum())
    return turns + measured - int(free.sum())


def noise_of(cost: float, freedom: int) -> float:
    """Standard deviation of residuals over the stated one, from F and its degrees of freedom; within 1e-4 and 1."""
    return float(np.clip(np.sqrt(cost / freedom), 1e-4, 1.0)) if freedom > 0 else 1.0
