"""Pairwise consistency maximisation (Mangelson et al., ICRA 2018), between robots and within one.

Two edges between the same two odometry chains close a cycle with the odometry between their ends; if both are right,
the cycle's error is what the noise makes it. The largest set of edges that agree pair by pair is kept. Unlike residuals
of a solution, this needs no start and bears any share of wrong edges, as long as these do not agree with each other.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..config import RobustConfig
from ..geometry import Array, se3_inverse, se3_log
from ..pose_graph.graph import Edge, EdgeKind, NodeId, PoseGraph
from .chains import Chain, adjoint, chains, covariances
from .clique import Clique, largest_clique
from .noise import Noise

_ROUNDS = 50
# Bound of the search for consistent sets while the noise is being found.
_ROUGH_WORK = 100_000
# By how many others an edge is judged meanwhile.
_WITNESSES = 10
# Bytes of a message's header, and of what it says of an end of an edge.
_HEADER, _END = 10, 4 * (6 + 21)


@dataclass(frozen=True, eq=False)
class Consistency:
    """Result of PCM.

    ``accepted`` ``(m,)``: odometry, and the edges of the largest consistent sets; ``agreeing`` ``(m,)``: with how many
    others of its kind an edge agrees; ``tested`` ``(m,)``: how many others there were. An edge with none is accepted:
    nothing speaks for it or against. ``noise``: the law of right edges' squared distances.
    ``exact``: every set is known to be the largest.
    """

    accepted: NDArray[np.bool_]
    agreeing: NDArray[np.intp]
    tested: NDArray[np.intp]
    noise: Noise
    exact: bool


def consistent_edges(graph: PoseGraph, config: RobustConfig) -> Consistency:
    """Find the consistent loops and separators of ``graph``; odometry is believed."""
    groups = _groups(graph)
    # An edge must agree with all others of its set, so each pair has only a share of the edge's allowance to fail.
    shares = [(1.0 - config.confidence) / max(len(rows) - 1, 1) for rows in groups]
    noise = Noise.stated(graph.dimension)
    widest = _widest(noise, config)
    compared = [_compare(*g, widest.limit(p)) for g, p in zip(groups.values(), shares, strict=True)]
    distances = [d for d, _ in compared]
    for _ in range(_ROUNDS):
        samples = [np.zeros(0)]
        for (d, spread), p in zip(compared, shares, strict=True):
            limit = noise.limit(p)
            samples.append(_near(d, spread, largest_clique(d <= limit, _ROUGH_WORK), limit))
        before, noise = noise, noise.fitted(np.concatenate(samples), config)
        if noise == before:
            break
    limits = [noise.limit(p) for p in shares]
    cliques = [largest_clique(d <= c, config.clique_work) for d, c in zip(distances, limits, strict=True)]
    m = len(graph.edges)
    accepted = np.array([e.kind is EdgeKind.ODOMETRY for e in graph.edges], dtype=bool)
    agreeing, tested = np.zeros(m, dtype=np.intp), np.zeros(m, dtype=np.intp)
    for rows, distance, clique, limit in zip(groups, distances, cliques, limits, strict=True):
        at = np.array(rows, dtype=np.intp)
        agreeing[at] = (distance <= limit).sum(axis=1) - 1
        tested[at] = len(at) - 1
        # Two edges or more of which no two agree: neither is better than the other.
        if len(clique.members) > 1 or len(at) == 1:
            accepted[at[list(clique.members)]] = True
    return Consistency(accepted, agreeing, tested, noise, all(c.exact for c in cliques))


def bytes_of_cycles(graph: PoseGraph) -> int:
    """Bytes by which robots would learn which of their common edges agree: one of two tells the other its ends' poses
    and covariances, 27 numbers of 4 bytes each, and receives a bit for each edge; with a header of 10 a message.
    """
    ends: dict[tuple[int, int], set[NodeId]] = {}
    count: dict[tuple[int, int], int] = {}
    for e in graph.edges:
        if e.is_separator:
            lower, higher = sorted((e.i, e.j), key=lambda n: n.robot)
            pair = lower.robot, higher.robot
            ends.setdefault(pair, set()).add(higher)
            count[pair] = count.get(pair, 0) + 1
    return sum(2 * _HEADER + _END * len(ends[pair]) + -(-count[pair] // 8) for pair in ends)


def _widest(stated: Noise, config: RobustConfig) -> Noise:
    """The widest law that may come out: distances beyond its limits need not be known."""
    return stated if config.noise == "stated" else Noise(stated.full, stated.full * config.max_noise**2, 1.0)


def _near(distance: Array, spread: Array, clique: Clique, limit: float) -> Array:
    """Distances between edges that are right by all appearance: each is, in the median, near those members of the
    consistent set that have most to say about it; of each, the distances to such edges among these.

    Not of the set alone: it is chosen for its small distances. And not of all pairs: over long odometry everything
    agrees, also what is wrong.
    """
    members = np.array(clique.members, dtype=np.intp)
    if len(members) < 2:
        return np.zeros(0)
    others = spread[:, members].copy()
    others[members, np.arange(len(members))] = np.inf
    count = min(_WITNESSES, len(members) - 1)
    witnesses = members[np.argsort(others, axis=1, kind="stable")[:, :count]]
    all_rows = np.arange(len(distance))[:, None]
    near = np.median(distance[all_rows, witnesses], axis=1) <= limit
    pairs = distance[all_rows, witnesses][near[:, None] & near[witnesses]]
    return np.asarray(pairs[np.isfinite(pairs)])


def _groups(graph: PoseGraph) -> Mapping[tuple[int, ...], tuple[list[Edge], Chain, Chain]]:
    """Edges to test against each other, by their positions in ``graph.edges``: those between the same two chains, each
    edge from the first chain to the second (within one chain: forward).
    """
    found = chains(graph.poses, graph.edges)
    of_node = {n: k for k, chain in enumerate(found) for n in chain.row}
    rows: dict[tuple[int, int], list[int]] = {}
    edges: dict[tuple[int, int], list[Edge]] = {}
    for k, e in enumerate(graph.edges):
        if e.kind is EdgeKind.ODOMETRY:
            continue
        if (of_node[e.i], e.i) > (of_node[e.j], e.j):
            e = _turned(e)
        pair = of_node[e.i], of_node[e.j]
        rows.setdefault(pair, []).append(k)
        edges.setdefault(pair, []).append(e)
    return {tuple(rows[p]): (edges[p], found[p[0]], found[p[1]]) for p in sorted(rows)}


def _turned(e: Edge) -> Edge:
    """The same measurement from j to i."""
    A = adjoint(se3_inverse(e.T_i_j))
    information = A.T @ e.information @ A
    return Edge(e.j, e.i, se3_inverse(e.T_i_j), 0.5 * (information + information.T), e.kind)


def _compare(edges: list[Edge], first: Chain, second: Chain, highest: float) -> tuple[Array, Array]:
    """Squared Mahalanobis distances ``(n, n)`` from consistency of all pairs, infinite where they surely exceed
    ``highest``; and how much a pair's cycle may turn by noise, rad^2 ``(n, n)``.

    Everything is in the first chain's frame: ``Z_k`` is where edge k puts the second chain's frame, and the cycle of k
    and l closes where ``Z_k = Z_l``.
    """
    n = len(edges)
    i = np.array([first.row[e.i] for e in edges])
    j = np.array([second.row[e.j] for e in edges])
    through = first.poses[i] @ np.array([e.T_i_j for e in edges])
    Z = through @ se3_inverse(second.poses[j])
    A = adjoint(through)
    own = A @ covariances(edges) @ np.swapaxes(A, 1, 2)
    # Traces of the turns' part do not depend on the frame: a cheap bound from below that spares most wrong pairs.
    turn = [np.trace(c[:, 3:, 3:], axis1=1, axis2=2) for c in (own, first.covariance[i], second.covariance[j])]
    out, turns = np.zeros((n, n)), np.zeros((n, n))
    for k in range(n - 1):
        rest = np.arange(k + 1, n)
        error = se3_log(Z[k] @ se3_inverse(Z[rest]))
        spread = turn[0][k] + turn[0][rest] + np.abs(turn[1][k] - turn[1][rest]) + np.abs(turn[2][k] - turn[2][rest])
        near = (error[:, 3:] ** 2).sum(axis=1) <= highest * spread
        out[k, rest] = np.inf
        if near.any():
            close, B = rest[near], adjoint(Z[k])
            S = own[k] + own[close] + _between(first.covariance, i[k], i[close])
            S += B @ _between(second.covariance, j[k], j[close]) @ B.T
            solved = np.linalg.solve(S, error[near][:, :, None])[:, :, 0]
            out[k, close] = (error[near] * solved).sum(axis=1)
        out[rest, k] = out[k, rest]
        turns[k, rest] = turns[rest, k] = spread
    return out, turns


def _between(covariance: Array, a: int, b: NDArray[np.intp]) -> Array:
    """Covariance of the relative poses of a and each of b."""
    difference: Array = (covariance[b] - covariance[a]) * np.where(b >= a, 1.0, -1.0)[:, None, None]
    return difference
