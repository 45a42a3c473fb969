"""From images as stored to images of an ideal pinhole or an ideal stereo pair: maps built once, applied to every frame."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Maps = tuple[NDArray[np.int16], NDArray[np.uint16]]


@dataclass(frozen=True)
class Rectifier:
    """Look-up maps of ``cv2.remap`` for the left and, in stereo, the right image; sizes are those of the rectified images.

    ``depth_map`` ``(H, W, 2)`` int32: column and row of the stored pixel whose depth a rectified pixel takes, or -1. Depth is not
    interpolated: a mean across an edge would be a surface that does not exist.
    """

    left: Maps
    right: Maps | None = None
    depth_map: NDArray[np.int32] | None = None

    def rectify(
        self, image: NDArray[np.uint8], right: NDArray[np.uint8] | None, depth_m: NDArray[np.float32] | None
    ) -> tuple[NDArray[np.uint8], NDArray[np.uint8] | None, NDArray[np.float32] | None]:
        """Rectified image, right image and depth; what is None stays None."""
        out_image = cv2.remap(image, *self.left, cv2.INTER_LINEAR)
        out_right = cv2.remap(right, *self.right, cv2.INTER_LINEAR) if right is not None and self.right is not None else right
        return out_image, out_right, self._rectify_depth(depth_m)

    def _rectify_depth(self, depth_m: NDArray[np.float32] | None) -> NDArray[np.float32] | None:
        if depth_m is None or self.depth_map is None:
            return depth_m
        column, row = self.depth_map[..., 0], self.depth_map[..., 1]
        return np.where(column >= 0, depth_m[row, column], np.float32(0.0))
