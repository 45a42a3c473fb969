"""Contributions of members to the elected robot, and the solution sent back: contents and bytes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array, se3_inverse
from ..pose_graph.graph import NodeId
from .compact import CompactReader, CompactWriter, from_steps, numbers_of, poses_of, step_sizes, to_steps
from .condense import Condensed, OwnGraph, weights_of
from .share import Share


@dataclass(frozen=True, eq=False)
class Between:
    """An edge to another robot, as transmitted; ``off``: bound of its displacement by rounding, standard deviations."""

    i: NodeId
    j: NodeId
    T_i_j: Array
    kappa: float
    tau: float
    off: float = 0.0


@dataclass(frozen=True, eq=False)
class Contribution:
    """A member's condensed graph, the edges to others that it answers for, and where things are now.

    ``first_pose`` ``T_O_i`` of its first node: the anchor, if it is the lowest; ``start``: poses of its separators;
    ``cost``: F over its own edges now. ``fineness``: steps that a standard deviation has when this is sent.
    """

    robot: int
    graph: Condensed
    between: tuple[Between, ...]
    start: dict[NodeId, Array]
    first_pose: Array
    cost: float
    fineness: float


def contribution(share: Share, own: OwnGraph, leader: int | None, longest: int, fineness: float) -> Contribution:
    """This robot's contribution for ``leader``: an edge between two members is sent by the lower one, and never to a
    leader that has it."""
    edges = [e for e in share.edges if e.is_separator and e.weight > 0]
    separators = sorted({n for e in edges for n in (e.i, e.j) if n.robot == share.robot})
    given = []
    for e, kappa, tau in zip(edges, *weights_of(edges, share.dimension), strict=True):
        other = e.j.robot if e.i.robot == share.robot else e.i.robot
        if share.robot == leader or (other != leader and share.robot < other):
            given.append(Between(e.i, e.j, e.T_i_j, float(kappa), float(tau)))
    return Contribution(
        robot=share.robot,
        graph=own.condensed(longest),
        between=tuple(given),
        start={n: share.poses[n] for n in separators},
        first_pose=own.poses[0],
        cost=own.cost(own.poses),
        fineness=float(np.float32(fineness)),
    )


def encode(c: Contribution) -> bytes:
    """Node indices as differences, each pair of weights once, poses in steps of ``1 / fineness`` deviations."""
    out, fineness = CompactWriter(), c.fineness
    out.rough(fineness)
    out.count(len(c.graph.nodes))
    before = 0
    for n in c.graph.nodes:
        out.count(n.index - before)
        before = n.index
    out.pose(c.first_pose)
    out.number(c.cost)
    pairs = [*zip(c.graph.kappa, c.graph.tau, strict=True), *((b.kappa, b.tau) for b in c.between)]
    rounded = [(float(np.float32(kappa)), float(np.float32(tau))) for kappa, tau in pairs]
    table = sorted(set(rounded))
    out.count(len(table))
    for kappa, tau in table:
        out.weights(kappa, tau)
    known = {pair: k for k, pair in enumerate(table)}
    edges = len(c.graph.ends)
    measured = np.concatenate([c.graph.measured, _stacked([b.T_i_j for b in c.between])])
    steps = to_steps(measured, np.eye(4), _sizes(rounded, fineness)).tolist()
    out.count(edges)
    last = 0
    for (i, j), pair, moved in zip(c.graph.ends.tolist(), rounded[:edges], steps[:edges], strict=True):
        out.signed(i - last)
        out.signed(j - i)
        out.count(known[pair])
        out.steps(moved)
        last = i
    out.count(len(c.between))
    for b, pair, moved in zip(c.between, rounded[edges:], steps[edges:], strict=True):
        for n in (b.i, b.j):
            out.count(n.robot)
            out.count(n.index)
        out.count(known[pair])
        out.steps(moved)
    starts = sorted(c.start)
    for n, numbers in zip(starts, numbers_of(_stacked([c.start[n] for n in starts])).tolist(), strict=True):
        out.count(n.index)
        out.rough_pose(numbers)
    return out.bytes()


def decode(data: bytes, robot: int) -> Contribution:
    """Inverse of :func:`encode`, measurements and weights as they were rounded."""
    source = CompactReader(data)
    fineness = source.rough()
    # Each of six numbers is off by half a step at most.
    off = 0.5 * 6.0**0.5 / fineness
    nodes, index = [], 0
    for _ in range(source.count()):
        index += source.count()
        nodes.append(NodeId(robot, index))
    first_pose, cost = source.pose(), source.number()
    table = [source.weights() for _ in range(source.count())]
    ends, pairs, steps, last = [], [], [], 0
    for _ in range(source.count()):
        last += source.signed()
        ends.append((last, last + source.signed()))
        pairs.append(table[source.count()])
        steps.append(source.steps())
    others = []
    for _ in range(source.count()):
        others.append([NodeId(source.count(), source.count()) for _ in range(2)])
        pairs.append(table[source.count()])
        steps.append(source.steps())
    moved = np.array(steps, dtype=np.float64).reshape(-1, 6)
    measured = from_steps(moved, np.eye(4), _sizes(pairs, fineness))
    edges = len(ends)
    between = [
        Between(i, j, T, *pair, off) for (i, j), T, pair in zip(others, measured[edges:], pairs[edges:], strict=True)
    ]
    separators, numbers = [], []
    while not source.empty:
        separators.append(NodeId(robot, source.count()))
        numbers.append(source.rough_pose())
    start = dict(zip(separators, poses_of(np.array(numbers).reshape(-1, 6)), strict=True))
    graph = Condensed(nodes, np.array(ends, dtype=np.intp).reshape(-1, 2), measured[:edges], *_columns(pairs[:edges]))
    return Contribution(robot, graph, tuple(between), start, first_pose, cost, fineness)


def _stacked(poses: list[Array]) -> Array:
    return np.array(poses).reshape(-1, 4, 4)


def _columns(pairs: list[tuple[float, float]]) -> Array:
    """``(2, n)``: all ``kappa``, all ``tau``."""
    return np.array(pairs, dtype=np.float64).reshape(-1, 2).T


def _sizes(pairs: list[tuple[float, float]], fineness: float) -> Array:
    kappa, tau = _columns(pairs)
    return step_sizes(kappa, tau, fineness)


def encode_solution(
    graph: Condensed, poses: Array, reached: NDArray[np.bool_], fineness: float
) -> tuple[bytes, dict[NodeId, Array]]:
    """The ``poses`` ``(n, 4, 4)`` of a member's nodes, those ``reached`` ``(n,)``: steps from the prediction of its own
    edges; and the poses that it will read from them.

    ``graph`` as it arrived, so that the member predicts the same.
    """
    out, fineness = CompactWriter(), float(np.float32(fineness))
    out.rough(fineness)
    out.count(0 if reached.all() else 1 + int(reached.sum()))
    if not reached.all():
        for k in np.flatnonzero(reached).tolist():
            out.count(k)
    known: dict[int, Array] = {}
    for k, before, predicted, sizes in _walk(graph, reached, known, fineness):
        if before < 0:
            out.pose(poses[k])
            known[k] = poses_of(numbers_of(poses[k]))
            continue
        steps = to_steps(poses[k], predicted, sizes)
        out.steps(steps.tolist())
        known[k] = from_steps(steps, predicted, sizes)
    return out.bytes(), _named(graph, known)


def decode_solution(data: bytes, graph: Condensed) -> dict[NodeId, Array]:
    """Inverse of :func:`encode_solution`: poses of the nodes that were reached."""
    source = CompactReader(data)
    fineness = source.rough()
    reached = np.ones(len(graph.nodes), dtype=bool)
    some = source.count()
    if some:
        reached[:] = False
        reached[[source.count() for _ in range(some - 1)]] = True
    known: dict[int, Array] = {}
    for k, before, predicted, sizes in _walk(graph, reached, known, fineness):
        known[k] = source.pose() if before < 0 else from_steps(source.steps(), predicted, sizes)
    return _named(graph, known)


def _named(graph: Condensed, known: dict[int, Array]) -> dict[NodeId, Array]:
    return {graph.nodes[k]: T for k, T in sorted(known.items())}


def _walk(
    graph: Condensed, reached: NDArray[np.bool_], known: dict[int, Array], fineness: float
) -> Iterator[tuple[int, int, Array, Array]]:
    """Nodes breadth first along the edges: the node, the one before (-1: none), its pose by their edge and the steps'
    sizes. The caller puts each node's pose into ``known`` before it asks for the next.

    A member without edges of its own has no weights either: nothing predicts its poses, and there are no steps.
    """
    if not len(graph.ends):
        yield from ((root, -1, np.eye(4), np.ones(6)) for root in np.flatnonzero(reached).tolist())
        return
    links: list[list[tuple[int, int]]] = [[] for _ in graph.nodes]
    for k, (i, j) in enumerate(graph.ends.tolist()):
        links[i].append((j, k))
        links[j].append((i, k))
    sizes = step_sizes(_stiffness(graph, graph.kappa), _stiffness(graph, graph.tau), fineness)
    backwards = se3_inverse(graph.measured)
    starts = graph.ends[:, 0].tolist()
    seen = (~reached).tolist()
    for root in range(len(graph.nodes)):
        if seen[root]:
            continue
        seen[root] = True
        yield root, -1, np.eye(4), np.ones(6)
        queue = deque([root])
        while queue:
            i = queue.popleft()
            for j, k in links[i]:
                if not seen[j]:
                    seen[j] = True
                    T = graph.measured[k] if starts[k] == i else backwards[k]
                    yield j, i, known[i] @ T, sizes[j]
                    queue.append(j)


def _stiffness(graph: Condensed, weights: Array) -> Array:
    """Weight ``(n,)`` of the stiffest edge at each node, and not much less than that of the stiffest of all: a pose
    must be as exact as any of its edges, among them those to others, is sensitive.
    """
    out = np.full(len(graph.nodes), 0.01 * weights.max(initial=0.0))
    for side in range(2):
        np.maximum.at(out, graph.ends[:, side], weights)
    return out
