"""Prediction of an edge by a solution without it: the test by which edges are rejected and rejected ones come back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..central.costs import frobenius_weights
from ..central.linear import BlockSystem, pose_blocks
from ..central.trust_region import anchors, named_parts
from ..config import CentralConfig
from ..errors import BackendError
from ..geometry import Array, se3_inverse, se3_log
from ..pose_graph.edge_arrays import EdgeArrays
from ..pose_graph.graph import PoseGraph
from .chains import adjoint

# Edges looked at together, which bounds the memory.
_BATCH = 200
# Share of its variance that the residual of an edge keeps which nothing else tests: then 0 over next to nothing.
_WITHOUT_TEST = 1e-6


def predicted_distances(graph: PoseGraph, rows: NDArray[np.intp], central: CentralConfig) -> Array:
    """Squared Mahalanobis distances ``(k,)`` of the edges ``rows`` from what all others predict, under their own noise
    and that of the prediction: chi-square for right edges.

    ``graph``: a solution, with the weights it was made with. A residual alone misleads both ways: against an edge of
    weight 0 it may hold the drift of the solution where nothing else holds it; for an edge that took part it may be
    small because odometry was bent to it. For the latter the same comes out without solving again, from the residual
    and its own variance, which is the edge's less the solution's (Baarda, 1968). Infinite for edges of weight 0
    between parts that nothing joins, as there is nothing to test them by; 0, or near it, for the only edge that joins.
    """
    out = np.full(len(rows), np.inf)
    a = graph.arrays()
    part = named_parts(a)
    i, j = a.ends.T
    whole = graph.with_weights(np.ones(len(graph.edges))).arrays()
    own_kappa, own_tau = _weights(whole, central, graph.dimension)
    kappa, tau = _weights(a, central, graph.dimension)
    free = np.setdiff1d(np.arange(len(a.poses)), anchors(a))
    R = a.poses[:, :3, :3]
    used = a.weight > 0
    try:
        system = BlockSystem(a.ends, *pose_blocks(R[i], R[j], a.measured, kappa, tau), free, used)
    except BackendError:
        return out
    inside = np.flatnonzero(part[i[rows]] == part[j[rows]])
    for some in np.split(inside, range(_BATCH, len(inside), _BATCH)):
        k = rows[some]
        between = se3_inverse(a.poses[i[k]]) @ a.poses[j[k]]
        error = se3_log(se3_inverse(a.measured[k]) @ between)
        J_i = -adjoint(se3_inverse(between)) @ _into_body(R[i[k]])
        S = _spread(system, len(a.poses), i[k], j[k], J_i, _into_body(R[j[k]]))
        own = np.repeat(np.stack([1.0 / own_tau[k], 0.5 / own_kappa[k]], axis=1), 3, axis=1)
        S[a.weight[k] > 0] *= -1.0 + _WITHOUT_TEST
        S[:, range(6), range(6)] += own
        out[some] = (error * np.linalg.solve(S, error[:, :, None])[:, :, 0]).sum(axis=1)
    return out


def _weights(a: EdgeArrays, central: CentralConfig, dimension: int) -> tuple[Array, Array]:
    """Such that the sum of F is one of squared standard deviations."""
    kappa, tau = frobenius_weights(a, central.cost, dimension)
    factor = 2.0 if central.cost == "U" else 1.0
    return np.maximum(factor * kappa, 1e-12), np.maximum(factor * tau, 1e-12)


def _into_body(R: Array) -> Array:
    """From a node's shift in the common frame and turn in its own to a tangent in its own ``(k, 6, 6)``."""
    out = np.zeros((len(R), 6, 6))
    out[:, :3, :3], out[:, 3:, 3:] = np.swapaxes(R, 1, 2), np.eye(3)
    return out


def _spread(system: BlockSystem, n: int, i: NDArray[np.intp], j: NDArray[np.intp], J_i: Array, J_j: Array) -> Array:
    """Covariance ``(k, 6, 6)`` of relative poses: ``J P J^T`` with P the inverse of the solution's equations."""
    k, free = len(i), system.solved
    rhs = np.zeros((n, 6, k, 6))
    edge = np.arange(k)
    rhs[i, :, edge] += np.swapaxes(J_i, 1, 2)
    rhs[j, :, edge] += np.swapaxes(J_j, 1, 2)
    solved = np.zeros_like(rhs)
    solved[free] = system.solve_for(rhs[free].reshape(len(free), 6, -1)).reshape(len(free), 6, k, 6)
    out: Array = J_i @ solved[i, :, edge] + J_j @ solved[j, :, edge]
    return 0.5 * (out + np.swapaxes(out, 1, 2))
