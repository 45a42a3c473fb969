"""The solution that the elected robot sends to a member: bytes.

Where units of length are variables (``scaled``), a node's place has one number more.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ..errors import BackendError
from ..geometry import Array, se3_inverse
from .compact import CompactReader, CompactWriter, numbers_of, poses_of
from .condense import Condensed, Known
from .place_steps import Place, place_from_steps, place_to_steps, sizes_of


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
        steps = place_to_steps(T, log_unit, predicted, sizes)[: 7 if scaled else 6]
        out.steps(steps.tolist())
        known[k] = place_from_steps(steps, predicted, sizes)
    return out.bytes(), _named(graph, known)


def decode_solution(data: bytes, graph: Condensed, scaled: bool = False) -> Known:
    """Inverse of :func:`encode_solution`: places of the nodes that were reached."""
    source = CompactReader(data)
    fineness = source.rough()
    reached = np.ones(len(graph.nodes), dtype=bool)
    some = source.count()
    if some:
        rows = [source.count() for _ in range(min(some - 1, len(reached) + 1))]
        if len(rows) > len(reached) or max(rows, default=0) >= len(reached):
            raise BackendError(f"a solution for a pose beyond the {len(reached)} of its graph")
        reached[:] = False
        reached[rows] = True
    known: dict[int, Place] = {}
    for k, predicted, sizes in _walk(graph, reached, known, fineness):
        if predicted is None:
            known[k] = source.pose(), source.number() if scaled else 0.0
        else:
            steps = np.array(source.steps(7 if scaled else 6), dtype=np.float64)
            known[k] = place_from_steps(steps, predicted, sizes)
    return _named(graph, known)


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
    sizes = sizes_of(np.stack([_stiffness(graph, w) for w in (edges.kappa, edges.tau, edges.precision)], 1), fineness)
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
