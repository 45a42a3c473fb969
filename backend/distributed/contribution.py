"""Contributions of members to the elected robot, and the solution sent back: contents and bytes.

Where units of length are variables (``scaled``), an edge's weights, its steps and a node's place have one number more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..central.similarity_edges import SimilarityEdges, edges_of
from ..geometry import Array, se3_inverse
from ..pose_graph.graph import NodeId
from .compact import CompactReader, CompactWriter, from_steps, numbers_of, poses_of, step_sizes, to_steps
from .condense import Condensed, Known, OwnGraph
from .share import Share

Place = tuple[Array, float]
"""Pose ``(4, 4)`` and logarithm of the unit of a node."""


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

    ``first``: its first node: the anchor's stays; ``start``: its separators; ``cost``: F over its own edges now.
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

    @property
    def width(self) -> int:
        """Steps that a measurement takes."""
        return 7 if self.scaled else 6


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
        start=own.known(separators),
        first=own.known(own.nodes[:1]),
        cost=own.cost(own.poses, own.log_units),
        fineness=float(np.float32(fineness)),
        scaled=share.scaled,
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
    steps = _to_steps(both.measured, both.log_scale, _NOTHING, _sizes(rounded, fineness))[:, : c.width].tolist()
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
    starts = sorted(c.start.poses)
    for n, numbers in zip(starts, numbers_of(_stacked([c.start.poses[n] for n in starts])).tolist(), strict=True):
        out.count(n.index)
        out.rough_pose(numbers)
        if c.scaled:
            out.rough(c.start.log_units.get(n, 0.0))
    return out.bytes()


def decode(data: bytes, robot: int, scaled: bool = False) -> Contribution:
    """Inverse of :func:`encode`, measurements and weights as they were rounded."""
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
    measured, log_scale = _from_steps(moved, _NOTHING, _sizes(numbers, fineness))
    edges = len(ends)
    own = np.arange(len(weights)) < edges
    at = np.concatenate([np.array(ends, dtype=np.intp).reshape(-1, 2), _in_pairs(len(others))])
    both = SimilarityEdges(at, measured, log_scale, *numbers.T)
    # Each of six or seven numbers is off by half a step at most.
    off = np.full(len(others), 0.5 * float(width) ** 0.5 / fineness)
    between = Between(tuple(others), both.only(~own), off)
    start, rough = Known(), []
    while not source.empty:
        n = NodeId(robot, source.count())
        rough.append(source.rough_pose())
        start.poses[n] = np.eye(4)
        start.log_units[n] = source.rough() if scaled else 0.0
    start.poses.update(zip(start.poses, poses_of(np.array(rough).reshape(-1, 6)), strict=True))
    return Contribution(robot, Condensed(nodes, both.only(own)), between, start, first, cost, fineness, scaled)


def encode_solution(graph: Condensed, places: Known, fineness: float, scaled: bool = False) -> tuple[bytes, Known]:
    """The places of a member's nodes that are known: steps from the prediction of its own edges; and the places that it
    will read from them.

    ``graph`` as it arrived, so that the member predicts the same.
    """
    out, fineness = CompactWriter(), float(np.float32(fineness))
    out.rough(fineness)
    reached = np.array([n in places.poses for n in graph.nodes], dtype=bool)
    out.count(0 if reached.all() else 1 + int(reached.sum()))
    if not reached.all():
        for k in np.flatnonzero(reached).tolist():
            out.count(k)
    known: dict[int, Place] = {}
    for k, predicted, sizes in _walk(graph, reached, known, fineness):
        T, log_unit = places.poses[graph.nodes[k]], places.log_units.get(graph.nodes[k], 0.0)
        if predicted is None:
            out.pose(T)
            if scaled:
                out.number(log_unit)
            known[k] = poses_of(numbers_of(T)), log_unit
            continue
        steps = _to_steps(T, log_unit, predicted, sizes)[: 7 if scaled else 6]
        out.steps(steps.tolist())
        known[k] = _from_steps(steps, predicted, sizes)
    return out.bytes(), _named(graph, known)


def decode_solution(data: bytes, graph: Condensed, scaled: bool = False) -> Known:
    """Inverse of :func:`encode_solution`: places of the nodes that were reached."""
    source = CompactReader(data)
    fineness = source.rough()
    reached = np.ones(len(graph.nodes), dtype=bool)
    some = source.count()
    if some:
        reached[:] = False
        reached[[source.count() for _ in range(some - 1)]] = True
    known: dict[int, Place] = {}
    for k, predicted, sizes in _walk(graph, reached, known, fineness):
        if predicted is None:
            known[k] = source.pose(), source.number() if scaled else 0.0
        else:
            steps = np.array(source.steps(7 if scaled else 6), dtype=np.float64)
            known[k] = _from_steps(steps, predicted, sizes)
    return _named(graph, known)


def _in_pairs(count: int) -> NDArray[np.intp]:
    """Ends ``(count, 2)`` of edges whose nodes stand one after the other."""
    return np.arange(2 * count, dtype=np.intp).reshape(-1, 2)


def _stacked(poses: list[Array]) -> Array:
    return np.array(poses).reshape(-1, 4, 4)


def _weights(edges: SimilarityEdges) -> list[tuple[float, ...]]:
    """kappa, tau and precision of each edge as the receiver reads them: single precision."""
    rounded = np.stack([edges.kappa, edges.tau, edges.precision], axis=1).astype(np.float32).astype(np.float64)
    return [tuple(row) for row in rounded.tolist()]


def _sizes(weights: ArrayLike, fineness: float) -> Array:
    """Steps ``(n, 7)`` of edges with these weights ``(n, 3)``."""
    kappa, tau, precision = np.asarray(weights, dtype=np.float64).reshape(-1, 3).T
    return np.concatenate([step_sizes(kappa, tau, fineness), _unit_steps(precision, fineness)], axis=1)


def _unit_steps(precision: Array, fineness: float) -> Array:
    """Steps ``(n, 1)`` of log units."""
    return np.asarray(1.0 / (np.sqrt(precision) * fineness))[:, None]


def _to_steps(T: Array, log_unit: ArrayLike, predicted: Place, sizes: Array) -> Array:
    """Whole steps ``(..., 7)`` from what is predicted."""
    unit = np.rint((np.asarray(log_unit, dtype=np.float64) - predicted[1]) / sizes[..., 6])
    return np.concatenate([to_steps(T, predicted[0], sizes[..., :6]), unit[..., None]], axis=-1)


def _from_steps(steps: Array, predicted: Place, sizes: Array) -> tuple[Array, Any]:
    """Inverse of :func:`_to_steps`, up to half a step; of six numbers the unit is the predicted one."""
    T = from_steps(steps[..., :6], predicted[0], sizes[..., :6])
    moved = steps[..., 6] * sizes[..., 6] if steps.shape[-1] > 6 else np.zeros(steps.shape[:-1])
    return T, predicted[1] + moved


def _named(graph: Condensed, known: dict[int, Place]) -> Known:
    found = sorted(known.items())
    return Known({graph.nodes[k]: T for k, (T, _) in found}, {graph.nodes[k]: float(unit) for k, (_, unit) in found})


def _walk(
    graph: Condensed, reached: NDArray[np.bool_], known: dict[int, Place], fineness: float
) -> Iterator[tuple[int, Place | None, Array]]:
    """Nodes breadth first along the edges: the node, its place by the edge from the one before (None: there is none)
    and the steps' sizes. The caller puts each node's place into ``known`` before it asks for the next.

    A member without edges of its own has no weights either: nothing predicts its poses, and there are no steps.
    """
    edges, nothing = graph.edges, np.ones(7)
    if not len(edges.ends):
        yield from ((root, None, nothing) for root in np.flatnonzero(reached).tolist())
        return
    links: list[list[tuple[int, int]]] = [[] for _ in graph.nodes]
    for k, (i, j) in enumerate(edges.ends.tolist()):
        links[i].append((j, k))
        links[j].append((i, k))
    sizes = _sizes(np.stack([_stiffness(graph, w) for w in (edges.kappa, edges.tau, edges.precision)], 1), fineness)
    backwards = se3_inverse(edges.measured)
    starts, log_scale = edges.ends[:, 0].tolist(), edges.log_scale.tolist()
    seen = (~reached).tolist()
    for root in range(len(graph.nodes)):
        if seen[root]:
            continue
        seen[root] = True
        yield root, None, nothing
        queue = deque([root])
        while queue:
            i = queue.popleft()
            T_i, log_unit = known[i]
            for j, k in links[i]:
                if not seen[j]:
                    seen[j] = True
                    forward = starts[k] == i
                    T = (edges.measured[k] if forward else backwards[k]).copy()
                    there = log_unit + (log_scale[k] if forward else -log_scale[k])
                    # A translation is in the unit of the edge's first node.
                    T[:3, 3] *= np.exp(log_unit if forward else there)
                    # Sizes of shifts are in the node's own unit.
                    in_own = np.array([np.exp(there)] * 3 + [1.0] * 4)
                    yield j, (T_i @ T, there), sizes[j] * in_own
                    queue.append(j)


def _stiffness(graph: Condensed, weights: Array) -> Array:
    """Weight ``(n,)`` of the stiffest edge at each node, and not much less than that of the stiffest of all: a pose
    must be as exact as any of its edges, among them those to others, is sensitive.
    """
    out = np.full(len(graph.nodes), 0.01 * weights.max(initial=0.0))
    for side in range(2):
        np.maximum.at(out, graph.edges.ends[:, side], weights)
    return out
