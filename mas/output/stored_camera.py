"""The camera of image files that are not rectified as stored: COLMAP's models of it, and where it shows what the
rectified one shows."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import Array, se3

from ..manifest import CameraEntry, StoredCameraEntry

_HALF_PX = 0.5
_PINHOLE, _OPENCV, _OPENCV_FISHEYE, _FULL_OPENCV, _FOV = 1, 4, 5, 6, 7


def colmap_model(camera: CameraEntry) -> tuple[int, list[float]]:
    """COLMAP's number of the model of the image files' camera, and its parameters; the first pixel's centre is at
    (0.5, 0.5)."""
    c = camera.stored or camera
    middle = [c.fx, c.fy, c.cx + _HALF_PX, c.cy + _HALF_PX]
    if camera.stored is None:
        return _PINHOLE, middle
    k = _padded(camera.stored)
    if camera.stored.distortion == "equidistant":  # bends without a coefficient, too
        return _OPENCV_FISHEYE, middle + k[:4]
    if camera.stored.distortion == "none" or not any(k):
        return _PINHOLE, middle
    if camera.stored.distortion == "field-of-view":
        return _FOV, middle + k[:1]
    # OpenCV's k1 k2 p1 p2 k3 k4 k5 k6 is COLMAP's order too.
    return (_FULL_OPENCV, middle + k[:8]) if any(k[4:8]) else (_OPENCV, middle + k[:4])


def turn_to_stored(camera: CameraEntry) -> Array:
    """``T_S_C`` ``(4, 4)``: from the rectified camera to that of the image files, at the same place."""
    return np.eye(4) if camera.stored is None else se3(_rotation(camera.stored).T, np.zeros(3))


def stored_pixels(uv: Array, camera: CameraEntry) -> Array:
    """Pixels ``(n, 2)`` of the image files for those of the rectified image; the first pixel's centre is (0, 0)."""
    s = camera.stored
    if s is None:
        return uv
    rays = np.column_stack([(uv - [camera.cx, camera.cy]) / [camera.fx, camera.fy], np.ones(len(uv))]) @ _rotation(s)
    x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    k, r2 = _padded(s), x * x + y * y
    if s.distortion == "equidistant":
        r = np.sqrt(r2)
        angle = np.arctan(r)
        q = angle * angle
        bent = angle * (1.0 + q * (k[0] + q * (k[1] + q * (k[2] + q * k[3]))))
        grown = np.where(r > 1e-9, bent / np.where(r > 1e-9, r, 1.0), 1.0)
        x, y = x * grown, y * grown
    elif s.distortion == "field-of-view" and k[0] != 0.0:
        widened, r = 2.0 * np.tan(k[0] / 2.0), np.sqrt(r2)
        grown = np.where(r > 1e-9, np.arctan(widened * r) / np.where(r > 1e-9, r, 1.0), widened) / k[0]
        x, y = x * grown, y * grown
    elif s.distortion == "radial-tangential":
        grown = (1.0 + r2 * (k[0] + r2 * (k[1] + r2 * k[4]))) / (1.0 + r2 * (k[5] + r2 * (k[6] + r2 * k[7])))
        across, along = 2.0 * k[2] * x * y + k[3] * (r2 + 2.0 * x * x), k[2] * (r2 + 2.0 * y * y) + 2.0 * k[3] * x * y
        x, y = x * grown + across, y * grown + along
    return np.column_stack([s.fx * x + s.cx, s.fy * y + s.cy])


def _rotation(stored: StoredCameraEntry) -> Array:
    return np.array(stored.rotation, dtype=np.float64).reshape(3, 3)


def _padded(stored: StoredCameraEntry) -> list[float]:
    return [*stored.coefficients, *[0.0] * 8][: max(8, len(stored.coefficients))]
