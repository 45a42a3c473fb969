"""Depth from a camera of its own, as the image's camera would see it: for RGB-D whose depth is stored as measured."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam._kernels import kernel
from maslam.backend.geometry import inverse3, product

from .models import PinholeCamera

Array = NDArray[np.float64]
Depth = NDArray[np.float32]

_SAME_SURFACE = 0.03
"""Neighbours whose depths differ by less than this share are one surface: a Kinect's step is 1.1 % at 4 m, a wall seen
at 80 degrees changes by 1 % a pixel."""


@dataclass(frozen=True)
class DepthRegistration:
    """Mapping of depth from the camera that measured it to the camera of the image.

    ``T_C_D`` ``(4, 4)`` maps the frame of ``depth_camera``, which measured, to that of ``camera``, which took the
    image; metres. Lens distortion of both is taken as removed. The two should look in about the same direction: a
    pixel's outline is taken as upright, and widened by what a roll tilts it.
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
    H = product(product(camera.K, T_C_D[:3, :3]), inverse3(depth_camera.K))
    return H, product(camera.K, T_C_D[:3, 3])


def _tilt(H: Array, depth_camera: PinholeCamera) -> Array:
    """``(2,)`` how far half a pixel's row moves its column in the image, and half its column its row, at most."""
    width, height = depth_camera.width - 1.0, depth_camera.height - 1.0
    corners = product(H, np.array([[0.0, width, 0.0, width], [0.0, 0.0, height, height], [1.0, 1.0, 1.0, 1.0]]))
    u, v, w = corners[0] / corners[2], corners[1] / corners[2], corners[2]
    return 0.5 * np.array([np.abs((H[0, 1] - u * H[2, 1]) / w).max(), np.abs((H[1, 0] - v * H[2, 0]) / w).max()])


@kernel(error_model="numpy")
def _place(z: float, column: int, row: int, H: Array, h: Array, axis: int) -> float:
    """Image column (``axis`` 0) or row (1) of a pixel at depth ``z`` that lies before the image's camera."""
    w = z * (H[2, 0] * column + H[2, 1] * row + H[2, 2]) + h[2]
    return (z * (H[axis, 0] * column + H[axis, 1] * row + H[axis, 2]) + h[axis]) / w


@kernel(error_model="numpy")
def _depth_beside(depth: Depth, z: float, column: int, row: int, same: float) -> float:
    """Depth of a neighbour on the same surface as ``z``; ``z`` itself where the neighbour is missing or on another."""
    if 0 <= row < depth.shape[0] and 0 <= column < depth.shape[1]:
        beside = depth[row, column]
        if abs(beside - z) <= same * min(beside, z):
            return beside
    return z


@kernel(error_model="numpy")
def _draw(depth: Depth, H: Array, h: Array, tilt: Array, same: float, out: Depth) -> None:
    """Draw every known pixel of ``depth`` into ``out`` (0 where nothing is drawn yet), nearest first to stay."""
    height, width = out.shape
    for r in range(depth.shape[0]):
        for c in range(depth.shape[1]):
            z = depth[r, c]
            w = z * (H[2, 0] * c + H[2, 1] * r + H[2, 2]) + h[2]
            if z <= 0.0 or w <= 0.0:
                continue
            u, v = _place(z, c, r, H, h, 0), _place(z, c, r, H, h, 1)
            left = 0.5 * (u + _place(_depth_beside(depth, z, c - 1, r, same), c - 1, r, H, h, 0)) - tilt[0]
            right = 0.5 * (u + _place(_depth_beside(depth, z, c + 1, r, same), c + 1, r, H, h, 0)) + tilt[0]
            top = 0.5 * (v + _place(_depth_beside(depth, z, c, r - 1, same), c, r - 1, H, h, 1)) - tilt[1]
            bottom = 0.5 * (v + _place(_depth_beside(depth, z, c, r + 1, same), c, r + 1, H, h, 1)) + tilt[1]
            # Pixel centres in [left, right): outlines that share a side never both take or both miss one.
            # Clipped before it is made an integer: a point just before the image's camera may land anywhere.
            first_u, end_u = int(np.ceil(max(left, 0.0))), int(np.ceil(min(right, float(width))))
            first_v, end_v = int(np.ceil(max(top, 0.0))), int(np.ceil(min(bottom, float(height))))
            for y in range(first_v, end_v):
                for x in range(first_u, end_u):
                    if out[y, x] == 0.0 or w < out[y, x]:
                        out[y, x] = w
