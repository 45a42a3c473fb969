"""What a pose graph costs, in the three conventions of the literature; a figure without its convention means nothing.

- **F** (SE-Sync): sum of ``kappa |R_j - R_i R_ij|_F^2 + tau |t_j - t_i - R_i t_ij|^2``, isotropic weights from the
  information, no one-half.
- **U** (distributed-mapper): half of the same sum with unit weights.
- **E** (gtsam): half of the sum of ``|log(T_ij^-1 T_i^-1 T_j)|^2`` under the information.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from backend.geometry import Array, se3_inverse, se3_log
from backend.graph import PoseGraph
from backend.linear import edge_costs, isotropic_weights

Convention = Literal["F", "U", "E"]


def edge_cost(graph: PoseGraph, convention: Convention) -> Array:
    """Each edge's share of the cost ``(m,)``."""
    a = graph.arrays()
    T_i, T_j = a.poses[a.ends[:, 0]], a.poses[a.ends[:, 1]]
    if convention == "E":
        xi = se3_log(se3_inverse(a.measured) @ se3_inverse(T_i) @ T_j)
        return 0.5 * np.einsum("ma,mab,mb->m", xi, a.information, xi)
    if convention == "U":
        return 0.5 * edge_costs(T_i, T_j, a.measured, np.ones(len(a.ends)), np.ones(len(a.ends)))
    kappa, tau = isotropic_weights(a.information, graph.dimension)
    return edge_costs(T_i, T_j, a.measured, kappa, tau)


def cost(graph: PoseGraph, convention: Convention) -> float:
    """The whole graph's cost."""
    return float(edge_cost(graph, convention).sum())
