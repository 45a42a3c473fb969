"""Lenses as their authors write them, apart from the code under test: where a direction falls in the image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def double_sphere(rays: Array, xi: float, alpha: float) -> Array:
    """Usenko, Demmel and Cremers, The Double Sphere Camera Model, 3DV 2018, equations 40 to 42."""
    x, y, z = rays.T
    d1 = np.sqrt(x * x + y * y + z * z)
    d2 = np.sqrt(x * x + y * y + (xi * d1 + z) ** 2)
    return np.stack([x, y], 1) / (alpha * d2 + (1 - alpha) * (xi * d1 + z))[:, None]


def extended_unified(rays: Array, alpha: float, beta: float) -> Array:
    """Khomutenko, Garcia and Martinet, An Enhanced Unified Camera Model, RA-L 2016."""
    x, y, z = rays.T
    rho = np.sqrt(beta * (x * x + y * y) + z * z)
    return np.stack([x, y], 1) / (alpha * rho + (1 - alpha) * z)[:, None]


def field_of_view(rays: Array, w: float) -> Array:
    """Devernay and Faugeras, Straight lines have to be straight, 2001; in front of the camera only."""
    flat = rays[:, :2] / rays[:, 2:]
    r = np.linalg.norm(flat, axis=1, keepdims=True)
    return flat * (np.arctan(2 * r * np.tan(w / 2)) / w / r)


def equidistant(rays: Array, *k: float) -> Array:
    """Kannala and Brandt, PAMI 2006, with odd powers up to the ninth."""
    across = np.linalg.norm(rays[:, :2], axis=1, keepdims=True)
    theta = np.arctan2(across, rays[:, 2:])
    bent = theta + sum(one * theta ** (2 * i + 3) for i, one in enumerate(k))
    return rays[:, :2] / across * bent


def radial_tangential(flat: Array, k1: float, k2: float, p1: float, p2: float) -> Array:
    """Brown's distortion of points at depth 1."""
    x, y = flat.T
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    return np.stack(
        [x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y], 1
    )


def mei(rays: Array, xi: float, k1: float, k2: float, p1: float, p2: float) -> Array:
    """Mei and Rives, Single view point omnidirectional camera calibration, ICRA 2007."""
    on_sphere = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return radial_tangential(on_sphere[:, :2] / (on_sphere[:, 2:] + xi), k1, k2, p1, p2)


FORMULAS = {
    "double-sphere": double_sphere,
    "extended-unified": extended_unified,
    "field-of-view": field_of_view,
    "equidistant": equidistant,
    "omnidirectional": mei,
}
