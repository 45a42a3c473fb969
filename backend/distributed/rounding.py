"""Rounding of what members contribute: what it costs the group, and finer numbers where that is too much.

A member rounds by the noise of its own edges. What the loops of the whole group leave of it, only the elected robot
sees: a long ring has one loop, over which the rounding of all its edges adds up. The elected robot then asks for what
was rounded off, a byte a number.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..central.similarity_edges import SimilarityEdges
from ..errors import BackendError
from ..geometry import Array
from .contribution import Between, Contribution
from .place_steps import measured_sizes, place_from_steps, place_to_steps

FINER = 128
"""How many times finer numbers become: half a step in three directions is 111 of the new ones, which a byte holds."""


def rounding_cost(c: Contribution) -> float:
    """By how much rounding raises F over the edges of ``c``, in the mean: its variance in each number is a twelfth of
    a step's square."""
    edges = _all(c)
    sizes2 = _sizes(edges, c.fineness)[:, : c.width] ** 2 / 12.0
    weights = np.repeat(np.stack([edges.tau, 2.0 * edges.kappa, edges.precision], axis=1), (3, 3, 1), axis=1)
    return float((sizes2 * weights[:, : c.width]).sum())


def encode_remainder(exact: Contribution, sent: Contribution) -> bytes:
    """What was rounded off the measurements that were ``sent``: a byte a number."""
    mine, rounded = _all(exact), _all(sent)
    sizes = _sizes(rounded, FINER * sent.fineness)
    steps = place_to_steps(mine.measured, mine.log_scale, (rounded.measured, rounded.log_scale), sizes)
    return np.clip(steps[:, : sent.width], -127, 127).astype("<i1").tobytes()


def finer(sent: Contribution, data: bytes) -> Contribution:
    """``sent`` with what was rounded off put back, :data:`FINER` times as fine. :class:`BackendError` where ``data``
    has not a byte for each number."""
    rounded = _all(sent)
    steps = np.frombuffer(data, dtype="<i1").astype(np.float64)
    if steps.size != len(rounded.ends) * sent.width:
        raise BackendError(f"robot {sent.robot} sent {steps.size} finer numbers for {len(rounded.ends)} measurements")
    sizes = _sizes(rounded, FINER * sent.fineness)
    predicted = (rounded.measured, rounded.log_scale)
    measured, log_scale = place_from_steps(steps.reshape(-1, sent.width), predicted, sizes)
    both = replace(rounded, measured=measured, log_scale=log_scale)
    own = np.arange(len(both.ends)) < len(sent.graph.edges.ends)
    graph = replace(sent.graph, edges=both.only(own))
    between = Between(sent.between.nodes, both.only(~own), sent.between.off / FINER)
    return replace(sent, graph=graph, between=between, fineness=FINER * sent.fineness)


def _all(c: Contribution) -> SimilarityEdges:
    return c.graph.edges.and_also(c.between.edges)


def _sizes(edges: SimilarityEdges, fineness: float) -> Array:
    return measured_sizes(np.stack([edges.kappa, edges.tau, edges.precision], axis=1), fineness)
