"""Small images enlarged for the odometry: of 160x120 pixels, the border that descriptors need leaves half, on which
there are two levels of scale and nothing to share with an agent of a better camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from .cameras.models import PinholeCamera, Rig
from .errors import FrontendError
from .frames import Frame, PutOff
from .image.orb_features import EDGE_PX

Pixel = TypeVar("Pixel", bound=np.generic)
_LEFT = 0.5
"""Share of the image that the border of descriptors leaves, up to which it is enlarged."""
_LEAST_PX = 96
"""Shorter side of the smallest images for which this helps: smaller ones show too little."""
_FACTOR = 2


@dataclass(frozen=True)
class Enlargement:
    """Frames and a rig ``factor`` times as large as those given; 1: as given. Pixel centres are kept."""

    factor: int

    @classmethod
    def of(cls, camera: PinholeCamera) -> Enlargement:
        """That which images of ``camera`` need."""
        width, height = camera.width, camera.height
        left = max(width - 2 * EDGE_PX, 0) * max(height - 2 * EDGE_PX, 0)
        small = min(width, height) >= _LEAST_PX and left <= _LEFT * width * height
        return cls(_FACTOR if small else 1)

    def rig(self, rig: Rig) -> Rig:
        """The rig of the enlarged frames."""
        s, c = self.factor, rig.camera
        centre = (s * (c.cx + 0.5) - 0.5, s * (c.cy + 0.5) - 0.5)
        return replace(rig, camera=PinholeCamera(s * c.width, s * c.height, s * c.fx, s * c.fy, *centre))

    def frame(self, frame: Frame) -> Frame:
        """The enlarged ``frame``, which stays its ``original``; second images are enlarged when they are read."""
        if self.factor == 1:
            return frame
        used, right_used = (None if m is None else self._repeated(m) for m in (frame.used, frame.right_used))
        return Frame(
            frame.index,
            frame.stamp_ns,
            self._smooth(frame.image),
            PutOff(lambda: self._smooth(_there(frame.right))),
            PutOff(lambda: self._repeated(_there(frame.depth_m))),
            frame.name,
            used,
            right_used,
            frame,
        )

    def given_px(self, uv: NDArray[np.float64]) -> NDArray[np.float32]:
        """Pixels ``(n, 2)`` of the images given from those of enlarged ones."""
        return (uv if self.factor == 1 else (uv + 0.5) / self.factor - 0.5).astype(np.float32)

    def given_stats(self, stats: dict[str, float]) -> dict[str, float]:
        """Figures whose names end with ``_px``, in pixels of the images given."""
        return {name: value / self.factor if name.endswith("_px") else value for name, value in stats.items()}

    def _smooth(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        size = image.shape[1] * self.factor, image.shape[0] * self.factor
        return cv2.resize(image, size, interpolation=cv2.INTER_CUBIC).astype(np.uint8, copy=False)

    def _repeated(self, image: NDArray[Pixel]) -> NDArray[Pixel]:
        return np.ascontiguousarray(image.repeat(self.factor, 0).repeat(self.factor, 1))


def _there(image: NDArray[Pixel] | None) -> NDArray[Pixel]:
    """A second image; its frame says why where there is none."""
    if image is None:
        raise FrontendError("no second image")
    return image
