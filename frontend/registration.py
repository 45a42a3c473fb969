"""Depth from a camera of its own, as the image's camera would see it: for RGB-D whose depth is stored as measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from frontend.cameras import PinholeCamera

Array = NDArray[np.float64]
Depth = NDArray[np.float32]

_SAME_SURFACE = 0.03
"""Neighbours whose depths differ by less than this share are one surface: a Kinect's step is 1.1 % at 4 m, a wall seen
at 80 degrees changes by 1 % a pixel."""


@dataclass(frozen=True)
class DepthRegistration:
    """``T_C_D`` ``(4, 4)`` maps the frame of ``depth_camera``, which measured, to that of ``camera``, which took the
    image; metres. Lens distortion of both is taken as removed.

    The two should look about the same way: a pixel's outline is taken as upright, and widened by what a roll tilts it.
    """

    depth_camera: PinholeCamera
    camera: PinholeCamera
    T_C_D: Array

    def register(self, depth_m: Depth) -> Depth:
        """``(H, W)`` metres along the image camera's axis from ``depth_m`` as measured; 0 = unknown, in and out.

        Each measured pixel is drawn with its outline: halfway to the neighbours where they lie on the same surface,
        else as large as a pixel facing the camera. So a surface has no holes, and nothing spans an edge: what only
        the image's camera sees stays unknown. The nearest surface hides what lies behind it.
        """
        if depth_m.shape != (self.depth_camera.height, self.depth_camera.width):
            raise ValueError(
                f"depth is {depth_m.shape[1]}x{depth_m.shape[0]} pixels, "
                f"its camera {self.depth_camera.width}x{self.depth_camera.height}"
            )
        out = np.zeros((self.camera.height, self.camera.width), dtype=np.float32)
        depth_m = np.ascontiguousarray(depth_m, dtype=np.float32)
        H, h = _transfer(self.depth_camera, self.camera, self.T_C_D)
        _draw(depth_m, H, h, _tilt(H, self.depth_camera), _SAME_SURFACE, out)
        return out


def _transfer(depth_camera: PinholeCamera, camera: PinholeCamera, T_C_D: Array) -> tuple[Array, Array]:
    """``H`` ``(3, 3)`` and ``h`` ``(3,)``: the pixel ``(u, v)`` with depth ``z`` lies at ``z * H @ (u, v, 1) + h``, in
    homogeneous pixels of the image, whose third component is the depth there."""
    H = camera.K @ T_C_D[:3, :3] @ np.linalg.inv(depth_camera.K)
    return H, camera.K @ T_C_D[:3, 3]


def _tilt(H: Array, depth_camera: PinholeCamera) -> Array:
    """``(2,)`` how far half a pixel's row moves its column in the image, and half its column its row, at most."""
    width, height = depth_camera.width - 1.0, depth_camera.height - 1.0
    corners = H @ np.array([[0.0, width, 0.0, width], [0.0, 0.0, height, height], [1.0, 1.0, 1.0, 1.0]])
    u, v, w = corners[0] / corners[2], corners[1] / corners[2], corners[2]
    return 0.5 * np.array([np.abs((H[0, 1] - u * H[2, 1]) / w).max(), np.abs((H[1, 0] - v * H[2, 0]) / w).max()])


@njit(cache=True, nogil=True)
def _project(z: float, column: float, row: float, H: Array, h: Array) -> tuple[float, float, float]:
    w = z * (H[2, 0] * column + H[2, 1] * row + H[2, 2]) + h[2]
    if w <= 0.0:
        return 0.0, 0.0, 0.0
    u = (z * (H[0, 0] * column + H[0, 1] * row + H[0, 2]) + h[0]) / w
    v = (z * (H[1, 0] * column + H[1, 1] * row + H[1, 2]) + h[1]) / w
    return u, v, w


@njit(cache=True, nogil=True)
def _halfway(depth: Depth, row: int, column: int, down: int, right: int, H: Array, h: Array, same: float) -> float:
    """Where the outline of a pixel ends towards the neighbour ``(down, right)``: image column if ``right``, else row.

    A neighbour that is missing or on another surface is replaced by one at this pixel's own depth.
    """
    z = depth[row, column]
    other = z
    beside, below = column + right, row + down
    if 0 <= beside < depth.shape[1] and 0 <= below < depth.shape[0]:
        near = depth[below, beside]
        if near > 0.0 and abs(near - z) <= same * min(near, z):
            other = near
    u, v, _ = _project(z, column, row, H, h)
    other_u, other_v, w = _project(other, beside, below, H, h)
    if w <= 0.0:
        return u if right != 0 else v
    return 0.5 * (u + other_u) if right != 0 else 0.5 * (v + other_v)


@njit(cache=True, nogil=True)
def _draw(depth: Depth, H: Array, h: Array, tilt: Array, same: float, out: Depth) -> None:
    """Draw every known pixel of ``depth`` into ``out`` (0 where nothing is drawn yet), nearest first to stay."""
    height, width = out.shape
    for row in range(depth.shape[0]):
        for column in range(depth.shape[1]):
            z = depth[row, column]
            if z <= 0.0:
                continue
            _, _, w = _project(z, column, row, H, h)
            if w <= 0.0:
                continue
            left = _halfway(depth, row, column, 0, -1, H, h, same) - tilt[0]
            right = _halfway(depth, row, column, 0, 1, H, h, same) + tilt[0]
            top = _halfway(depth, row, column, -1, 0, H, h, same) - tilt[1]
            bottom = _halfway(depth, row, column, 1, 0, H, h, same) + tilt[1]
            # Pixel centres in [left, right): outlines that share a side never both take or both miss one.
            for v in range(max(0, int(np.ceil(top))), min(height, int(np.ceil(bottom)))):
                for u in range(max(0, int(np.ceil(left))), min(width, int(np.ceil(right)))):
                    if out[v, u] == 0.0 or w < out[v, u]:
                        out[v, u] = w
