"""The search for followed points in a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse, transform_points

from ..config import OdometryConfig
from ..frames import Frame
from ..image.patch_alignment import align
from ..image.used_pixels import are_used
from ..mapping.range_sensor import Ranging
from .followed_points import FollowedPoints

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PointSearch:
    """A ``frame`` in which n points ``followed`` from the key-frame at ``anchor_T`` (``T_C_W``) are looked for, its
    ``image`` with halvings, the points' positions ``xyz`` ``(n, 3)`` in the track's frame, NaN where unknown, and those
    known not to move, ``proven`` ``(n,)``."""

    frame: Frame
    image: list[NDArray[np.uint8]]
    xyz: Array
    proven: NDArray[np.bool_]
    followed: FollowedPoints
    anchor_T: Array
    ranging: Ranging
    config: OdometryConfig

    def find(self, T_C_W: Array, only: NDArray[np.bool_] | None = None) -> tuple[Array, NDArray[np.bool_]]:
        """Points of known position looked for around their projection with ``T_C_W``: pixels ``(n, 2)``, found
        ``(n,)``."""
        uv, found = self.followed.uv.copy(), np.zeros(len(self.followed.uv), dtype=bool)
        T = product(T_C_W, se3_inverse(self.anchor_T))
        guess, warp = self.ranging.show(T, transform_points(self.anchor_T, self.xyz))
        inside = self._inside(guess)
        index = np.flatnonzero(inside if only is None else inside & only)
        flow, patches = self.config.flow, self.followed.patches.take(index)
        uv[index], found[index] = align(
            patches, self.image, warp[index], guess[index], flow.min_correlation, flow.reach_px
        )
        return uv, found & are_used(self.frame.used, uv)

    def agreeing(self, uv: Array, found: NDArray[np.bool_], T_C_W: Array) -> NDArray[np.bool_]:
        """Points ``(n,)`` found where this pose sees them, those that come out from behind something among them."""
        at, inlier = np.flatnonzero(found), np.zeros(len(found), dtype=bool)
        seen, _ = self.ranging.project(T_C_W, self.xyz[at])
        bound_px = self.config.pose.outlier_sigmas * self.config.pose.pixel_sigma_px
        inlier[at] = np.nan_to_num(np.hypot(*(seen - uv[at]).T), nan=np.inf) < bound_px
        return inlier

    def in_view(self, T_C_W: Array) -> NDArray[np.bool_]:
        """Points ``(n,)`` that a camera there has in its image."""
        uv, depth = self.ranging.project(T_C_W, self.xyz)
        return np.asarray((depth > 0) & self._inside(uv))

    def _inside(self, uv: Array) -> NDArray[np.bool_]:
        """Pixels ``(n, 2)`` around which there is room for a patch."""
        height, width = self.image[0].shape
        return (uv[:, 0] > 4) & (uv[:, 1] > 4) & (uv[:, 0] < width - 5) & (uv[:, 1] < height - 5)
