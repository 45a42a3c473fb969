"""From pixels of image files to those of the rectified images."""

from __future__ import annotations

import numpy as np

from maslam.backend.geometry import Array
from maslam.mas.manifest import CameraEntry
from maslam.mas.output.stored_camera import stored_pixels, turn_to_stored

_STEPS = 30
_CLOSE_PX = 1e-4
_SMALL_PX = 1e-2  # for derivatives
_LONGEST_STEP = 0.5  # of the image's diagonal


def rectified_pixels(uv: Array, camera: CameraEntry) -> Array:
    """Pixels ``(n, 2)`` of the rectified image that show what the image files show at ``uv``; NaN where there is none.

    The lens's own formula leads from rectified to stored pixels; Newton's method inverts it, whatever the lens.
    """
    if camera.stored is None:
        return uv
    out, limit = _without_lens(uv, camera), _LONGEST_STEP * float(np.hypot(camera.width, camera.height))
    for _ in range(_STEPS):
        off = stored_pixels(out, camera) - uv
        J = np.stack(
            [(stored_pixels(out + step, camera) - stored_pixels(out - step, camera)) / (2 * _SMALL_PX)
             for step in _SMALL_PX * np.eye(2)], axis=-1,
        )  # fmt: skip
        det = J[:, 0, 0] * J[:, 1, 1] - J[:, 0, 1] * J[:, 1, 0]
        det = np.where(np.abs(det) > 1e-9, det, np.nan)
        step = np.stack(
            [
                (J[:, 1, 1] * off[:, 0] - J[:, 0, 1] * off[:, 1]) / det,
                (J[:, 0, 0] * off[:, 1] - J[:, 1, 0] * off[:, 0]) / det,
            ],
            axis=-1,
        )
        length = np.linalg.norm(step, axis=1, keepdims=True)
        out = out - step * np.minimum(1.0, limit / np.maximum(length, 1e-12))
        if not (np.nan_to_num(length) > _CLOSE_PX).any():
            break
    wrong = ~(np.linalg.norm(stored_pixels(out, camera) - uv, axis=1) < 10 * _CLOSE_PX)
    out[wrong] = np.nan
    return out


def _without_lens(uv: Array, camera: CameraEntry) -> Array:
    """Where the pixels would be if the lens did not bend."""
    s = camera.stored
    assert s is not None
    rays = np.column_stack([(uv - [s.cx, s.cy]) / [s.fx, s.fy], np.ones(len(uv))]) @ turn_to_stored(camera)[:3, :3]
    return rays[:, :2] / rays[:, 2:] * [camera.fx, camera.fy] + [camera.cx, camera.cy]
