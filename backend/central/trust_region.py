"""Newton's method on F in a trust region: from any start to the last digit of the optimum it leads to.

Riemannian trust region with truncated conjugate gradients (Absil et al., 2007), as SE-Sync uses it; preconditioned by
the Gauss-Newton matrix at the start, factorised once. Gauss-Newton itself leaves out the residuals' curvature and only
gains a factor a step on graphs with large residuals; here the digits double.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..components import parts
from ..errors import BackendError
from ..geometry import Array, project_to_so3, se3, skew, so3_exp
from ..pose_graph.edge_arrays import EdgeArrays
from .laplacian import by_node, connection_laplacian, multipliers, stacked
from .large_system import pose_system
from .linear import BlockSystem, edge_costs

# What a step may promise to gain, as a share of the cost, and still be rounding.
_ROUNDING = 1e-14
# A step below this size (rad, or share of the graph's extent) that gains nothing is rounding too.
_SMALL_STEP = 1e-6
_CONJUGATE_STEPS = 200
# With more conjugate steps than this the preconditioner is worth making anew where the poses are now.
_TOO_MANY = 20

Hessian = Callable[[Array], Array]


def named_parts(a: EdgeArrays) -> NDArray[np.intp]:
    """Number of the connected part that each row of ``poses`` belongs to, ``(n,)``; edges of weight 0 join nothing."""
    return parts(a.ends[a.weight > 0], len(a.poses))


def anchors(a: EdgeArrays) -> list[int]:
    """What is held: all fixed nodes, the origin of priors, and of each connected part without any of these the first
    node, so that the others have a place.
    """
    part = named_parts(a)
    first: NDArray[np.intp] = np.unique(part, return_index=True)[1]
    held = [*a.fixed, *([] if a.origin is None else [a.origin])]
    taken = {int(part[row]) for row in held}
    return sorted({*held, *(int(row) for row in first if int(part[row]) not in taken)})


@dataclass(frozen=True, eq=False)
class Refined:
    """``poses`` ``(n, 4, 4)``, the steps that led there, and whether nothing but rounding is left to gain."""

    poses: Array
    steps: int
    converged: bool


def newton(
    ends: NDArray[np.intp],
    measured: Array,
    weights: tuple[Array, Array],
    poses: Array,
    held: Sequence[int],
    steps: int = 100,
) -> Refined:
    """At most ``steps`` trust-region steps on F from ``poses`` ``(n, 4, 4)``; the nodes ``held`` stay.

    ``ends`` ``(m, 2)`` rows of the nodes, ``measured`` ``(m, 4, 4)``, ``weights`` kappa and tau ``(m,)``. Never ends
    higher than it began.
    """
    try:
        model = _Model(ends, measured, weights, poses, held)
    except BackendError:
        return Refined(poses, 0, False)
    now, radius = model.cost(poses), float("inf")
    first = 0.0
    for taken in range(steps):
        gradient, hessian = model.derivatives(poses)
        size = max(float(np.vdot(gradient, model.precondition(gradient))), 0.0) ** 0.5
        first = max(first, size)
        tolerance = min(0.1, size / first) if first else 0.1
        step, gain, length, inner = _conjugate_gradients(gradient, hessian, model.precondition, tolerance, radius)
        if gain <= _ROUNDING * now:
            return Refined(poses, taken, True)
        after = model.moved(poses, step)
        cost = model.cost(after)
        quality = (now - cost) / gain
        if quality < 0.25:
            radius = 0.25 * length
        elif quality > 0.75 and length > 0.99 * radius:
            radius = 2.0 * radius
        if cost < now:
            poses, now = after, cost
            if inner > _TOO_MANY:
                model.factorise(poses)
        elif model.size(step) < _SMALL_STEP:
            return Refined(poses, taken, True)
    return Refined(poses, steps, False)


class _Model:
    """F and its derivatives in steps ``(k, 6)`` of the free nodes: shift in the common frame, turn in the node's."""

    def __init__(
        self, ends: NDArray[np.intp], measured: Array, weights: tuple[Array, Array], poses: Array, held: Sequence[int]
    ) -> None:
        n = len(poses)
        self._ends, self._measured, self._weights = ends, measured, weights
        self._free = np.setdiff1d(np.arange(n), held)
        self._matrix = connection_laplacian(ends, measured, *weights, n, 3)
        self._extent = max(float(np.ptp(poses[:, :3, 3], axis=0).max(initial=0.0)), 1e-9)
        self.factorise(poses)

    def factorise(self, poses: Array) -> None:
        """Make the preconditioner: the Gauss-Newton matrix at ``poses``."""
        self._gauss_newton: BlockSystem | None = None  # one factor at a time in memory
        self._gauss_newton = pose_system(self._ends, poses[:, :3, :3], self._measured, self._weights, self._free)

    def cost(self, poses: Array) -> float:
        i, j = self._ends.T
        return float(edge_costs(poses[i], poses[j], self._measured, *self._weights).sum())

    def size(self, step: Array) -> float:
        shift, turn = np.abs(step[:, :3]).max(initial=0.0), np.abs(step[:, 3:]).max(initial=0.0)
        return max(float(turn), float(shift) / self._extent)

    def moved(self, poses: Array, step: Array) -> Array:
        out = poses.copy()
        R = poses[self._free, :3, :3] @ so3_exp(step[:, 3:])
        out[self._free] = se3(project_to_so3(R), poses[self._free, :3, 3] + step[:, :3])
        return out

    def precondition(self, v: Array) -> Array:
        assert self._gauss_newton is not None
        return self._gauss_newton.solve_for(v)

    def derivatives(self, poses: Array) -> tuple[Array, Hessian]:
        """Half the gradient ``(k, 6)``, and half the Hessian as a function of a step."""
        d, free, M = 3, self._free, self._matrix
        R_T = np.swapaxes(poses[:, :3, :3], 1, 2)
        XM = (M @ stacked(poses, d).T).T
        turn = multipliers(poses, XM, d)

        def hessian(step: Array) -> Array:
            change = np.zeros((len(poses), 3, 4))
            change[free, :, 0] = step[:, :3]
            change[free, :, 1:] = poses[free, :3, :3] @ skew(step[:, 3:])
            flat = np.ascontiguousarray(change.transpose(1, 0, 2).reshape(3, -1))
            out = by_node((M @ flat.T).T, d).copy()
            out[:, :, 1:] -= change[:, :, 1:] @ turn
            return _tangent(out[free], R_T[free])

        return _tangent(by_node(XM, d)[free], R_T[free]), hessian


def _tangent(blocks: Array, R_T: Array) -> Array:
    """Derivatives by ``[t R]`` ``(k, 3, 4)`` as derivatives by shift and turn ``(k, 6)``."""
    A = R_T @ blocks[:, :, 1:]
    turn = np.stack([A[:, 2, 1] - A[:, 1, 2], A[:, 0, 2] - A[:, 2, 0], A[:, 1, 0] - A[:, 0, 1]], axis=1)
    return np.concatenate([blocks[:, :, 0], turn], axis=1)


def _conjugate_gradients(
    gradient: Array, hessian: Hessian, precondition: Hessian, tolerance: float, radius: float
) -> tuple[Array, float, float, int]:
    """Steihaug's truncated conjugate gradients: a step within ``radius`` (in the preconditioner's norm), how much it
    lowers the model, its length, and the iterations it took.
    """
    step, change = np.zeros_like(gradient), np.zeros_like(gradient)
    residual = gradient.copy()
    z = precondition(residual)
    rz = first = float(np.vdot(residual, z))
    direction = -z
    # Inner products in the preconditioner's norm, by recurrence: step.P.step, step.P.direction, direction.P.direction.
    ss, sd, dd = 0.0, 0.0, rz
    taken = 0
    while taken < _CONJUGATE_STEPS:
        taken += 1
        if (rz <= max(tolerance**2 * first, 0.0) and ss > 0.0) or dd <= 0.0:
            break
        product = hessian(direction)
        curvature = float(np.vdot(direction, product))
        alpha = rz / curvature if curvature > 0.0 else np.inf
        ahead = ss + 2.0 * alpha * sd + alpha**2 * dd if np.isfinite(alpha) else np.inf
        if ahead >= radius**2 or not np.isfinite(ahead):
            # Negative curvature, or past the boundary: go as far as allowed, once round the model's own scale if free.
            reach = radius if np.isfinite(radius) else max(np.sqrt(first), np.sqrt(ss))
            alpha = (-sd + np.sqrt(max(sd**2 + dd * (reach**2 - ss), 0.0))) / dd
            step, change = step + alpha * direction, change + alpha * product
            ss = reach**2
            break
        step, change = step + alpha * direction, change + alpha * product
        residual = residual + alpha * product
        z = precondition(residual)
        rz_next = float(np.vdot(residual, z))
        beta = rz_next / rz
        ss = ahead
        sd, dd = beta * (sd + alpha * dd), rz_next + beta**2 * dd
        direction, rz = beta * direction - z, rz_next
    gain = -2.0 * float(np.vdot(gradient, step)) - float(np.vdot(step, change))
    return step, gain, float(np.sqrt(ss)), taken
