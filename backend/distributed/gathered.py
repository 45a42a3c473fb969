"""The elected robot's work: put the contributions together, solve, and weigh what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ..central.headings import with_corrections
from ..central.minimum import minimum
from ..central.odometry_steps import steps_of
from ..central.origin import NO_PRIORS, OriginPriors, origin_of, with_origin
from ..central.similarity_edges import SimilarityEdges
from ..components import parts
from ..pose_graph.graph import NodeId
from .condense import Known, freedom_of, noise_of
from .contribution import Between, Contribution
from .share import anchor_of

# Edges for each that closes a loop beyond which poses are sent more finely.
_EDGES_A_LOOP = 5.0


@dataclass(frozen=True, eq=False)
class Gathered:
    """The group's solution: ``places`` of the nodes that are joined to the anchor; ``iterations`` of the solver;
    ``between``: edges between members, as each sent them; ``exactness``: how many times finer than the deviations
    stated poses are to be sent; ``cost``: F of the edges, or what counts as none; ``priors``: those that were used;
    ``lengths``, ``headings``: whether factors and rates of odometry were found; ``total``: F of the contributed edges
    at ``places``.
    """

    places: Known
    iterations: int
    between: tuple[Between, ...]
    exactness: float
    cost: float = float("inf")
    priors: OriginPriors = NO_PRIORS
    lengths: bool = False
    headings: bool = False
    total: float = 0.0

    def of(self, nodes: Sequence[NodeId]) -> Known:
        """Those of a member's nodes that have a place."""
        reached = [n for n in nodes if n in self.places.poses]
        return Known({n: self.places.poses[n] for n in reached}, {n: self.places.log_units[n] for n in reached})

    def stiffer(self, c: Contribution) -> float:
        """How many times as exact as its own edges a member's poses must be for its edges to others; 1 at least."""
        own, most = c.graph.edges, 1.0
        for between in self.between:
            mine = np.array([c.robot in (i.robot, j.robot) for i, j in between.nodes], dtype=bool)
            for outer, inner in ((between.edges.kappa[mine], own.kappa), (between.edges.tau[mine], own.tau)):
                if len(outer) and len(inner):
                    most = max(most, float(outer.max() / max(inner.max(), 1e-12)))
        return float(np.sqrt(most))


def solve(
    contributions: Mapping[int, Contribution],
    arbitrary_scale: frozenset[int] = frozenset(),
    length_sigma: float = 0.0,
    heading_sigma: float = 0.0,
) -> Gathered:
    """F's optimum over what was contributed; the anchor's first node stays where it is.

    Edges to robots that contributed nothing are left out. ``length_sigma``, ``heading_sigma``: of the lengths of
    metric robots' odometry and the rates at which it turns, rad/m, which positions measured from outside tell better:
    where there are such, they are not asked.
    """
    members = sorted(contributions)
    nodes = [n for robot in members for n in contributions[robot].graph.nodes]
    row = {n: k for k, n in enumerate(nodes)}
    graphs = [contributions[robot].graph for robot in members]
    between = tuple(_inside(contributions[robot].between, row) for robot in members)
    first = np.cumsum([0, *(len(g.nodes) for g in graphs)])
    placed = [g.edges.moved_to(np.arange(a, b)) for g, a, b in zip(graphs, first[:-1], first[1:], strict=True)]
    placed += [b.edges.moved_to(np.array([row[n] for pair in b.nodes for n in pair], dtype=np.intp)) for b in between]
    edges = SimilarityEdges.together(placed)
    anchor = contributions[anchor_of(members, arbitrary_scale)]
    poses, log_units = np.tile(np.eye(4), (len(nodes), 1, 1)), np.zeros(len(nodes))
    anchored = row[anchor.graph.nodes[0]]
    poses[anchored] = anchor.first.poses[anchor.graph.nodes[0]]
    log_units[anchored] = anchor.first.log_units[anchor.graph.nodes[0]]
    label = parts(edges.ends, len(nodes))
    held = np.unique(label, return_index=True)[1]
    held[label[anchored]] = anchored
    fixed = np.array([n.robot not in arbitrary_scale for n in nodes], dtype=bool)
    freedom = freedom_of(edges.ends, fixed, held.tolist())
    kept = fixed.copy()
    kept[held] = True
    found = minimum(edges, poses, log_units, sorted(held.tolist()), kept)
    priors, lengthened, turned = priors_of(contributions, row), False, False
    if length_sigma > 0 and not len(priors):
        metric = [robot for robot in members if robot not in arbitrary_scale]
        number = np.array([metric.index(n.robot) if n.robot in metric else -1 for n in nodes], dtype=np.intp)
        steps = steps_of(edges.ends, number, len(metric), length_sigma, heading_sigma)
        best = with_corrections(edges, found, sorted(held.tolist()), kept, steps, freedom)
        found, edges, lengthened, turned = best.found, best.edges, best.lengths.used, best.headings.used
    cost = float(edges.costs(found.poses, found.log_units).sum())
    noise = noise_of(cost, freedom)
    # The rounding of all edges adds up, and is compared with what the loops alone cost.
    chains = 6.0 * len(edges.ends) / (_EDGES_A_LOOP * max(freedom, 1))
    exactness = float(np.sqrt(max(1.0, chains))) / noise
    solved, log_units, taken, joined = found.poses, found.log_units, found.steps, label == label[anchored]
    better = with_origin(edges, solved, log_units, anchored, fixed, priors, row) if len(priors) else None
    if better is not None:
        solved, log_units, taken, joined = better.poses, better.log_units, taken + better.steps, better.joined
    total = float(edges.costs(solved, log_units).sum())
    reached = [(n, k) for n, k in row.items() if joined[k]]
    places = Known({n: solved[k] for n, k in reached}, {n: float(log_units[k]) for n, k in reached})
    # Without loops nothing is left of F, and rounding costs nothing.
    cost = max(cost, freedom * noise**2) if freedom > 0 else float("inf")
    used = priors if better is not None else NO_PRIORS
    return Gathered(places, taken, between, exactness, cost, used, lengthened, turned, total)


def expected_gain(given: Sequence[Contribution], found: Gathered, free_unit: bool) -> tuple[float, float]:
    """By how much F falls from where members are to the solution, and how much of that rounding may feign or hide."""
    start = Known()
    for c in given:
        start = start.also(c.start)
    now, doubt = cost_between(found.between, start)
    more_doubt = cost_between(found.between, start.also(found.places))[1]
    now += sum(c.cost for c in given) + cost_of_priors(found.priors, start, free_unit)
    then = found.total + cost_of_priors(found.priors, start.also(found.places), free_unit)
    return now - then, doubt + more_doubt


def priors_of(contributions: Mapping[int, Contribution], row: Mapping[NodeId, int]) -> OriginPriors:
    """All that were contributed, by robot."""
    priors = NO_PRIORS
    for robot in sorted(contributions):
        mine = contributions[robot].priors
        priors = priors.and_also(mine.only(np.array([n in row for n in mine.nodes], dtype=bool)))
    return priors


def cost_of_priors(priors: OriginPriors, places: Known, free_unit: bool) -> float:
    """Their share of F where all their nodes have ``places``, with their frame where it suits them best."""
    if not len(priors) or any(n not in places.poses for n in priors.nodes):
        return 0.0
    nodes = sorted(set(priors.nodes))
    poses = np.array([places.poses[n] for n in nodes])
    log_units = np.array([places.log_units.get(n, 0.0) for n in nodes])
    return origin_of(priors, {n: k for k, n in enumerate(nodes)}, poses, log_units, free_unit)[1]


def _inside(between: Between, row: Mapping[NodeId, int]) -> Between:
    """The edges both of whose ends were contributed."""
    return between.only([i in row and j in row for i, j in between.nodes])


def cost_between(groups: Sequence[Between], places: Known) -> tuple[float, float]:
    """F over edges between members, and by how much the rounding of their measurements may have changed it, at most.

    Edges whose ends are not both in ``places`` are left out.
    """
    total = doubt = 0.0
    for between in groups:
        used = between.only([i in places.poses and j in places.poses for i, j in between.nodes])
        if not used.nodes:
            continue
        nodes = [n for pair in used.nodes for n in pair]
        poses = np.array([places.poses[n] for n in nodes])
        log_units = np.array([places.log_units.get(n, 0.0) for n in nodes])
        costs = used.edges.costs(poses, log_units)
        total += float(costs.sum())
        doubt += float((2.0 * np.sqrt(costs) * used.off + used.off**2).sum())
    return total, doubt
