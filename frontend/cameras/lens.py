"""Lenses as formulas: from directions to stored pixels and back, for every model that a calibration file may name."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from .calibration import Distortion, RawCamera

Array = NDArray[np.float64]

_NEWTON_STEPS = 20
_TINY = 1e-12


def project(camera: RawCamera, rays: Array) -> Array:
    """Stored pixels ``(n, 2)`` of directions ``(n, 3)`` in the camera's frame, of any length; NaN where the lens does
    not see one."""
    rays = np.asarray(rays, dtype=np.float64)
    with np.errstate(divide="ignore", invalid="ignore"):
        return _normalised(camera, rays) * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def unproject(camera: RawCamera, pixels: Array) -> Array:
    """Directions ``(n, 3)`` of length 1 of stored pixels ``(n, 2)``; NaN for a pixel that shows nothing."""
    pixels = np.asarray(pixels, dtype=np.float64)
    xy = (pixels - [camera.cx, camera.cy]) / [camera.fx, camera.fy]
    if camera.distortion is Distortion.RADIAL_TANGENTIAL:
        rays = np.column_stack([_unbend(pixels, camera.coefficients, camera.K), np.ones(len(pixels))])
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        rays = _rays(camera, xy)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)


def _normalised(camera: RawCamera, rays: Array) -> Array:
    """Where directions fall in an image of focal length 1 around its principal point."""
    x, y, z = rays.T
    k, r = camera.coefficients, np.hypot(x, y)
    match camera.distortion:
        case Distortion.EQUIDISTANT:
            angle = np.arctan2(r, z)
            bent = angle * (1.0 + angle**2 * np.polynomial.polynomial.polyval(angle**2, k))
            return rays[:, :2] * _ratio(bent, r, 1.0)[:, None]
        case Distortion.FIELD_OF_VIEW if k[0] != 0.0:
            widened = 2.0 * np.tan(k[0] / 2.0)
            return rays[:, :2] * _ratio(np.arctan2(widened * r, z) / k[0], r, widened / k[0])[:, None]
        case Distortion.DOUBLE_SPHERE:
            xi, alpha = k
            moved = xi * np.sqrt(r * r + z * z) + z
            return _seen(rays, alpha * np.hypot(r, moved) + (1.0 - alpha) * moved, _limit(rays, camera))
        case Distortion.EXTENDED_UNIFIED:
            alpha, beta = k
            return _seen(rays, alpha * np.sqrt(beta * r * r + z * z) + (1.0 - alpha) * z, _limit(rays, camera))
        case Distortion.OMNIDIRECTIONAL:
            return _bend(_seen(rays, z + k[0] * np.sqrt(r * r + z * z), _limit(rays, camera)), k[1:])
    flat = _seen(rays, z, z > 0)
    return _bend(flat, k) if k else flat


def _rays(camera: RawCamera, xy: Array) -> Array:
    """Directions, of any length, of points in an image of focal length 1."""
    k, r2 = camera.coefficients, (xy**2).sum(axis=1)
    r = np.sqrt(r2)
    match camera.distortion:
        case Distortion.EQUIDISTANT:
            angle = _unbent_angle(r, k)
            return np.column_stack([xy * _ratio(np.sin(angle), r, 1.0)[:, None], np.cos(angle)])
        case Distortion.FIELD_OF_VIEW if k[0] != 0.0:
            angle = r * k[0]
            seen = np.where(np.abs(angle) < np.pi, angle, np.nan)
            widened = 2.0 * np.tan(k[0] / 2.0)
            return np.column_stack([xy * _ratio(np.sin(seen) / widened, r, k[0] / widened)[:, None], np.cos(seen)])
        case Distortion.DOUBLE_SPHERE:
            xi, alpha = k
            z = (1.0 - alpha**2 * r2) / (alpha * np.sqrt(1.0 - (2.0 * alpha - 1.0) * r2) + 1.0 - alpha)
            scale = (z * xi + np.sqrt(z * z + (1.0 - xi**2) * r2)) / (z * z + r2)
            return np.column_stack([xy * scale[:, None], scale * z - xi])
        case Distortion.EXTENDED_UNIFIED:
            alpha, beta = k
            root = np.sqrt(1.0 - (2.0 * alpha - 1.0) * beta * r2)
            return np.column_stack([xy, (1.0 - beta * alpha**2 * r2) / (alpha * root + 1.0 - alpha)])
        case Distortion.OMNIDIRECTIONAL:
            flat = _unbend(xy, k[1:], np.eye(3))
            r2 = (flat**2).sum(axis=1)
            scale = (k[0] + np.sqrt(1.0 + (1.0 - k[0] ** 2) * r2)) / (1.0 + r2)
            return np.column_stack([flat * scale[:, None], scale - k[0]])
    return np.column_stack([xy, np.ones(len(xy))])


def _limit(rays: Array, camera: RawCamera) -> NDArray[np.bool_]:
    """Which directions a model of spheres has a place for: beyond, two of them share one."""
    z, length = rays[:, 2], np.linalg.norm(rays, axis=1)
    k = camera.coefficients
    if camera.distortion is Distortion.OMNIDIRECTIONAL:
        return z > -length * min(k[0], 1.0 / k[0] if k[0] > 0 else 0.0)
    if camera.distortion is Distortion.EXTENDED_UNIFIED:
        alpha, length = k[0], np.sqrt(k[1] * (rays[:, :2] ** 2).sum(axis=1) + z * z)
        w = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha
        return z > -w * length
    xi, alpha = k
    w1 = alpha / (1.0 - alpha) if alpha <= 0.5 else (1.0 - alpha) / alpha
    w2 = (w1 + xi) / np.sqrt(2.0 * w1 * xi + xi * xi + 1.0)
    return z > -w2 * length


def _seen(rays: Array, depth: Array, seen: NDArray[np.bool_]) -> Array:
    """``x, y`` over ``depth`` where ``seen``."""
    flat = rays[:, :2] / depth[:, None]
    flat[~(seen & (depth > _TINY))] = np.nan
    return flat


def _ratio(a: Array, b: Array, at_zero: float) -> Array:
    return np.where(b > _TINY, a / np.where(b > _TINY, b, 1.0), at_zero)


def _unbent_angle(r: Array, k: tuple[float, ...]) -> Array:
    """The angle from the axis whose image lies ``r`` from the centre, by Newton's steps; NaN where there is none below
    180 degrees on the rising part of the polynomial."""
    odd = np.array([1.0, *k])
    slope = odd * (2 * np.arange(len(odd)) + 1)
    angle = np.minimum(r, np.pi)
    for _ in range(_NEWTON_STEPS):
        square = angle * angle
        off = angle * np.polynomial.polynomial.polyval(square, odd) - r
        steep = np.polynomial.polynomial.polyval(square, slope)
        angle = np.clip(angle - off / np.maximum(steep, 1e-3), 0.0, np.pi)
    square = angle * angle
    off = angle * np.polynomial.polynomial.polyval(square, odd) - r
    rising = np.polynomial.polynomial.polyval(square, slope) > 0
    return np.where((np.abs(off) < 1e-6) & rising, angle, np.nan)


def _bend(xy: Array, k: tuple[float, ...]) -> Array:
    """OpenCV's radial and tangential distortion."""
    if len(k) > 8:
        still = np.zeros(3)
        points = np.column_stack([xy, np.ones(len(xy))])
        return np.asarray(cv2.projectPoints(points, still, still, np.eye(3), np.array(k))[0])[:, 0]
    k1, k2, p1, p2, k3, k4, k5, k6 = (*k, *[0.0] * (8 - len(k)))
    x, y = xy.T
    r2 = x * x + y * y
    radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    across = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    down = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    return np.column_stack([x * radial + across, y * radial + down])


def _unbend(pixels: Array, k: tuple[float, ...], K: Array) -> Array:
    """The inverse of :func:`_bend`, by OpenCV's iteration, of pixels of a camera matrix."""
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-10)
    points = np.ascontiguousarray(pixels)[:, None]
    return np.asarray(cv2.undistortPoints(points, K, np.array(k, dtype=np.float64), criteria=criteria))[:, 0]
