"""Robust least squares for the pose between two cameras that see the same points, with a consistent uncertainty.

Each camera measures a point's direction well and its depth badly: the inverse depth has about the same error
everywhere (stereo). So residuals are direction (2) and inverse depth (1) in the match camera, weighted by the noise
of both measurements; far points then do not pull. Both noise levels are unknown (bundle adjusted points are better
than one stereo pair) and are estimated from the residuals. Gauss-Newton with Cauchy weights.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from maslam._kernels import kernel

from ..geometry import Array, Sim3

ITERATIONS = 12
# A tenth of a pixel of a common camera; noise below it is not believed.
MIN_ANGLE_SIGMA = np.radians(0.01)
START_ANGLE_SIGMA = np.radians(0.3)
# Inverse depth noise, as a share of the inverse of the median depth: start value, and what is not believed.
START_DEPTH_SIGMA, MIN_DEPTH_SIGMA = 0.1, 0.003
MAD_TO_SIGMA = 1.4826
# Points of one surface err alike: so many of them are worth one. Measured on rendered pairs (`maslam bench relpose`).
CORRELATED = 1.45


@dataclass(frozen=True, eq=False)
class Alignment:
    """A refined ``T_M_Q``; ``full_information`` ``(7, 7)``: translation first, in the match's unit, then rotation, then
    log scale (its row and column are 0 where no scale was estimated).

    ``angle_sigma`` radians and ``depth_sigma`` (inverse units of the match): the noise found.
    """

    T_M_Q: Sim3
    full_information: Array
    angle_sigma: float
    depth_sigma: float

    @property
    def information(self) -> Array:
        """Information ``(6, 6)`` of the rigid part, the scale marginalised."""
        return rigid_information(self.full_information)


def rigid_information(full: Array) -> Array:
    """Information ``(6, 6)`` of the rigid part in that of a similarity ``(7, 7)``, the scale marginalised."""
    rigid = full[:6, :6]
    if full[6, 6] > 0:
        rigid = rigid - np.outer(full[:6, 6], full[6, :6]) / full[6, 6]
    return np.asarray(0.5 * (rigid + rigid.T))


def scale_sigma(full: Array) -> float:
    """1 sigma of the log scale in the information of a similarity ``(7, 7)``, the rigid part marginalised: 0 where no
    scale was estimated, infinite where nothing determines it."""
    if full[6, 6] <= 0:
        return 0.0
    rest = full[6, 6] - full[6, :6] @ np.linalg.pinv(full[:6, :6]) @ full[:6, 6]
    return float(1.0 / np.sqrt(rest)) if rest > 1e-12 * full[6, 6] else float("inf")


def refine(
    points_M: Array, points_Q: Array, start: Sim3, with_scale: bool, loss_scale: float, iterations: int = ITERATIONS
) -> Alignment:
    """Refine ``start`` on matched points ``(k, 3)``, k >= 3, most of which should be right."""
    points_M, points_Q = np.ascontiguousarray(points_M), np.ascontiguousarray(points_Q)
    unit = 1.0 / float(np.median(np.linalg.norm(points_M, axis=1)))
    rotation, translation, scale, hessian, angle, depth = _gauss_newton(
        points_M,
        points_Q,
        np.ascontiguousarray(start.rotation),
        start.translation.copy(),
        start.scale,
        7 if with_scale else 6,
        unit,
        loss_scale,
        iterations,
    )
    if not with_scale:
        hessian[6], hessian[:, 6] = 0.0, 0.0
    return Alignment(Sim3(rotation, translation, float(scale)), 0.5 / CORRELATED * (hessian + hessian.T), angle, depth)


@kernel
def _gauss_newton(points_M, points_Q, R, t, s, size, unit, loss_scale, iterations):  # type: ignore[no-untyped-def]
    angle, depth = START_ANGLE_SIGMA, START_DEPTH_SIGMA * unit
    hessian = np.zeros((7, 7))
    for iteration in range(iterations):
        hessian, gradient, ratios = _normal_equations(points_M, points_Q, R, t, s, angle, depth, loss_scale)
        step = _damped_step(hessian, gradient, size)
        turn, R_before = _rotation(step[3], step[4], step[5]), R
        R, t = np.empty((3, 3)), t.copy()
        for a in range(3):
            for b in range(3):
                t[a] += R_before[a, b] * step[b]
                R[a, b] = R_before[a, 0] * turn[0, b] + R_before[a, 1] * turn[1, b] + R_before[a, 2] * turn[2, b]
        s = s * np.exp(min(max(step[6], -1.0), 1.0))
        settled = True
        for i in range(7):
            settled &= abs(step[i]) < 1e-10
        if iteration < ITERATIONS // 2:
            # The noise at which the typical residual is as large as its covariance says.
            across = MAD_TO_SIGMA * 0.5 * (_median(ratios[0]) + _median(ratios[1]))
            angle = max(angle * across, MIN_ANGLE_SIGMA)
            depth = min(max(depth * MAD_TO_SIGMA * _median(ratios[2]), MIN_DEPTH_SIGMA * unit), unit)
        elif settled:
            break
    return R, t, s, hessian, angle, depth


@kernel
def _damped_step(hessian, gradient, size):  # type: ignore[no-untyped-def]
    """Minus the solution ``(7,)`` of the first ``size`` normal equations, 0 beyond, by ``U^T D U`` without pivoting.

    Spelled out: the same sums on every machine, and numba takes seconds to compile a call of LAPACK. A pivot lost to
    rounding is replaced by a share of its diagonal element.
    """
    A, step = hessian.copy(), np.zeros(7)
    for k in range(size):
        # A trace of damping keeps degenerate sets from flying off; it is far below any real information.
        A[k, k] += 1e-9 * A[k, k] + 1e-12
        step[k] = -gradient[k]
    for k in range(size):
        A[k, k] = max(A[k, k], 1e-14 * hessian[k, k], 1e-300)
        for i in range(k + 1, size):
            share = A[k, i] / A[k, k]
            for j in range(i, size):
                A[i, j] -= share * A[k, j]
            step[i] -= share * step[k]
    for k in range(size - 1, -1, -1):
        for j in range(k + 1, size):
            step[k] -= A[k, j] * step[j]
        step[k] /= A[k, k]
    return step


@kernel
def _median(values):  # type: ignore[no-untyped-def]
    """Of ``(n,)`` numbers, n >= 1, which are brought into another order (Hoare's quickselect)."""
    n = len(values)
    low, high, middle = 0, n - 1, n // 2
    while low < high:
        pivot, i, j = values[(low + high) // 2], low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while values[j] > pivot:
                j -= 1
            if i <= j:
                values[i], values[j] = values[j], values[i]
                i, j = i + 1, j - 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    if n % 2:
        return values[middle]
    below = values[0]
    for i in range(1, middle):
        below = max(below, values[i])
    return 0.5 * (below + values[middle])


@kernel
def _rotation(x, y, z):  # type: ignore[no-untyped-def]
    """:func:`maslam.backend.geometry.so3_exp` of one vector, for compiled loops."""
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    small = angle < 1e-5
    a = 1.0 - square / 6.0 if small else np.sin(angle) / angle
    b = 0.5 - square / 24.0 if small else (1.0 - np.cos(angle)) / square
    K, R = np.zeros((3, 3)), np.empty((3, 3))
    K[0, 1], K[0, 2], K[1, 2] = -z, y, -x
    K[1, 0], K[2, 0], K[2, 1] = z, -y, x
    for i in range(3):
        for j in range(3):
            twice = K[i, 0] * K[0, j] + K[i, 1] * K[1, j] + K[i, 2] * K[2, j]
            R[i, j] = (1.0 if i == j else 0.0) + a * K[i, j] + b * twice
    return R


@kernel
def _normal_equations(points_M, points_Q, R, t, s, angle_sigma, depth_sigma, loss_scale):  # type: ignore[no-untyped-def]
    """Hessian ``(7, 7)``, gradient ``(7,)`` and ``|residual| / sigma`` ``(3, k)`` around
    ``p = s R exp(phi) q + t + R rho``.

    The unknowns are (rho, phi, log scale). A residual's covariance is the match's own noise plus the query's, carried
    over. Small sums are spelled out: calls for 3-vectors would cost more than the arithmetic.
    """
    hessian, gradient = np.zeros((7, 7)), np.zeros(7)
    ratios = np.empty((3, len(points_M)))
    frame, to_point, jacobian = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 7))
    p, turned, residual, ray, weighed = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    cov = np.empty((3, 3))
    own = (angle_sigma**2, angle_sigma**2, depth_sigma**2)
    for k in range(len(points_M)):
        q = points_Q[k]
        observed = _frame_of(points_M[k], frame)
        for a in range(3):
            turned[a] = s * (R[a, 0] * q[0] + R[a, 1] * q[1] + R[a, 2] * q[2])
            p[a] = turned[a] + t[a]
        distance = max(np.sqrt(p[0] ** 2 + p[1] ** 2 + p[2] ** 2), 1e-9)
        for a in range(2):
            residual[a] = (frame[a, 0] * p[0] + frame[a, 1] * p[1] + frame[a, 2] * p[2]) / distance
            for b in range(3):
                to_point[a, b] = (frame[a, b] - residual[a] * p[b] / distance) / distance
        residual[2] = 1.0 / distance - 1.0 / observed
        for b in range(3):
            to_point[2, b] = -p[b] / distance**3
        # Noise of the query's measurement: across its ray, and along it.
        reach = s * np.sqrt(q[0] ** 2 + q[1] ** 2 + q[2] ** 2)
        across2 = (angle_sigma * reach) ** 2
        excess = depth_sigma**2 * reach**4 - across2
        for a in range(3):
            ray[a] = (to_point[a, 0] * turned[0] + to_point[a, 1] * turned[1] + to_point[a, 2] * turned[2]) / reach
        for a in range(3):
            for b in range(3):
                cov[a, b] = excess * ray[a] * ray[b] + across2 * (
                    to_point[a, 0] * to_point[b, 0] + to_point[a, 1] * to_point[b, 1] + to_point[a, 2] * to_point[b, 2]
                )
            cov[a, a] += own[a]
            ratios[a, k] = abs(residual[a]) / np.sqrt(cov[a, a])
        # Columns: rho; phi, which moves p by s R (e_a x q); log scale.
        for a in range(3):
            for b in range(3):
                jacobian[a, b] = to_point[a, 0] * R[0, b] + to_point[a, 1] * R[1, b] + to_point[a, 2] * R[2, b]
            for b in range(3):
                c, d = (b + 1) % 3, (b + 2) % 3
                jacobian[a, 3 + b] = s * (jacobian[a, d] * q[c] - jacobian[a, c] * q[d])
            jacobian[a, 6] = to_point[a, 0] * turned[0] + to_point[a, 1] * turned[1] + to_point[a, 2] * turned[2]
        _invert_symmetric(cov)
        squared = 0.0
        for a in range(3):
            weighed[a] = cov[a, 0] * residual[0] + cov[a, 1] * residual[1] + cov[a, 2] * residual[2]
            squared += residual[a] * weighed[a]
        weight = 1.0 / (1.0 + squared / loss_scale**2)
        for i in range(7):
            x, y, z = jacobian[0, i], jacobian[1, i], jacobian[2, i]
            gradient[i] += weight * (x * weighed[0] + y * weighed[1] + z * weighed[2])
            u = weight * (x * cov[0, 0] + y * cov[1, 0] + z * cov[2, 0])
            v = weight * (x * cov[0, 1] + y * cov[1, 1] + z * cov[2, 1])
            w = weight * (x * cov[0, 2] + y * cov[1, 2] + z * cov[2, 2])
            for j in range(7):
                hessian[i, j] += u * jacobian[0, j] + v * jacobian[1, j] + w * jacobian[2, j]
    return hessian, gradient, ratios


@kernel
def _frame_of(point, frame):  # type: ignore[no-untyped-def]
    """Fill the rows of ``frame`` with two unit vectors across ``point`` and its own direction; returns its distance."""
    distance = np.sqrt(point[0] ** 2 + point[1] ** 2 + point[2] ** 2)
    for a in range(3):
        frame[2, a] = point[a] / distance
    x, y, z = frame[2, 0], frame[2, 1], frame[2, 2]
    # Across: the point's direction times the axis it is least along of x and y.
    if abs(x) <= abs(y):
        norm = np.sqrt(y * y + z * z)
        frame[0, 0], frame[0, 1], frame[0, 2] = 0.0, z / norm, -y / norm
    else:
        norm = np.sqrt(x * x + z * z)
        frame[0, 0], frame[0, 1], frame[0, 2] = -z / norm, 0.0, x / norm
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        frame[1, a] = frame[2, b] * frame[0, c] - frame[2, c] * frame[0, b]
    return distance


@kernel
def _invert_symmetric(m):  # type: ignore[no-untyped-def]
    """Replace a symmetric ``(3, 3)`` matrix by its inverse."""
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * aa + b * bb + c * cc
    m[0, 0], m[1, 1], m[2, 2] = aa / determinant, (a * f - c * c) / determinant, (a * d - b * b) / determinant
    m[0, 1] = m[1, 0] = bb / determinant
    m[0, 2] = m[2, 0] = cc / determinant
    m[1, 2] = m[2, 1] = (b * c - a * e) / determinant
