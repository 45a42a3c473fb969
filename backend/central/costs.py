"""Cost of a pose graph in the three conventions of the literature; a figure without its convention means nothing.

- **F** (SE-Sync): sum of ``kappa |R_j - R_i R_ij|_F^2 + tau |t_j - t_i - R_i t_ij|^2``, isotropic weights from the
  information, no one-half.
- **U** (distributed-mapper): half of the same sum with unit weights (times the edge's own ``weight``, mostly 1).
- **E** (gtsam): half of the sum of ``|log(T_ij^-1 T_i^-1 T_j)|^2`` under the information. An indefinite matrix (some
  public files hold such) counts as the nearest semidefinite one: no residual may lower a cost.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from ..geometry import Array, se3_inverse, se3_log
from ..pose_graph.edge_arrays import EdgeArrays
from ..pose_graph.graph import PoseGraph
from .linear import edge_costs, isotropic_weights, positive_information

Convention = Literal["F", "U", "E"]


def edge_cost(graph: PoseGraph, convention: Convention) -> Array:
    """Each edge's share of the cost ``(m,)``, then each prior's, in the units of ``convention``."""
    a = graph.arrays()
    T_i, T_j = a.poses[a.ends[:, 0]], a.poses[a.ends[:, 1]]
    if convention == "E":
        xi = se3_log(se3_inverse(a.measured) @ se3_inverse(T_i) @ T_j)
        return 0.5 * np.einsum("ma,mab,mb->m", xi, positive_information(a.information), xi)
    return edge_costs(T_i, T_j, a.measured, *frobenius_weights(a, convention, graph.dimension))


def frobenius_weights(a: EdgeArrays, convention: Convention, dimension: int) -> tuple[Array, Array]:
    """``kappa``, ``tau`` ``(m,)`` with which the sum of F is the cost F or U; E has no such form and gets F's."""
    if convention == "U":
        return 0.5 * a.weight, 0.5 * a.weight
    return isotropic_weights(a.information, dimension)


def cost(graph: PoseGraph, convention: Convention) -> float:
    """The whole graph's cost."""
    return float(edge_cost(graph, convention).sum())
