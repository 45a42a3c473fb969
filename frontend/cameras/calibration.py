"""Cameras as calibrated, distorted or not, before rectification."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .models import PinholeCamera


class Distortion(StrEnum):
    """Lens distortion model of a raw camera; coefficients in OpenCV's order."""

    NONE = "none"
    RADIAL_TANGENTIAL = "radial-tangential"  # OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6]]
    EQUIDISTANT = "equidistant"  # Kannala-Brandt, OpenCV's fisheye: k1 k2 k3 k4


@dataclass(frozen=True)
class RawCamera:
    """A camera as stated by its calibration file. ``size`` ``(width, height)`` pixels, None where the file does not
    state it."""

    fx: float
    fy: float
    cx: float
    cy: float
    size: tuple[int, int] | None = None
    distortion: Distortion = Distortion.NONE
    coefficients: tuple[float, ...] = ()

    @property
    def K(self) -> NDArray[np.float64]:
        """Camera matrix ``(3, 3)``, pixels."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    @property
    def distorted(self) -> bool:
        """Whether the lens differs from a pinhole."""
        return self.distortion is not Distortion.NONE and any(c != 0.0 for c in self.coefficients)

    def pinhole(self, size: tuple[int, int]) -> PinholeCamera:
        """The same camera, distortion left out, for images of ``size`` ``(width, height)``."""
        return PinholeCamera(*size, self.fx, self.fy, self.cx, self.cy)


@dataclass(frozen=True)
class RawRig:
    """One or two cameras as calibrated, and further values of the file.

    ``T_left_right`` ``(4, 4)`` maps the right camera's coordinates into the left's, metres. ``rectified``: the images
    are an ideal stereo pair already; then only its x is used. ``depth_unit_m``: metres per step of the depth images.
    ``rate_hz``: frames per second.
    """

    left: RawCamera
    right: RawCamera | None = None
    T_left_right: NDArray[np.float64] | None = None
    rectified: bool = True
    depth_unit_m: float | None = None
    rate_hz: float | None = None

    @property
    def baseline_m(self) -> float | None:
        """Position of the right camera along the left one's x, metres; None for one camera."""
        return None if self.T_left_right is None else float(self.T_left_right[0, 3])
