"""Which edges between pieces of trajectory agree with where all the others together put these: the vote on a graph."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..central.costs import frobenius_weights
from ..components import first_of_parts
from ..config import RobustConfig
from ..geometry import se3_inverse
from ..pose_graph.graph import EdgeKind, PoseGraph
from .chains import chains
from .meetings import Ends, Meeting, PieceEdges, drift_of
from .noise import Noise
from .placement import agreeing, placed_pieces


def voted_edges(
    graph: PoseGraph, consistent: NDArray[np.bool_], noise: Noise, config: RobustConfig
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Masks ``(m,)``: edges between two odometry chains, and of these the ones that agree with the placement of chains
    that most edges agree with (all True for others). Weights are not looked at.

    Of the edges of two chains that agree only those count that are ``consistent`` ``(m,)`` with each other too, if any
    is: the placement's test knows variances for each axis only.
    """
    pairs = piece_pairs(graph).pairs
    limit = noise.limit(1.0 - config.confidence)
    meetings = [m for between, _ in pairs for m in between.meetings(limit)]
    across, agree = np.zeros(len(graph.edges), dtype=bool), np.ones(len(graph.edges), dtype=bool)
    placements = [placed_pieces(meetings, anchor, limit) for anchor in _first_of_groups(meetings)]
    for between, rows in pairs:
        across[rows] = True
        for places in placements:
            agree[rows] &= agreeing(between.alone(), places, limit)
        if (agree & consistent)[rows].any():
            agree[rows] &= consistent[rows]
    return across, agree


@dataclass(frozen=True, eq=False)
class PiecePairs:
    """``middles`` ``(p,)``: rows of the middle nodes of pieces, in the graph's order of nodes; ``pairs``: the edges
    between each two pieces, and their positions in the graph's edges."""

    middles: tuple[int, ...]
    pairs: Sequence[tuple[PieceEdges, NDArray[np.intp]]]


def piece_pairs(graph: PoseGraph) -> PiecePairs:
    """The pieces that odometry joins, and what lies between them; weights are not looked at."""
    a, m = graph.with_weights(np.ones(len(graph.edges))).arrays(), len(graph.edges)
    row = {n: k for k, n in enumerate(a.nodes)}
    label, poses = np.zeros(len(a.nodes), dtype=np.intp), np.zeros((len(a.nodes), 4, 4))
    for number, chain in enumerate(chains(graph.poses, graph.edges)):
        rows = [row[n] for n in chain.row]
        label[rows], poses[rows] = number, chain.poses
    kappa, tau = (np.maximum(w[:m], 1e-12) for w in frobenius_weights(a, "F", graph.dimension))
    ends, variances = a.ends[:m], np.stack([0.5 / kappa, 1.0 / tau], axis=1)
    along = np.array([e.kind is EdgeKind.ODOMETRY for e in graph.edges], dtype=bool)
    within = label[ends[:, 0]] == label[ends[:, 1]]
    drift = drift_of(ends[along & within], variances[along & within], label)
    poses = se3_inverse(poses[drift.middle]) @ poses
    of = np.sort(label[ends], axis=1)
    out = []
    for first, second in np.unique(of[~along & ~within], axis=0).tolist():
        k = np.flatnonzero(~along & (of == (first, second)).all(axis=1))
        forward = label[ends[k, 0]] == first
        here, there = np.where(forward, ends[k].T, ends[k].T[::-1])
        measured = np.where(forward[:, None, None], a.measured[k], se3_inverse(a.measured[k]))
        mine, theirs = Ends(poses[here], drift.collected[here]), Ends(poses[there], drift.collected[there])
        out.append((PieceEdges(first, second, mine, theirs, measured, variances[k]), k))
    return PiecePairs(tuple(drift.middle[np.unique(label, return_index=True)[1]].tolist()), out)


def _first_of_groups(meetings: list[Meeting]) -> list[int]:
    """The first piece of each set that meetings join."""
    pieces = sorted({p for m in meetings for p in (m.first, m.second)})
    row = {p: k for k, p in enumerate(pieces)}
    ends = np.array([(row[m.first], row[m.second]) for m in meetings], dtype=np.intp).reshape(-1, 2)
    return [pieces[k] for k in first_of_parts(ends, len(pieces))] if pieces else []
