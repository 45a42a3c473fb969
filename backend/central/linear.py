"""Normal equations of the two stages of pose-graph optimisation, and the costs, as arrays in and arrays out.

The cost everything here belongs to is F of SE-Sync: the sum over edges of
``kappa |R_j - R_i R_ij|_F^2 + tau |t_j - t_i - R_i t_ij|^2``. With the rotations fixed or relaxed it is quadratic,
which the two-stage method uses (Carlone et al., ICRA 2015; distributed: Choudhary et al., IJRR 2017; thesis section
3.6).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from ..errors import BackendError
from ..geometry import Array, skew

# d/d(delta_k) of [delta]_x: the generators of SO(3), (3, 3, 3).
_GENERATORS = skew(np.eye(3))
LARGE = 60_000
"""Equations beyond which memory counts, and a Cholesky factor in blocks is made: compiling it takes longer than smaller
ones to solve."""
# Edges whose derivatives are in memory at a time: a few kB each.
_EDGES = 1024
# Eigenvalues below this share of the largest are rounding (files hold about 6 digits, conditions of 1e11 occur).
_ROUNDING = 1e-12


def isotropic_weights(information: Array, dimension: int = 3) -> tuple[Array, Array]:
    """Rotation and translation weights ``kappa``, ``tau`` ``(m,)`` of information matrices ``(m, 6, 6)`` (SE-Sync's
    choice).

    ``tau = d / trace(inv(Omega_t))``; ``kappa = 3 / (2 trace(inv(Omega_R)))`` in 3-D, the angle's information in 2-D.
    Directions without or with negative information (some public files) count as nearly unknown, which makes the
    weight nearly zero.
    """
    information = np.asarray(information, dtype=np.float64).reshape(-1, 6, 6)
    tau = dimension / _trace_of_inverse(information[:, :dimension, :dimension])
    if dimension == 2:
        return np.maximum(information[:, 5, 5], 0.0), tau
    return 1.5 / _trace_of_inverse(information[:, 3:, 3:]), tau


def indefinite(information: Array) -> NDArray[np.bool_]:
    """Mask ``(m,)`` of the symmetric matrices ``(m, k, k)`` with a negative eigenvalue beyond rounding, which no
    measurement has."""
    values = _eigenvalues(information)
    return np.asarray(values[:, 0] < -_ROUNDING * np.abs(values).max(axis=1))


def positive_information(information: Array) -> Array:
    """``(m, 6, 6)`` with negative eigenvalues raised to 0, the nearest matrices that a cost can use; the others are
    returned as they are.
    """
    broken = indefinite(information)
    if not broken.any():
        return information
    out = information.copy()
    values, vectors = np.linalg.eigh(0.5 * (information[broken] + np.swapaxes(information[broken], -1, -2)))
    out[broken] = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, -1, -2)
    return out


def _trace_of_inverse(blocks: Array) -> Array:
    values = _eigenvalues(blocks)
    floor = np.maximum(values[:, -1:] * 1e-12, 1e-300)
    total: Array = (1.0 / np.maximum(values, floor)).sum(axis=1)
    return total


def _eigenvalues(matrices: Array) -> Array:
    return np.asarray(np.linalg.eigvalsh(0.5 * (matrices + np.swapaxes(matrices, -1, -2))), dtype=np.float64)


def edge_costs(T_i: Array, T_j: Array, T_ij: Array, kappa: Array, tau: Array) -> Array:
    """Each edge's share of F ``(m,)``, from poses ``(m, 4, 4)`` of its ends and measurements ``(m, 4, 4)``."""
    off = T_i @ T_ij
    np.subtract(T_j, off, out=off)
    np.square(off, out=off)
    return kappa * off[:, :3, :3].sum(axis=(1, 2)) + tau * off[:, :3, 3].sum(axis=1)


def rotation_blocks(R_ij: Array, kappa: Array) -> tuple[Array, Array]:
    """Hessians ``(m, 6, 6)`` and gradients ``(m, 6, 3)`` of the relaxed rotation problem.

    Unknown of a node: its rotation's transpose ``(3, 3)``, whose columns are the rows of R: all three share one matrix.
    """
    hessian = np.zeros((len(R_ij), 6, 6))
    hessian[:, :3, :3] = hessian[:, 3:, 3:] = kappa[:, None, None] * np.eye(3)
    hessian[:, :3, 3:] = -kappa[:, None, None] * R_ij
    hessian[:, 3:, :3] = np.swapaxes(hessian[:, :3, 3:], 1, 2)
    return hessian, np.zeros((len(R_ij), 6, 3))


def pose_blocks(R_i: Array, R_j: Array, T_ij: Array, kappa: Array, tau: Array) -> tuple[Array, Array]:
    """Hessians ``(m, 12, 12)`` and right-hand sides ``(m, 12, 1)`` of one Gauss-Newton step of F around rotations
    ``(m, 3, 3)``.

    Unknown of a node: its translation (absolute: F is linear in it) and its turn ``delta``, ``R exp([delta])``.
    """
    m = len(R_i)
    hessian, rhs = np.empty((m, 12, 12)), np.empty((m, 12, 1))
    for at in range(0, m, _EDGES):
        part = slice(at, at + _EDGES)
        hessian[part], rhs[part] = _pose_blocks(R_i[part], R_j[part], T_ij[part], kappa[part], tau[part])
    return hessian, rhs


def _pose_blocks(R_i: Array, R_j: Array, T_ij: Array, kappa: Array, tau: Array) -> tuple[Array, Array]:
    m = len(R_i)
    R_ij, t_ij = T_ij[:, :3, :3], T_ij[:, :3, 3]
    jacobian = np.zeros((m, 12, 12))
    jacobian[:, :3, :3], jacobian[:, :3, 6:9] = -np.eye(3), np.eye(3)
    jacobian[:, :3, 3:6] = R_i @ skew(t_ij)
    jacobian[:, 3:, 3:6], jacobian[:, 3:, 9:] = turn_derivatives(R_i, R_j, R_ij)
    residual = np.concatenate([-(R_i @ t_ij[:, :, None])[:, :, 0], (R_j - R_i @ R_ij).reshape(m, 9)], axis=1)
    weights = np.concatenate([np.repeat(tau[:, None], 3, axis=1), np.repeat(kappa[:, None], 9, axis=1)], axis=1)
    weighted = jacobian * weights[:, :, None]
    hessian = np.swapaxes(jacobian, 1, 2) @ weighted
    return hessian, -(np.swapaxes(weighted, 1, 2) @ residual[:, :, None])


def turn_derivatives(R_i: Array, R_j: Array, R_ij: Array) -> tuple[Array, Array]:
    """Derivatives ``(m, 9, 3)`` of ``R_j - R_i R_ij``, row by row, by the turns of i and of j."""
    m = len(R_i)
    turned_i = -np.einsum("mab,kbc,mcd->mkad", R_i, _GENERATORS, R_ij)
    turned_j = np.einsum("mab,kbc->mkac", R_j, _GENERATORS)
    return turned_i.reshape(m, 3, 9).transpose(0, 2, 1), turned_j.reshape(m, 3, 9).transpose(0, 2, 1)


def curvature_blocks(T_i: Array, T_j: Array, T_ij: Array, kappa: Array, tau: Array) -> Array:
    """What half of F's second derivative ``(m, 12, 12)`` has more than the matrix of :func:`pose_blocks`: the curvature
    of the residuals, which Gauss-Newton leaves out. From poses ``(m, 4, 4)``.
    """
    R_i, R_j, R_ij, t_ij = T_i[:, :3, :3], T_j[:, :3, :3], T_ij[:, :3, :3], T_ij[:, :3, 3]
    out = np.zeros((len(kappa), 12, 12))
    turned = np.swapaxes(R_j, 1, 2) @ R_i
    weight = kappa[:, None, None]
    # Of kappa |R_j - R_i R_ij|^2 = kappa (6 - 2 tr(R_j^T R_i R_ij)): the whole second derivative, less Gauss-Newton's.
    out[:, 3:6, 3:6] = weight * (_curved(R_ij @ turned) - 2.0 * np.eye(3))
    out[:, 9:, 9:] = weight * (_curved(turned @ R_ij) - 2.0 * np.eye(3))
    across = np.einsum("kab,mbc,lcd,mda->mkl", _GENERATORS, turned, _GENERATORS, R_ij)
    linear_i, linear_j = turn_derivatives(R_i, R_j, R_ij)
    out[:, 9:, 3:6] = weight * (across - np.swapaxes(linear_j, 1, 2) @ linear_i)
    out[:, 3:6, 9:] = np.swapaxes(out[:, 9:, 3:6], 1, 2)
    residual = T_j[:, :3, 3] - T_i[:, :3, 3] - (R_i @ t_ij[:, :, None])[:, :, 0]
    seen = (np.swapaxes(R_i, 1, 2) @ residual[:, :, None])[:, :, 0]
    both = seen[:, :, None] * t_ij[:, None, :]
    along = (seen * t_ij).sum(axis=1)[:, None, None] * np.eye(3)
    out[:, 3:6, 3:6] += tau[:, None, None] * (along - 0.5 * (both + np.swapaxes(both, 1, 2)))
    return out


def _curved(product: Array) -> Array:
    """``tr(P) I - (P + P^T) / 2`` of matrices ``(m, 3, 3)``: minus the second derivative of ``tr(P exp([delta]))``."""
    trace = np.trace(product, axis1=1, axis2=2)
    return np.asarray(trace[:, None, None] * np.eye(3) - 0.5 * (product + np.swapaxes(product, 1, 2)))


class BlockSystem:
    """A quadratic cost over nodes joined by edges, of which some nodes are to be solved and the others given.

    ``ends`` ``(m, 2)`` rows of the nodes in ``values``; ``hessian`` ``(m, 2w, 2w)`` and ``rhs`` ``(m, 2w, c)`` of
    each edge for its two ends stacked. Factorised once for a set of solved nodes; each :meth:`solve` is then two
    triangular solves.
    """

    def __init__(self, ends: np.ndarray, hessian: Array, rhs: Array, solved: np.ndarray, used: np.ndarray) -> None:
        """``solved`` (k,): rows of the nodes to solve; ``used`` (m,) bool: edges that take part (both ends known or
        solved).
        """
        width = hessian.shape[1] // 2
        self.solved, self.width = solved, width
        position = np.full(int(max(ends.max(initial=-1), solved.max(initial=-1))) + 1, -1)
        position[solved] = np.arange(len(solved))
        if not used.all():
            ends, hessian, rhs = ends[used], hessian[used], rhs[used]
        own = position[ends]
        size = len(solved) * width
        self._constant = np.zeros((len(solved), width, rhs.shape[2]))
        self._add_constant(own, rhs)
        self._factor: object = self._assemble(own, hessian, size)
        self._couplings = self._collect_couplings(ends, own, hessian)

    def _add_constant(self, own: np.ndarray, rhs: Array) -> None:
        for side in range(2):
            mine = own[:, side] >= 0
            np.add.at(self._constant, own[mine, side], rhs[mine, side * self.width : (side + 1) * self.width])

    def _assemble(self, own: np.ndarray, hessian: Array, size: int) -> object:
        if size > LARGE:
            from .block_cholesky import BlockMatrix  # compiles

            try:
                matrix = BlockMatrix(own, len(self.solved), self.width)
                matrix.add(0, hessian)
                return matrix.factor()
            except BackendError:
                pass  # what is not positive definite by rounding an LU factor may solve, or name
        return self._lu_factor(own, hessian, size)

    def _lu_factor(self, own: np.ndarray, hessian: Array, size: int) -> object:
        w, offsets = self.width, np.arange(self.width, dtype=np.int32)
        matrix = csc_array((size, size))
        # A quarter of the blocks at a time: of large graphs these indices are most of the memory.
        for a in range(2):
            for b in range(2):
                both = (own[:, a] >= 0) & (own[:, b] >= 0)
                ends = own[both].astype(np.int32) * w
                block = hessian[both, a * w : (a + 1) * w, b * w : (b + 1) * w]
                r = np.broadcast_to(ends[:, a, None, None] + offsets[None, :, None], block.shape)
                c = np.broadcast_to(ends[:, b, None, None] + offsets[None, None, :], block.shape)
                matrix = matrix + coo_array((block.ravel(), (r.ravel(), c.ravel())), shape=(size, size)).tocsc()
        try:
            factor = (
                splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
                if size
                else None
            )
        except RuntimeError as error:
            raise BackendError(
                f"the {size} equations of this graph are singular: a pose has no weight to hold it"
            ) from error
        return factor

    def _collect_couplings(self, ends: np.ndarray, own: np.ndarray, hessian: Array) -> tuple[np.ndarray, ...]:
        """Edges from a solved to a given node: rows of both, and the off-diagonal block."""
        w, ours, theirs, blocks = self.width, [], [], []
        for a in range(2):
            cross = (own[:, a] >= 0) & (own[:, 1 - a] < 0)
            ours.append(own[cross, a])
            theirs.append(ends[cross, 1 - a])
            blocks.append(hessian[cross, a * w : (a + 1) * w, (1 - a) * w : (2 - a) * w])
        return np.concatenate(ours), np.concatenate(theirs), np.concatenate(blocks)

    def solve(self, values: Array) -> Array:
        """The solved nodes' values ``(k, w, c)`` given the others' in ``values`` ``(n, w, c)``."""
        if not len(self.solved):
            return np.zeros((0, *values.shape[1:]))
        ours, theirs, blocks = self._couplings
        rhs = self._constant.copy()
        np.subtract.at(rhs, ours, blocks @ values[theirs])
        flat = self._factor.solve(rhs.reshape(len(self.solved) * self.width, -1))  # type: ignore[attr-defined]
        return flat.reshape(rhs.shape)

    def solve_for(self, rhs: Array) -> Array:
        """The matrix's inverse times ``rhs`` ``(k, w)`` or ``(k, w, c)``, whatever the edges' own right-hand sides."""
        if not len(self.solved):
            return np.zeros_like(rhs)
        flat: Array = self._factor.solve(rhs.reshape(len(self.solved) * self.width, -1))  # type: ignore[attr-defined]
        return flat.reshape(rhs.shape)
