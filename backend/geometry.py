"""Rigid and similarity transforms: primitives shared by all packages.

``T_A_B`` maps B to A: ``p_A = T_A_B @ p_B``. Rigid transforms are plain ``(..., 4, 4)`` float64 arrays, composed with
``@``; similarities are :class:`Sim3`, so that a scale can never be forgotten. Tangent vectors put translation first:
``xi = (rho, phi)``, and ``exp`` acts from the right unless a function states otherwise. Angles are radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

_SMALL_ANGLE_RAD = 1e-5
_MANY = 16
"""Rows above which a product is summed along them: numpy is slow at many short sums."""
_PAIRED = 8
"""From so many terms on numpy sums in pairs."""


def product(a: Array, b: Array) -> Array:
    """``a @ b`` of float64 matrices ``(..., n, k)`` and ``(..., k, m)`` or of a matrix and a vector ``(k,)``, each sum
    taken in one order, whatever the number of rows.

    BLAS rounds differently on other kinds of processors and with other numbers of threads. An odometry feeds its own
    rounding errors back and amplifies them (from the last bit to 6 mm in 90 m), so what enters it is summed here.
    """
    if a.ndim == 2 and b.ndim <= 2 and len(a) > _MANY and 0 < a.shape[1] < _PAIRED:
        columns = b[:, None] if b.ndim == 1 else b
        out = columns.T[:, :1] * a.T[:1]
        for k in range(1, a.shape[1]):
            out += columns.T[:, k : k + 1] * a.T[k : k + 1]
        return out[0] if b.ndim == 1 else np.ascontiguousarray(out.T)
    if b.ndim == 1:
        return np.asarray(np.add.reduce(a * b, axis=-1))
    return np.asarray(np.add.reduce(a[..., :, :, None] * b[..., None, :, :], axis=-2))


def inverse3(M: Array) -> Array:
    """Inverse of a regular ``(3, 3)`` matrix, by its adjugate."""
    a, b, c = M.T
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)])
    return np.asarray(adjugate / np.add.reduce(a * adjugate[0]))


def skew(vectors: ArrayLike) -> Array:
    """Cross-product matrices ``(..., 3, 3)`` of ``(..., 3)`` vectors."""
    v = np.asarray(vectors, dtype=np.float64)
    out = np.zeros((*v.shape[:-1], 3, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def so3_exp(phi: ArrayLike) -> Array:
    """Rotation matrices ``(..., 3, 3)`` of rotation vectors ``(..., 3)`` in radians."""
    w = np.asarray(phi, dtype=np.float64)
    angle = _norms(w)[..., None]
    small = angle < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    a = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    b = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    k = skew(w)
    return np.eye(3) + a * k + b * product(k, k)


def so3_log(rotations: ArrayLike) -> Array:
    """Rotation vectors ``(..., 3)`` in radians, norm at most pi, of rotation matrices ``(..., 3, 3)``."""
    q = quat_wxyz_from_rotation(rotations)
    q = np.where(q[..., :1] < 0.0, -q, q)
    sin_half = _norms(q[..., 1:])
    half = np.arctan2(sin_half, q[..., :1])
    small = sin_half < _SMALL_ANGLE_RAD
    factor = np.where(small, 2.0 + sin_half**2 / 3.0, 2.0 * half / np.where(small, 1.0, sin_half))
    return factor * q[..., 1:]


def _left_jacobian(phi: Array) -> Array:
    """Left Jacobian ``V`` of SO(3), ``(..., 3, 3)``: the translation of ``se3_exp`` is ``V @ rho``."""
    angle = np.linalg.norm(phi, axis=-1)[..., None, None]
    small = angle < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    b = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    c = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    k = skew(phi)
    return np.eye(3) + b * k + c * product(k, k)


def se3_exp(xi: ArrayLike) -> Array:
    """Rigid transforms ``(..., 4, 4)`` of tangent vectors ``(..., 6)``, translation part first."""
    x = np.asarray(xi, dtype=np.float64)
    rho, phi = x[..., :3], x[..., 3:]
    return se3(so3_exp(phi), product(_left_jacobian(phi), rho[..., None])[..., 0])


def se3_log(transforms: ArrayLike) -> Array:
    """Tangent vectors ``(..., 6)``, translation part first, of rigid transforms ``(..., 4, 4)``."""
    t = np.asarray(transforms, dtype=np.float64)
    phi = so3_log(t[..., :3, :3])
    rho = np.linalg.solve(_left_jacobian(phi), t[..., :3, 3, None])[..., 0]
    return np.concatenate([rho, phi], axis=-1)


def se3(rotation: ArrayLike, translation: ArrayLike) -> Array:
    """Rigid transforms ``(..., 4, 4)`` from rotations ``(..., 3, 3)`` and translations ``(..., 3)``."""
    r, t = np.asarray(rotation, dtype=np.float64), np.asarray(translation, dtype=np.float64)
    out = np.zeros((*np.broadcast(r[..., 0], t).shape[:-1], 4, 4))
    out[..., :3, :3], out[..., :3, 3], out[..., 3, 3] = r, t, 1.0
    return out


def se3_inverse(transforms: ArrayLike) -> Array:
    """Inverses ``(..., 4, 4)`` of rigid transforms."""
    t = np.asarray(transforms, dtype=np.float64)
    r_inv = np.swapaxes(t[..., :3, :3], -1, -2)
    return se3(r_inv, -product(r_inv, t[..., :3, 3, None])[..., 0])


def transform_points(transform: ArrayLike, points: ArrayLike) -> Array:
    """``(n, 3)`` points of frame B in frame A, by one rigid ``T_A_B`` ``(4, 4)``."""
    t, p = np.asarray(transform, dtype=np.float64), np.asarray(points, dtype=np.float64)
    return product(p, t[:3, :3].T) + t[:3, 3]


def is_se3(transforms: ArrayLike, tolerance: float = 1e-4) -> bool:
    """Whether all are finite rigid transforms: rotations orthonormal within ``tolerance``, last row 0 0 0 1."""
    t = np.asarray(transforms, dtype=np.float64)
    if t.shape[-2:] != (4, 4) or not np.isfinite(t).all():
        return False
    r = t[..., :3, :3]
    orthonormal = np.abs(r @ np.swapaxes(r, -1, -2) - np.eye(3)).max(initial=0.0) < tolerance
    return bool(
        orthonormal and (np.linalg.det(r) > 0).all() and (np.abs(t[..., 3, :] - [0, 0, 0, 1]) < tolerance).all()
    )


def project_to_so3(matrices: ArrayLike) -> Array:
    """Nearest rotations (Frobenius norm) to ``(..., 3, 3)`` matrices."""
    u, _, vt = np.linalg.svd(np.asarray(matrices, dtype=np.float64))
    flip = np.ones((*u.shape[:-2], 3))
    flip[..., 2] = np.sign(np.linalg.det(u @ vt))
    return (u * flip[..., None, :]) @ vt


def quat_wxyz_from_rotation(rotations: ArrayLike) -> Array:
    """Unit quaternions ``(..., 4)``, w first, of rotation matrices ``(..., 3, 3)``; stable at every angle."""
    r = np.asarray(rotations, dtype=np.float64)
    # q q^T times 4: each row is the quaternion times one of its components. The one with the largest component is
    # taken, so no case ever divides by nearly zero.
    outer = np.empty((*r.shape[:-2], 4, 4))
    trace = r[..., 0, 0] + r[..., 1, 1] + r[..., 2, 2]
    outer[..., 0, 0] = 1 + trace
    for i, (j, k) in enumerate(((1, 2), (2, 0), (0, 1))):
        outer[..., i + 1, i + 1] = 1 + 2 * r[..., i, i] - trace
        outer[..., 0, i + 1] = outer[..., i + 1, 0] = r[..., k, j] - r[..., j, k]
        outer[..., j + 1, k + 1] = outer[..., k + 1, j + 1] = r[..., j, k] + r[..., k, j]
    flat = outer.reshape(-1, 4, 4)
    best = np.argmax(np.diagonal(flat, axis1=-2, axis2=-1), axis=-1)
    q = flat[np.arange(len(flat)), best].reshape(*r.shape[:-2], 4)
    return np.asarray(q / _norms(q))


def rotation_from_quat_wxyz(quaternions: ArrayLike) -> Array:
    """Rotation matrices ``(..., 3, 3)`` of quaternions ``(..., 4)``, w first, of any non-zero norm."""
    q = np.asarray(quaternions, dtype=np.float64)
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    w, v = q[..., :1, None], q[..., 1:]
    k = skew(v)
    return np.eye(3) + 2.0 * w * k + 2.0 * product(k, k)


def _norms(vectors: Array) -> Array:
    """Lengths ``(..., 1)`` of ``(..., n)`` vectors; for one vector several times as fast as ``np.linalg.norm``."""
    return np.sqrt(np.add.reduce(vectors * vectors, axis=-1, keepdims=True))


def rotation_angle_deg(rotations: ArrayLike) -> Array:
    """Rotation angles in degrees, ``(...)``, of rotation matrices ``(..., 3, 3)``."""
    return np.degrees(np.linalg.norm(so3_log(rotations), axis=-1))


@dataclass(frozen=True)
class Sim3:
    """A similarity ``T_A_B``: ``p_A = scale * rotation @ p_B + translation``.

    ``rotation`` ``(3, 3)``, ``translation`` ``(3,)``, ``scale`` > 0 (size of B's unit in A's units; 1 for rigid).
    """

    rotation: Array
    translation: Array
    scale: float = 1.0

    @classmethod
    def identity(cls) -> Sim3:
        """The identity similarity, scale 1."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_se3(cls, transform: ArrayLike) -> Sim3:
        """The similarity of scale 1 with the rigid part ``transform`` ``(4, 4)``."""
        t = np.asarray(transform, dtype=np.float64)
        return cls(t[:3, :3].copy(), t[:3, 3].copy())

    def matrix(self) -> Array:
        """The 4x4 matrix that acts on homogeneous points."""
        return se3(self.scale * self.rotation, self.translation)

    def se3(self) -> Array:
        """The rigid part ``(4, 4)``, scale left out."""
        return se3(self.rotation, self.translation)

    def inverse(self) -> Sim3:
        """``T_B_A`` of ``T_A_B``."""
        r_inv = self.rotation.T
        return Sim3(r_inv, -(r_inv @ self.translation) / self.scale, 1.0 / self.scale)

    def __matmul__(self, other: Any) -> Any:
        """Compose with a :class:`Sim3`, or apply to ``(3,)`` / ``(n, 3)`` points."""
        if isinstance(other, Sim3):
            return Sim3(
                self.rotation @ other.rotation,
                self.scale * (self.rotation @ other.translation) + self.translation,
                self.scale * other.scale,
            )
        return self.scale * (np.asarray(other, dtype=np.float64) @ self.rotation.T) + self.translation

    def transform_poses(self, poses: ArrayLike) -> Array:
        """Rigid poses ``T_A_C`` ``(..., 4, 4)`` of cameras given as ``T_B_C``: centres are scaled, rotations only
        turned.
        """
        t = np.asarray(poses, dtype=np.float64)
        return se3(self.rotation @ t[..., :3, :3], self @ t[..., :3, 3])


def umeyama(points_a: ArrayLike, points_b: ArrayLike, with_scale: bool) -> Sim3:
    """Least-squares ``T_A_B`` between paired points ``(n, 3)``, n >= 1 (Umeyama, PAMI 1991).

    Degenerate sets (fewer than three points, or all on a line) give one of the equally good transforms; with all
    points of B in one place the scale is 1.
    """
    a, b = np.asarray(points_a, dtype=np.float64), np.asarray(points_b, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 2 or a.shape[1] != 3 or not len(a):
        raise ValueError(f"umeyama needs two (n, 3) arrays of equal length n >= 1, got {a.shape} and {b.shape}")
    mean_a, mean_b = a.mean(axis=0), b.mean(axis=0)
    da, db = a - mean_a, b - mean_b
    u, singular, vt = np.linalg.svd(da.T @ db / len(a))
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u) * np.linalg.det(vt))])
    rotation = (u * sign) @ vt
    variance_b = (db**2).sum() / len(b)
    scale = float((singular * sign).sum() / variance_b) if with_scale and variance_b > 0 else 1.0
    return Sim3(rotation, mean_a - scale * rotation @ mean_b, scale)
