"""Normal equations of a window bundle adjustment and their Schur complement: compiled, written in place.

``cam`` is ``[fx, fy, cx, cy, bf]``. Blocks: U of the free poses (6 each) and the calibration, V of the points, W
between an observation's pose and its point, Wc between the calibration and a point; b the gradients.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frontend.pose import HUBER_D, HUBER_UV

Array = NDArray[np.float64]
Ints = NDArray[np.int64]


@njit(cache=True, nogil=True)
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


@njit(cache=True, nogil=True)
def _linearise(T: Array, p: Array, uv: Array, has_d: bool, cam: Array, Jc: Array, Jp: Array) -> None:
    """Jacobians ``(3, 6)`` by the pose (left update) and ``(3, 3)`` by the point, written in place."""
    X = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
    Y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
    Z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
    iz = 1.0 / Z
    x, y = X * iz, Y * iz
    a0, a1, a2 = cam[0] * iz, cam[1] * iz, cam[4] * iz * iz
    Jc[0, 0], Jc[0, 1], Jc[0, 2], Jc[0, 3], Jc[0, 4], Jc[0, 5] = (
        a0,
        0.0,
        -a0 * x,
        -cam[0] * x * y,
        cam[0] * (1 + x * x),
        -cam[0] * y,
    )
    Jc[1, 0], Jc[1, 1], Jc[1, 2], Jc[1, 3], Jc[1, 4], Jc[1, 5] = (
        0.0,
        a1,
        -a1 * y,
        -cam[1] * (1 + y * y),
        cam[1] * x * y,
        cam[1] * x,
    )
    Jc[2, :] = 0.0
    if has_d:
        Jc[2, 2], Jc[2, 3], Jc[2, 4] = -a2, -a2 * Y, a2 * X
    for r in range(3):
        for k in range(3):
            Jp[r, k] = Jc[r, 0] * T[0, k] + Jc[r, 1] * T[1, k] + Jc[r, 2] * T[2, k]


@njit(cache=True, nogil=True)
def _invert3(A: Array, out: Array) -> None:
    a, b, c, d, e, f = A[0, 0], A[0, 1], A[0, 2], A[1, 1], A[1, 2], A[2, 2]
    m0, m1, m2 = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * m0 + b * m1 + c * m2
    inv = 1.0 / det
    out[0, 0], out[0, 1], out[0, 2] = m0 * inv, m1 * inv, m2 * inv
    out[1, 0], out[1, 1], out[1, 2] = out[0, 1], (a * f - c * c) * inv, (b * c - a * e) * inv
    out[2, 0], out[2, 1], out[2, 2] = out[0, 2], out[1, 2], (a * d - b * b) * inv


@njit(cache=True, nogil=True)
def assemble(
    poses: Array,
    slot: Ints,
    points: Array,
    start: Ints,
    kf: Ints,
    uv: Array,
    disparity: Array,
    sigma: Array,
    sigma_d: Array,
    cam: Array,
    r: Array,
    basis: Array,
    free: int,
    U: Array,
    b_c: Array,
    V: Array,
    b_p: Array,
    W: Array,
    Wc: Array,
    Jc: Array,
    Jp: Array,
) -> None:
    """Blocks of the normal equations: cameras U, points V, coupling W (pose) and Wc (calibration); gradients b."""
    U[:] = 0.0
    b_c[:] = 0.0
    V[:] = 0.0
    b_p[:] = 0.0
    W[:] = 0.0
    Wc[:] = 0.0
    base, n_c = 6 * free, basis.shape[2]
    for j in range(len(points)):
        for i in range(start[j], start[j + 1]):
            if np.isnan(r[i, 0]):
                continue
            has_d = not np.isnan(disparity[i])
            _linearise(poses[kf[i]], points[j], uv[i], has_d, cam, Jc, Jp)
            w, w_d, _ = robust_weights(r[i, 0] ** 2 + r[i, 1] ** 2, r[i, 2], sigma[i], sigma_d[i])
            s = 6 * slot[kf[i]]
            for q in range(3 if has_d else 2):
                wq = w_d if q == 2 else w
                for a in range(3):
                    b_p[j, a] += wq * Jp[q, a] * r[i, q]
                    for c in range(3):
                        V[j, a, c] += wq * Jp[q, a] * Jp[q, c]
                if s >= 0:
                    for a in range(6):
                        b_c[s + a] += wq * Jc[q, a] * r[i, q]
                        for c in range(6):
                            U[s + a, s + c] += wq * Jc[q, a] * Jc[q, c]
                        for c in range(3):
                            W[i, a, c] += wq * Jc[q, a] * Jp[q, c]
            for q in range(3 if has_d and n_c else (2 if n_c else 0)):
                wq = w_d if q == 2 else w
                for a in range(n_c):
                    phi = wq * basis[i, q, a]
                    b_c[base + a] += phi * r[i, q]
                    for c in range(n_c):
                        U[base + a, base + c] += phi * basis[i, q, c]
                    for c in range(3):
                        Wc[j, a, c] += phi * Jp[q, c]
                    if s >= 0:
                        for c in range(6):
                            U[s + c, base + a] += phi * Jc[q, c]
    # Only the upper half was filled where poses meet the calibration.
    for a in range(base):
        for c in range(n_c):
            U[base + c, a] = U[a, base + c]


@njit(cache=True, nogil=True)
def reduce_points(
    slot: Ints,
    start: Ints,
    kf: Ints,
    n_c: int,
    free: int,
    U: Array,
    b_c: Array,
    V: Array,
    b_p: Array,
    W: Array,
    Wc: Array,
    V_inv: Array,
    damping: float,
) -> tuple[Array, Array]:
    """Schur complement of the points: the reduced camera system and its right-hand side."""
    S, rhs = U.copy(), b_c.copy()
    for k in range(len(S)):
        S[k, k] += damping * U[k, k] + 1e-9
    base = 6 * free
    A, Y, Yc = np.zeros((3, 3)), np.zeros((6, 3)), np.zeros((n_c, 3))
    for j in range(len(V)):
        for a in range(3):
            for c in range(3):
                A[a, c] = V[j, a, c]
            A[a, a] += damping * A[a, a] + 1e-9
        _invert3(A, V_inv[j])
        Vi = V_inv[j]
        if n_c:
            for a in range(n_c):
                for c in range(3):
                    Yc[a, c] = Wc[j, a, 0] * Vi[0, c] + Wc[j, a, 1] * Vi[1, c] + Wc[j, a, 2] * Vi[2, c]
                rhs[base + a] -= Yc[a, 0] * b_p[j, 0] + Yc[a, 1] * b_p[j, 1] + Yc[a, 2] * b_p[j, 2]
            for a in range(n_c):
                for c in range(n_c):
                    S[base + a, base + c] -= Yc[a, 0] * Wc[j, c, 0] + Yc[a, 1] * Wc[j, c, 1] + Yc[a, 2] * Wc[j, c, 2]
        for i in range(start[j], start[j + 1]):
            s = 6 * slot[kf[i]]
            if s < 0:
                continue
            for a in range(6):
                for c in range(3):
                    Y[a, c] = W[i, a, 0] * Vi[0, c] + W[i, a, 1] * Vi[1, c] + W[i, a, 2] * Vi[2, c]
                rhs[s + a] -= Y[a, 0] * b_p[j, 0] + Y[a, 1] * b_p[j, 1] + Y[a, 2] * b_p[j, 2]
            for i2 in range(start[j], start[j + 1]):
                s2 = 6 * slot[kf[i2]]
                if s2 < s:
                    continue
                for a in range(6):
                    for c in range(6):
                        S[s + a, s2 + c] -= Y[a, 0] * W[i2, c, 0] + Y[a, 1] * W[i2, c, 1] + Y[a, 2] * W[i2, c, 2]
            if n_c:
                for a in range(6):
                    for c in range(n_c):
                        S[s + a, base + c] -= Y[a, 0] * Wc[j, c, 0] + Y[a, 1] * Wc[j, c, 1] + Y[a, 2] * Wc[j, c, 2]
    for a in range(len(S)):
        for c in range(a):
            S[a, c] = S[c, a]
    return S, rhs


@njit(cache=True, nogil=True)
def back_substitute(
    slot: Ints,
    start: Ints,
    kf: Ints,
    n_c: int,
    free: int,
    delta: Array,
    b_p: Array,
    W: Array,
    Wc: Array,
    V_inv: Array,
    points: Array,
) -> None:
    g = np.zeros(3)
    for j in range(len(points)):
        for c in range(3):
            g[c] = -b_p[j, c]
            for a in range(n_c):
                g[c] -= Wc[j, a, c] * delta[6 * free + a]
        for i in range(start[j], start[j + 1]):
            s = 6 * slot[kf[i]]
            if s >= 0:
                for c in range(3):
                    for a in range(6):
                        g[c] -= W[i, a, c] * delta[s + a]
        for c in range(3):
            points[j, c] += V_inv[j, c, 0] * g[0] + V_inv[j, c, 1] * g[1] + V_inv[j, c, 2] * g[2]
