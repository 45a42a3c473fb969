"""Minimum next to given poses, whether to trust it, and what displacements cost. Pure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...central.similarity_edges import SimilarityEdges, descend
from ...central.trust_region import newton
from ...geometry import Array, so3_log

# Turns (rad) of an edge's residual, or of a pose, from which a descent from where the poses are may miss the optimum.
_FAR = 0.2


def refined(
    edges: SimilarityEdges, poses: Array, log_units: Array, held: NDArray[np.intp], kept: NDArray[np.bool_]
) -> tuple[Array, Array]:
    """The minimum of F that lies next to these poses."""
    if kept.all():
        return newton(edges.ends, edges.measured, (edges.kappa, edges.tau), poses, held.tolist()).poses, log_units
    found = descend(edges, poses, log_units, held.tolist(), kept)
    return found.poses, found.log_units


def far(edges: SimilarityEdges, before: Array, after: Array) -> bool:
    """Whether there may be a better minimum than this one: an edge, or a pose on the way there, has turned by much."""
    i, j = edges.ends.T
    R = after[:, :3, :3]
    residual = so3_log(np.swapaxes(R[i] @ edges.measured[:, :3, :3], 1, 2) @ R[j])
    turned = so3_log(np.swapaxes(before[:, :3, :3], 1, 2) @ R)
    return bool(max(np.abs(residual).max(initial=0.0), np.abs(turned).max(initial=0.0)) > _FAR)


def stiffness(edges: SimilarityEdges, log_units: Array, count: int) -> Array:
    """What a squared displacement of each node costs in its edges, ``(count, 3)``: a shift, a turn, a log unit."""
    i, j = edges.ends.T
    reach = edges.tau * (edges.measured[:, :3, 3] ** 2).sum(axis=1)
    shift = edges.tau * np.exp(-2.0 * log_units[i])
    out = np.zeros((count, 3))
    for rows, lever in ((i, reach), (j, np.zeros(len(j)))):
        np.add.at(out, rows, np.stack([shift, 2.0 * edges.kappa + lever, edges.precision + lever], axis=1))
    return out
