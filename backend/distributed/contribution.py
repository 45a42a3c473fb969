"""Contributions of members to the elected robot: contents and bytes.

Where units of length are variables (``scaled``), an edge's weights, its steps and a node's place have one number more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..central.origin import NO_PRIORS, OriginPriors
from ..central.similarity_edges import SimilarityEdges, edges_of
from ..errors import BackendError
from ..geometry import Array
from ..pose_graph.graph import NodeId
from .compact import CompactReader, CompactWriter, numbers_of, poses_of
from .condense import Condensed, Known, OwnGraph
from .place_steps import measured_sizes, place_from_steps, place_to_steps
from .prior_bytes import read_priors, write_priors
from .share import Share


@dataclass(frozen=True, eq=False)
class Between:
    """Edges to other robots, as transmitted: ``nodes``, the two ends of each; ``edges``, whose ``ends`` are rows of
    these one after the other; ``off`` ``(m,)``: bounds of their displacement by rounding, standard deviations."""

    nodes: tuple[tuple[NodeId, NodeId], ...]
    edges: SimilarityEdges
    off: Array

    def only(self, used: Sequence[bool]) -> Between:
        """Those ``used``, one for each edge."""
        mask = np.array(used, dtype=bool)
        nodes = tuple(n for n, u in zip(self.nodes, used, strict=True) if u)
        return Between(nodes, replace(self.edges.only(mask), ends=_in_pairs(len(nodes))), self.off[mask])


@dataclass(frozen=True, eq=False)
class Contribution:
    """A member's condensed graph, the edges to others that it answers for, and where things are now.

    ``first``: its first node: the anchor's stays; ``start``: its separators, and the nodes of its ``priors``; ``cost``:
    F over its own edges now.
    ``fineness``: steps that a standard deviation has when this is sent; ``scaled``: units are variables.
    """

    robot: int
    graph: Condensed
    between: Between
    start: Known
    first: Known
    cost: float
    fineness: float
    scaled: bool = False
    priors: OriginPriors = NO_PRIORS

    @property
    def width(self) -> int:
        """Steps that a measurement takes."""
        return 7 if self.scaled else 6


# Longest measurement, and largest logarithm of a scale or unit, that a member may send.
_FARTHEST, _MOST_LOG_SCALE = 1e9, 14.0
# Largest cost of a member.
_MOST_COST = 1e30
# Of measurements nothing is predicted.
_NOTHING = (np.eye(4), 0.0)


def contribution(share: Share, own: OwnGraph, leader: int | None, longest: int, fineness: float) -> Contribution:
    """This robot's contribution for ``leader``: an edge between two members is sent by the lower one, and never to a
    leader that has it."""
    edges = [e for e in share.edges if e.is_separator and e.weight > 0]
    separators = sorted({n for e in edges for n in (e.i, e.j) if n.robot == share.robot})
    given = []
    for e in edges:
        other = e.j.robot if e.i.robot == share.robot else e.i.robot
        if share.robot == leader or (other != leader and share.robot < other):
            given.append(e)
    own_edges = edges_of(given, _in_pairs(len(given)), share.dimension)
    between = Between(tuple((e.i, e.j) for e in given), own_edges, np.zeros(len(given)))
    return Contribution(
        robot=share.robot,
        graph=own.condensed(longest),
        between=between,
        start=own.known(sorted({*separators, *own.priors.nodes})),
        first=own.known(own.nodes[:1]),
        cost=own.cost(own.poses, own.log_units),
        fineness=float(np.float32(fineness)),
        scaled=share.scaled,
        priors=own.priors,
    )


def encode(c: Contribution) -> bytes:
    """Node indices as differences, each set of weights once, measurements in steps of ``1 / fineness`` deviations."""
    out, fineness = CompactWriter(), c.fineness
    out.rough(fineness)
    out.count(len(c.graph.nodes))
    before = 0
    for n in c.graph.nodes:
        out.count(n.index - before)
        before = n.index
    for n, T in c.first.poses.items():
        out.pose(T)
        if c.scaled:
            out.number(c.first.log_units.get(n, 0.0))
    out.number(c.cost)
    both = c.graph.edges.and_also(c.between.edges)
    rounded = _weights(both)
    table = sorted({w[: c.width - 4] for w in rounded})
    out.count(len(table))
    for weights in table:
        out.weights(*weights)
    known = {weights: k for k, weights in enumerate(table)}
    pairs = [w[: c.width - 4] for w in rounded]
    edges = len(c.graph.edges.ends)
    steps = place_to_steps(both.measured, both.log_scale, _NOTHING, measured_sizes(rounded, fineness))[
        :, : c.width
    ].tolist()
    out.count(edges)
    last = 0
    for (i, j), weights, moved in zip(c.graph.edges.ends.tolist(), pairs[:edges], steps[:edges], strict=True):
        out.signed(i - last)
        out.signed(j - i)
        out.count(known[weights])
        out.steps(moved)
        last = i
    out.count(len(c.between.nodes))
    for ends, weights, moved in zip(c.between.nodes, pairs[edges:], steps[edges:], strict=True):
        for n in ends:
            out.count(n.robot)
            out.count(n.index)
        out.count(known[weights])
        out.steps(moved)
    write_priors(out, c.priors)
    starts = sorted(c.start.poses)
    for n, numbers in zip(starts, numbers_of(_stacked([c.start.poses[n] for n in starts])).tolist(), strict=True):
        out.count(n.index)
        out.rough_pose(numbers)
        if c.scaled:
            out.rough(c.start.log_units.get(n, 0.0))
    return out.bytes()


def decode(data: bytes, robot: int, scaled: bool = False) -> Contribution:
    """Inverse of :func:`encode`, measurements and weights as they were rounded; :class:`BackendError` for bytes that
    are no contribution."""
    try:
        c = _decode(data, robot, scaled)
    except (IndexError, ValueError, OverflowError) as error:  # a row that is not there, a number beyond all
        raise BackendError(f"not a contribution: {len(data)} bytes, {error}") from error
    _check(c)
    return c


def _check(c: Contribution) -> None:
    """:class:`BackendError` for what no member can mean: nodes out of order, edges of nowhere or of others, wild
    numbers."""
    indices = [n.index for n in c.graph.nodes]
    if not indices or any(b <= a for a, b in pairwise(indices)):
        raise BackendError(f"a contribution of {len(indices)} nodes, which do not ascend")
    ends, between = c.graph.edges.ends, c.between
    if len(ends) and (ends.min() < 0 or ends.max() >= len(indices) or (ends[:, 0] == ends[:, 1]).any()):
        raise BackendError("a contribution with an edge of nodes that are not in it")
    if any((i.robot == c.robot) == (j.robot == c.robot) for i, j in between.nodes):
        raise BackendError(f"a contribution of robot {c.robot} with an edge that is not its own to another")
    if c.fineness <= 0 or c.cost < 0:
        raise BackendError("a contribution of a fineness or cost that cannot be")
    for edges in (c.graph.edges, between.edges):
        weights = np.stack([edges.kappa, edges.tau, edges.precision])
        if (weights < 0).any() or np.abs(edges.log_scale).max(initial=0.0) > _MOST_LOG_SCALE:
            raise BackendError("a contribution with a weight or scale that cannot be")
        if not np.isfinite(edges.measured).all() or np.abs(edges.measured).max(initial=0.0) > _FARTHEST:
            raise BackendError("a contribution with a measurement that is not finite, or too long")
    places = np.array([T[:3, 3] for T in (*c.first.poses.values(), *c.start.poses.values())])
    if c.cost > _MOST_COST or np.abs(places).max(initial=0.0) > _FARTHEST:
        raise BackendError("a contribution of a cost or place that cannot be")
    logs = np.array([*c.first.log_units.values(), *c.start.log_units.values()])
    if np.abs(logs).max(initial=0.0) > _MOST_LOG_SCALE:
        raise BackendError("a contribution with a unit that cannot be")


def _decode(data: bytes, robot: int, scaled: bool) -> Contribution:
    source = CompactReader(data)
    width = 7 if scaled else 6
    fineness = source.rough()
    nodes, index = [], 0
    for _ in range(source.count()):
        index += source.count()
        nodes.append(NodeId(robot, index))
    first = Known()
    for n in nodes[:1]:
        first.poses[n] = source.pose()
        first.log_units[n] = source.number() if scaled else 0.0
    cost = source.number()
    table = [source.weights(width - 4) for _ in range(source.count())]
    ends, weights, steps, last = [], [], [], 0
    for _ in range(source.count()):
        last += source.signed()
        ends.append((last, last + source.signed()))
        weights.append(table[source.count()])
        steps.append(source.steps(width))
    others = []
    for _ in range(source.count()):
        others.append((NodeId(source.count(), source.count()), NodeId(source.count(), source.count())))
        weights.append(table[source.count()])
        steps.append(source.steps(width))
    numbers = np.array(weights, dtype=np.float64).reshape(-1, width - 4)
    if not scaled:
        numbers = np.concatenate([numbers, np.ones((len(numbers), 1))], axis=1)
    moved = np.array(steps, dtype=np.float64).reshape(-1, width)
    measured, log_scale = place_from_steps(moved, _NOTHING, measured_sizes(numbers, fineness))
    edges = len(ends)
    own = np.arange(len(weights)) < edges
    at = np.concatenate([np.array(ends, dtype=np.intp).reshape(-1, 2), _in_pairs(len(others))])
    both = SimilarityEdges(at, measured, log_scale, *numbers.T)
    # Each of six or seven numbers is off by half a step at most.
    off = np.full(len(others), 0.5 * float(width) ** 0.5 / fineness)
    between = Between(tuple(others), both.only(~own), off)
    priors = read_priors(source, robot)
    start, rough = Known(), []
    while not source.empty:
        n = NodeId(robot, source.count())
        rough.append(source.rough_pose())
        start.poses[n] = np.eye(4)
        start.log_units[n] = source.rough() if scaled else 0.0
    start.poses.update(zip(start.poses, poses_of(np.array(rough).reshape(-1, 6)), strict=True))
    return Contribution(robot, Condensed(nodes, both.only(own)), between, start, first, cost, fineness, scaled, priors)


def _in_pairs(count: int) -> NDArray[np.intp]:
    """Ends ``(count, 2)`` of edges whose nodes stand one after the other."""
    return np.arange(2 * count, dtype=np.intp).reshape(-1, 2)


def _stacked(poses: list[Array]) -> Array:
    return np.array(poses).reshape(-1, 4, 4)


def _weights(edges: SimilarityEdges) -> list[tuple[float, ...]]:
    """kappa, tau and precision of each edge as the receiver reads them: single precision."""
    rounded = np.stack([edges.kappa, edges.tau, edges.precision], axis=1).astype(np.float32).astype(np.float64)
    return [tuple(row) for row in rounded.tolist()]
