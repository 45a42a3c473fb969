"""A certificate of global optimality for F and U, or by how much a solution may be off.

The dual of F's semidefinite relaxation (SE-Sync: Rosen et al., IJRR 2019). For *any* symmetric multipliers
``Lambda_i``, weak duality bounds the optimum from below, ``F* >= sum tr(Lambda_i) + n d min(eigenvalue(S), 0)``, with
``S`` the rotations' part of ``M - blockdiag(0, Lambda_i)``, the translations eliminated. At a stationary point the
multipliers are known in closed form and the trace is the cost itself; so the solution is the global optimum where no
eigenvalue of S is negative. There is no such certificate for cost E.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import LinearOperator, SuperLU, eigsh, splu

from ..errors import BackendError
from ..geometry import Array
from ..pose_graph.edge_arrays import EdgeArrays
from ..pose_graph.graph import PoseGraph
from .costs import frobenius_weights
from .laplacian import best_translations, connection_laplacian, multipliers, rotation_diagonal, stacked
from .linear import edge_costs
from .trust_region import anchors, newton

# Costs below this share of what the graph would cost at its worst are rounding.
_ROUNDING = 1e-14
# Largest of doublings in the search for a number below all eigenvalues.
_DOUBLINGS = 60


@dataclass(frozen=True)
class Certificate:
    """``certified``: the cost is the global optimum's, within the tolerance asked for.

    ``smallest_eigenvalue`` of S (0 but for rounding where certified). ``lower_bound``: no poses whatever cost less.
    ``gap``: ``(cost - lower_bound) / lower_bound``, an upper bound for the share by which the cost is above the
    optimum; infinite where nothing is known.
    """

    convention: Literal["F", "U"]
    certified: bool
    cost: float
    lower_bound: float
    gap: float
    smallest_eigenvalue: float

    def __str__(self) -> str:
        if self.certified:
            return f"{self.convention} = {self.cost:.9g}: globally optimal (gap at most {self.gap:.2g})"
        if np.isinf(self.gap):
            return f"{self.convention} = {self.cost:.9g}: not certified, eigenvalue {self.smallest_eigenvalue:.3g}"
        return f"{self.convention} = {self.cost:.9g}: at most {100 * self.gap:.3g} % above the global optimum"


def certify(graph: PoseGraph, convention: Literal["F", "U"] = "F", tolerance: float = 1e-6) -> Certificate:
    """Certify ``graph``'s poses; ``tolerance``: the relative gap up to which they count as optimal.

    The multipliers are taken at the stationary point that Newton's method finds from the poses (for poses at an optimum
    it only removes rounding); the bound holds for any. Edges of any weight, several connected parts, planar graphs
    (certified in 2-D), and priors are handled. Fixed nodes are taken as free: no poses whatever cost less than that.
    """
    if convention not in ("F", "U"):
        raise BackendError(f"there is no certificate for cost {convention}: only F and U have a dual bound")
    a, d = replace(graph, fixed=frozenset()).arrays(), graph.dimension
    kappa, tau = frobenius_weights(a, convention, d)
    cost = _cost(a, a.poses, kappa, tau)
    rounding = _ROUNDING * _worst(a, kappa, tau)
    if not len(a.ends) or cost <= rounding:
        return Certificate(convention, True, cost, max(cost - rounding, 0.0), 0.0, 0.0)
    M = connection_laplacian(a.ends, a.measured, kappa, tau, len(a.poses), d)
    held = anchors(a)
    near = newton(a.ends, a.measured, (kappa, tau), a.poses, held).poses
    poses = best_translations(near, M, held, d)
    turn = multipliers(poses, (M @ stacked(poses, d).T).T, d)
    dual = _Dual(a, M - rotation_diagonal(turn), d)
    bound = float(np.trace(turn, axis1=1, axis2=2).sum())
    # The trace is the cost but for rounding; take the smaller, so that rounding cannot help.
    bound = min(bound, _cost(a, poses, kappa, tau))
    allowed = max(0.25 * tolerance * bound, rounding) / (len(a.poses) * d)
    eigenvalue = dual.smallest_eigenvalue(allowed)
    bound = max(bound + len(a.poses) * d * min(eigenvalue, 0.0), 0.0)
    gap = max(cost - bound, 0.0) / bound if bound > 0.0 else float("inf")
    certified = cost - bound <= max(tolerance * bound, rounding)
    return Certificate(convention, certified, cost, bound, gap, eigenvalue)


def _cost(a: EdgeArrays, poses: Array, kappa: Array, tau: Array) -> float:
    i, j = a.ends.T
    return float(edge_costs(poses[i], poses[j], a.measured, kappa, tau).sum())


def _worst(a: EdgeArrays, kappa: Array, tau: Array) -> float:
    """The scale of the sums that the cost is the small remainder of."""
    return float((6.0 * kappa + tau * (a.measured[:, :3, 3] ** 2).sum(axis=1)).sum())


class _Dual:
    """S with the translations still in it: sparse, and as good by Schur's complement.

    One translation in each connected part is left out, which only removes the freedom to shift the part.
    """

    def __init__(self, a: EdgeArrays, full: csc_array, d: int) -> None:
        w = d + 1
        kept = np.ones(full.shape[0], dtype=bool)
        kept[np.array(anchors(a), dtype=np.intp) * w] = False
        rows = np.flatnonzero(kept)
        self._matrix = full.tocsc()[rows][:, rows].tocsc()
        self._rotations: NDArray[np.intp] = np.flatnonzero(rows % w != 0)
        self._shift = csc_array(eye_array(len(rows)).tocsc())
        diagonal = np.zeros(len(rows))
        diagonal[self._rotations] = 1.0
        self._shift.setdiag(diagonal)
        self._scale = float(np.abs(self._matrix.diagonal()).max(initial=0.0))

    def smallest_eigenvalue(self, allowed: float) -> float:
        """Of S. Where none lies below ``-allowed`` (a sure count, by inertia), the search begins there."""
        allowed = max(allowed, 1e-15 * self._scale)
        for _ in range(_DOUBLINGS):
            factor, below = self._factorised(-allowed)
            if below == 0:
                return max(self._nearest(factor, -allowed), -allowed)
            allowed *= 4.0
        raise BackendError("the certificate's eigenvalues are not finite: a weight of the graph is")

    def _factorised(self, sigma: float) -> tuple[SuperLU, int]:
        """Factors of S - sigma (with the translations in it), and how many eigenvalues of S lie below sigma: the
        negative pivots (Sylvester), as the translations' own block is positive definite.
        """
        options = {"SymmetricMode": True}
        matrix = (self._matrix - sigma * self._shift).tocsc()
        factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        return factor, int((factor.U.diagonal() < 0.0).sum())

    def _nearest(self, factor: SuperLU, sigma: float) -> float:
        n, rotations = self._matrix.shape[0], self._rotations
        size = len(rotations)

        def inverse(v: Array) -> Array:
            full = np.zeros(n)
            full[rotations] = v.ravel()
            solved: Array = factor.solve(full)[rotations]
            return solved

        operator = _operator(size, inverse)
        start = np.random.default_rng(0).normal(size=size)
        # Largest eigenvalue of (S - sigma)^-1: all are positive, so it belongs to the smallest of S.
        found = eigsh(operator, k=1, which="LA", v0=start, tol=1e-3, return_eigenvectors=False)
        return sigma + 1.0 / float(found[0])


def _operator(size: int, apply: Callable[[Array], Array]) -> LinearOperator:
    return LinearOperator((size, size), matvec=apply, dtype=np.float64)
