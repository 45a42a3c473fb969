"""Edges that are new to the elected robot, as bytes: matches, own loops, odometry since the last message."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...central.similarity_edges import SimilarityEdges, edges_of
from ...errors import BackendError
from ...pose_graph.graph import Edge, NodeId
from ..compact import CompactReader, CompactWriter
from ..contribution import Between
from ..place_steps import measured_sizes, place_from_steps, place_to_steps
from .estimated_graph import Pair

# Of measurements nothing is predicted.
_NOTHING = (np.eye(4), 0.0)


def between_of(edges: Sequence[Edge], dimension: int) -> Between:
    """The edges as arrays, exact."""
    pairs = np.arange(2 * len(edges), dtype=np.intp).reshape(-1, 2)
    return Between(tuple((e.i, e.j) for e in edges), edges_of(edges, pairs, dimension), np.zeros(len(edges)))


def encode_pairs(*groups: Sequence[Pair]) -> bytes:
    """Of each group how many edges, and their nodes; they go before edges that are sent in full."""
    out = CompactWriter()
    for pairs in groups:
        out.count(len(pairs))
        for n in (n for pair in pairs for n in pair):
            out.count(n.robot)
            out.count(n.index)
    return out.bytes()


def decode_pairs(data: bytes) -> tuple[tuple[Pair, ...], tuple[Pair, ...], bytes]:
    """Inverse of :func:`encode_pairs` for two groups, and what comes after them."""
    source, groups = CompactReader(data), []
    for _ in range(2):
        count = source.count()
        if count > len(data):
            raise BackendError(f"{count} edges in a message of {len(data)} bytes")
        nodes = [NodeId(source.count(), source.count()) for _ in range(2 * count)]
        groups.append(tuple(zip(nodes[::2], nodes[1::2], strict=True)))
    return groups[0], groups[1], source.rest()


def encode_edges(given: Between, fineness: float, scaled: bool) -> bytes:
    """Ends, weights where they differ from the edge's before, measurements in steps of ``1 / fineness`` deviations."""
    out, fineness, width = CompactWriter(), float(np.float32(fineness)), 7 if scaled else 6
    out.rough(fineness)
    e = given.edges
    rounded = np.stack([e.kappa, e.tau, e.precision], axis=1).astype(np.float32).astype(np.float64)
    steps = place_to_steps(e.measured, e.log_scale, _NOTHING, measured_sizes(rounded, fineness))[:, :width]
    before: list[float] = []
    for (i, j), weights, moved in zip(given.nodes, rounded[:, : width - 4].tolist(), steps.tolist(), strict=True):
        same = weights == before
        out.count(2 * i.robot + same)
        out.count(i.index)
        out.count(j.robot)
        out.signed(j.index - i.index)
        if not same:
            out.weights(*weights)
        out.steps(moved)
        before = weights
    return out.bytes()


def decode_edges(data: bytes, scaled: bool) -> Between:
    """Inverse of :func:`encode_edges`, measurements and weights as they were rounded."""
    source, width = CompactReader(data), 7 if scaled else 6
    fineness = source.rough()
    if not 0 < fineness < np.inf:
        raise BackendError(f"edges in steps of {fineness} to a deviation")
    nodes: list[tuple[NodeId, NodeId]] = []
    weights: list[tuple[float, ...]] = []
    steps: list[list[int]] = []
    while not source.empty:
        robot, same = divmod(source.count(), 2)
        i = NodeId(robot, source.count())
        j = NodeId(source.count(), i.index + source.signed())
        if j.index < 0 or i == j or (same and not weights):
            raise BackendError(f"an edge between {i} and {j} that cannot be")
        nodes.append((i, j))
        weights.append(weights[-1] if same else source.weights(width - 4))
        steps.append(source.steps(width))
    numbers = np.array(weights, dtype=np.float64).reshape(-1, width - 4)
    if not scaled:
        numbers = np.concatenate([numbers, np.ones((len(numbers), 1))], axis=1)
    if not (np.isfinite(numbers).all() and (numbers > 0).all()):
        raise BackendError("an edge's weight is no positive number")
    moved = np.array(steps, dtype=np.float64).reshape(-1, width)
    measured, log_scale = place_from_steps(moved, _NOTHING, measured_sizes(numbers, fineness))
    if not np.isfinite(measured).all():
        raise BackendError("an edge's measurement is not finite")
    pairs = np.arange(2 * len(nodes), dtype=np.intp).reshape(-1, 2)
    edges = SimilarityEdges(pairs, measured, np.broadcast_to(log_scale, len(nodes)).copy(), *numbers.T)
    return Between(tuple(nodes), edges, np.full(len(nodes), 0.5 * float(width) ** 0.5 / fineness))
