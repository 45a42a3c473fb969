"""The minimum of F over arrays of poses, with or without units of length among the unknowns; no guess is needed."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array
from .chordal import two_stage_poses
from .similarity_edges import Descended, SimilarityEdges, descend, linear_start
from .trust_region import newton


def near_minimum(
    edges: SimilarityEdges,
    poses: Array,
    log_units: Array,
    held: Sequence[int],
    fixed: NDArray[np.bool_],
    steps: int = 1,
) -> Descended:
    """The linear problems' solution and ``steps`` Gauss-Newton steps from there.

    ``poses`` ``(n, 4, 4)`` and ``log_units`` ``(n,)`` matter for nodes that are ``held``, or tied to none of these;
    ``fixed`` ``(n,)``: nodes whose unit stays.
    """
    if fixed.all():
        weights = (edges.kappa, edges.tau)
        return Descended(two_stage_poses(edges.ends, edges.measured, weights, poses, steps, held), log_units, steps)
    return descend(edges, *linear_start(edges, poses, log_units, held, fixed), held, fixed, steps)


def minimum(
    edges: SimilarityEdges, poses: Array, log_units: Array, held: Sequence[int], fixed: NDArray[np.bool_]
) -> Descended:
    """The minimum that :func:`near_minimum` leads to."""
    if fixed.all():
        weights = (edges.kappa, edges.tau)
        start = two_stage_poses(edges.ends, edges.measured, weights, poses, 1, held)
        refined = newton(edges.ends, edges.measured, weights, start, held)
        return Descended(refined.poses, log_units, refined.steps)
    return near_minimum(edges, poses, log_units, held, fixed, steps=50)
