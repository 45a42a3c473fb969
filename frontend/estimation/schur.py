"""Normal equations of a window bundle adjustment and their Schur complement: compiled, written in place."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel

from .pose_refinement import HUBER_D, HUBER_UV

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


class Observations(NamedTuple):
    """N observations of P points, sorted by point: those of point j are ``start[j]:start[j + 1]``.

    ``start`` ``(P + 1,)``; ``kf``, ``pt`` ``(N,)``: place of the key-frame in the window, and point. In pixels: ``uv``
    ``(N, 2)``, ``disparity`` ``(N,)``, NaN where unknown, and their standard deviations ``sigma``, ``sigma_d``
    ``(N,)``.
    """

    start: Ints
    kf: Ints
    pt: Ints
    uv: Array
    disparity: Array
    sigma: Array
    sigma_d: Array


class Window(NamedTuple):
    """Parts of a bundle adjustment that stay as they are: K poses, N observations, C numbers of a calibration (C = 0
    leaves it out).

    ``slot`` ``(K,)``: number of a free pose, -1 = fixed; ``cam``: ``[fx, fy, cx, cy, bf]``; ``basis`` ``(N, 3, C)``:
    what the calibration adds to ``u, v, disparity``; its prior ``mean`` ``(C,)``, pixels, and ``information``
    ``(C, C)``.
    """

    slot: Ints
    seen: Observations
    cam: Array
    basis: Array
    mean: Array
    information: Array


class Estimate(NamedTuple):
    """Unknowns of a bundle adjustment: ``poses`` ``(K, 4, 4)`` ``T_C_W``; ``points`` ``(P, 3)`` in the track's frame
    and unit; ``calib`` ``(C,)``: residual calibration, pixels."""

    poses: Array
    points: Array
    calib: Array


class NormalEquations(NamedTuple):
    """Blocks of the normal equations. The m unknowns of the cameras are 6 for each free pose, then the calibration.

    ``U`` ``(m, m)`` with the gradient ``b_c`` ``(m,)``; points: ``V`` ``(P, 3, 3)`` with ``b_p`` ``(P, 3)``, and
    ``V_inv``, damped; ``W`` ``(N, 6, 3)`` between an observation's pose and its point; ``Wc`` ``(P, C, 3)`` between the
    calibration and a point.
    """

    U: Array
    b_c: Array
    V: Array
    b_p: Array
    W: Array
    Wc: Array
    V_inv: Array

    @classmethod
    def room_for(cls, window: Window) -> NormalEquations:
        """Arrays of the right size, filled by :meth:`clear` and :func:`assemble`."""
        n, n_points, n_c = len(window.seen.kf), len(window.seen.start) - 1, window.basis.shape[2]
        m = 6 * (int(window.slot.max()) + 1) + n_c
        V, b_p, V_inv = np.empty((n_points, 3, 3)), np.empty((n_points, 3)), np.empty((n_points, 3, 3))
        return cls(np.empty((m, m)), np.empty(m), V, b_p, np.empty((n, 6, 3)), np.empty((n_points, n_c, 3)), V_inv)

    def clear(self) -> None:
        """Fill with 0: here, as each kernel that does it takes longer to compile."""
        for block in self:
            block.fill(0.0)


@kernel
def robust_weights(e_uv2: float, e_d: float, s: float, s_d: float) -> tuple[float, float, float]:
    """Huber weights of a reprojection and of a disparity residual, and their robust cost."""
    w, w_d = 1.0 / (s * s), 1.0 / (s_d * s_d)
    norm, norm_d = np.sqrt(e_uv2) / s, np.abs(e_d) / s_d
    if norm > HUBER_UV:
        cost = HUBER_UV * (2.0 * norm - HUBER_UV)
        w *= HUBER_UV / norm
    else:
        cost = norm * norm
    if norm_d > HUBER_D:
        cost += HUBER_D * (2.0 * norm_d - HUBER_D)
        w_d *= HUBER_D / norm_d
    else:
        cost += norm_d * norm_d
    return w, w_d, cost


@kernel
def _linearise(T: Array, p: Array, cam: Array, w: float, w_d: float, Jc: Array, Jp: Array) -> None:
    """Jacobians ``(3, 6)`` by the pose (left update) and ``(3, 3)`` by the point, rows times the roots of the weights
    (0 where there is no disparity), written in place."""
    X = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
    Y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
    Z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    iz = 1.0 / Z
    x, y = X * iz, Y * iz
    fx, fy, bf = w * cam[0], w * cam[1], w_d * cam[4]
    a0, a1, a2 = fx * iz, fy * iz, bf * iz * iz
    Jc[0, 0], Jc[0, 1], Jc[0, 2] = a0, 0.0, -a0 * x
    Jc[0, 3], Jc[0, 4], Jc[0, 5] = -fx * x * y, fx * (1 + x * x), -fx * y
    Jc[1, 0], Jc[1, 1], Jc[1, 2] = 0.0, a1, -a1 * y
    Jc[1, 3], Jc[1, 4], Jc[1, 5] = -fy * (1 + y * y), fy * x * y, fy * x
    Jc[2, 0], Jc[2, 1], Jc[2, 2], Jc[2, 3], Jc[2, 4], Jc[2, 5] = 0.0, 0.0, -a2, -a2 * Y, a2 * X, 0.0
    for k in range(3):
        Jp[0, k] = a0 * (T[0, k] - x * T[2, k])
        Jp[1, k] = a1 * (T[1, k] - y * T[2, k])
        Jp[2, k] = -a2 * T[2, k]


@kernel
def _invert3(A: Array, out: Array) -> None:
    a, b, c, d, e, f = A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m0 + b * m1 + c * m2
    inv = 1.0 / det
    out[0, 0], out[0, 1], out[0, 2] = m0 * inv, m1 * inv, m2 * inv
    out[1, 0], out[1, 1], out[1, 2] = out[0, 1], (a * f - c * c) * inv, (b * c - a * e) * inv
    out[2, 0], out[2, 1], out[2, 2] = out[0, 2], out[1, 2], (a * d - b * b) * inv


@kernel
def assemble(estimate: Estimate, window: Window, r: Array, equations: NormalEquations) -> None:
    """Add to all blocks but ``V_inv``, which are 0 before, at ``estimate``, whose residuals are ``r`` ``(N, 3)``.

    Of what is symmetric only the upper half is made, and mirrored at the end, where the calibration's prior joins.
    """
    poses, points, calib = estimate.poses, estimate.points, estimate.calib
    slot, cam, basis, mean, information = window.slot, window.cam, window.basis, window.mean, window.information
    seen = window.seen
    start, kf, disparity, sigma, sigma_d = seen.start, seen.kf, seen.disparity, seen.sigma, seen.sigma_d
    U, b_c, V, b_p, W, Wc = equations.U, equations.b_c, equations.V, equations.b_p, equations.W, equations.Wc
    Jc, Jp, e = np.zeros((3, 6)), np.zeros((3, 3)), np.zeros(3)
    root = np.zeros(3)
    n_c = basis.shape[2]
    base = len(U) - n_c
    for j in range(len(points)):
        for i in range(start[j], start[j + 1]):
            if np.isnan(r[i, 0]):
                continue
            w, w_d, _ = robust_weights(r[i, 0] ** 2 + r[i, 1] ** 2, r[i, 2], sigma[i], sigma_d[i])
            root[0] = root[1] = np.sqrt(w)
            root[2] = 0.0 if np.isnan(disparity[i]) else np.sqrt(w_d)
            _linearise(poses[kf[i]], points[j], cam, root[0], root[2], Jc, Jp)
            for q in range(3):
                e[q] = root[q] * r[i, q]
            for a in range(3):
                b_p[j, a] += Jp[0, a] * e[0] + Jp[1, a] * e[1] + Jp[2, a] * e[2]
                for c in range(a, 3):
                    V[j, a, c] += Jp[0, a] * Jp[0, c] + Jp[1, a] * Jp[1, c] + Jp[2, a] * Jp[2, c]
            s = 6 * slot[kf[i]]
            if s >= 0:
                for a in range(6):
                    b_c[s + a] += Jc[0, a] * e[0] + Jc[1, a] * e[1] + Jc[2, a] * e[2]
                    for c in range(a, 6):
                        U[s + a, s + c] += Jc[0, a] * Jc[0, c] + Jc[1, a] * Jc[1, c] + Jc[2, a] * Jc[2, c]
                    for c in range(3):
                        W[i, a, c] = Jc[0, a] * Jp[0, c] + Jc[1, a] * Jp[1, c] + Jc[2, a] * Jp[2, c]
            for a in range(n_c):
                p0, p1 = root[0] * basis[i, 0, a], root[1] * basis[i, 1, a]
                p2 = root[2] * basis[i, 2, a]
                b_c[base + a] += p0 * e[0] + p1 * e[1] + p2 * e[2]
                for c in range(a, n_c):
                    U[base + a, base + c] += (
                        p0 * root[0] * basis[i, 0, c] + p1 * root[1] * basis[i, 1, c] + p2 * root[2] * basis[i, 2, c]
                    )
                for c in range(3):
                    Wc[j, a, c] += p0 * Jp[0, c] + p1 * Jp[1, c] + p2 * Jp[2, c]
                if s >= 0:
                    for c in range(6):
                        U[s + c, base + a] += p0 * Jc[0, c] + p1 * Jc[1, c] + p2 * Jc[2, c]
        V[j, 1, 0], V[j, 2, 0], V[j, 2, 1] = V[j, 0, 1], V[j, 0, 2], V[j, 1, 2]
    for a in range(len(U)):
        for c in range(a):
            U[a, c] = U[c, a]
    for a in range(n_c):
        for c in range(n_c):
            U[base + a, base + c] += information[a, c]
            b_c[base + a] += information[a, c] * (calib[c] - mean[c])


@kernel
def _subtract(S: Array, row: int, column: int, Y: Array, W: Array) -> None:
    """``S[row:, column:] -= Y @ W.T`` for blocks ``(m, 3)``, ``(n, 3)``."""
    for a in range(len(Y)):
        y0, y1, y2 = Y[a, 0], Y[a, 1], Y[a, 2]
        for c in range(len(W)):
            S[row + a, column + c] -= y0 * W[c, 0] + y1 * W[c, 1] + y2 * W[c, 2]


@kernel
def _times(W: Array, Vi: Array, b: Array, rhs: Array, row: int, Y: Array) -> None:
    """``Y = W @ Vi`` for a block ``(m, 3)``, and ``rhs[row:] -= Y @ b``."""
    for a in range(len(W)):
        w0, w1, w2 = W[a, 0], W[a, 1], W[a, 2]
        for c in range(3):
            Y[a, c] = w0 * Vi[0, c] + w1 * Vi[1, c] + w2 * Vi[2, c]
        rhs[row + a] -= Y[a, 0] * b[0] + Y[a, 1] * b[1] + Y[a, 2] * b[2]


@kernel
def reduce_points(slot: Ints, start: Ints, kf: Ints, equations: NormalEquations, damping: float) -> tuple[Array, Array]:
    """Schur complement of the points: the reduced system of the cameras ``(m, m)`` and its right-hand side ``(m,)``.

    The blocks of :func:`assemble` are read, ``V_inv`` is filled."""
    U, b_c, V, b_p, W, Wc, V_inv = equations
    S, rhs = U.copy(), b_c.copy()
    n_c = Wc.shape[1]
    for k in range(len(S)):
        S[k, k] += damping * U[k, k] + 1e-9
    base = len(S) - n_c
    A, Y, Yc = np.zeros((3, 3)), np.zeros((6, 3)), np.zeros((n_c, 3))
    for j in range(len(V)):
        for a in range(3):
            for c in range(3):
                A[a, c] = V[j, a, c]
            A[a, a] += damping * A[a, a] + 1e-9
        _invert3(A, V_inv[j])
        if n_c:
            _times(Wc[j], V_inv[j], b_p[j], rhs, base, Yc)
            _subtract(S, base, base, Yc, Wc[j])
        for i in range(start[j], start[j + 1]):
            s = 6 * slot[kf[i]]
            if s < 0:
                continue
            _times(W[i], V_inv[j], b_p[j], rhs, s, Y)
            for other in range(start[j], start[j + 1]):
                s_other = 6 * slot[kf[other]]
                if s_other >= s:
                    _subtract(S, s, s_other, Y, W[other])
            if n_c:
                _subtract(S, s, base, Y, Wc[j])
    for a in range(len(S)):
        for c in range(a):
            S[a, c] = S[c, a]
    return S, rhs


@kernel
def back_substitute(slot: Ints, start: Ints, kf: Ints, equations: NormalEquations, delta: Array, points: Array) -> None:
    """Move ``points`` ``(P, 3)`` in place by what the step ``delta`` ``(m,)`` of the cameras leaves to them."""
    b_c, b_p, W, Wc, V_inv = equations.b_c, equations.b_p, equations.W, equations.Wc, equations.V_inv
    n_c = Wc.shape[1]
    base = len(b_c) - n_c
    g = np.zeros(3)
    for j in range(len(points)):
        for c in range(3):
            g[c] = -b_p[j, c]
            for a in range(n_c):
                g[c] -= Wc[j, a, c] * delta[base + a]
        for i in range(start[j], start[j + 1]):
            s = 6 * slot[kf[i]]
            if s >= 0:
                for c in range(3):
                    for a in range(6):
                        g[c] -= W[i, a, c] * delta[s + a]
        for c in range(3):
            points[j, c] += V_inv[j, c, 0] * g[0] + V_inv[j, c, 1] * g[1] + V_inv[j, c, 2] * g[2]
