"""Cameras as calibrated, distorted or not, before rectification."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from .models import PinholeCamera


class Distortion(StrEnum):
    """Model of a raw camera's lens; :attr:`RawCamera.coefficients` are in the order given here."""

    NONE = "none"
    RADIAL_TANGENTIAL = "radial-tangential"  # OpenCV's k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]]
    EQUIDISTANT = "equidistant"  # Kannala-Brandt, OpenCV's fisheye: k1 k2 k3 k4
    FIELD_OF_VIEW = "field-of-view"  # Devernay and Faugeras 2001: w
    DOUBLE_SPHERE = "double-sphere"  # Usenko et al. 2018: xi alpha
    EXTENDED_UNIFIED = "extended-unified"  # Khomutenko et al. 2016: alpha beta; the unified model with beta 1
    OMNIDIRECTIONAL = "omnidirectional"  # Mei and Rives 2007, OpenCV's omnidir: xi k1 k2 p1 p2


_OPENCVS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4", "tx", "ty")
COEFFICIENT_NAMES: dict[Distortion, tuple[str, ...]] = {
    Distortion.NONE: (),
    Distortion.RADIAL_TANGENTIAL: _OPENCVS,
    Distortion.EQUIDISTANT: ("k1", "k2", "k3", "k4"),
    Distortion.FIELD_OF_VIEW: ("w",),
    Distortion.DOUBLE_SPHERE: ("xi", "alpha"),
    Distortion.EXTENDED_UNIFIED: ("alpha", "beta"),
    Distortion.OMNIDIRECTIONAL: ("xi", "k1", "k2", "p1", "p2"),
}


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
        """Whether the lens differs from a pinhole. An equidistant one does without any coefficient, too."""
        if self.distortion is Distortion.EXTENDED_UNIFIED:
            return self.coefficients[0] != 0.0
        return self.distortion is Distortion.EQUIDISTANT or any(c != 0.0 for c in self.coefficients)

    def pinhole(self, size: tuple[int, int]) -> PinholeCamera:
        """The same camera, distortion left out, for images of ``size`` ``(width, height)``."""
        return PinholeCamera(*size, self.fx, self.fy, self.cx, self.cy)


@dataclass(frozen=True)
class RawRig:
    """One or two cameras as calibrated, and further values of the file.

    ``T_left_right`` ``(4, 4)`` maps the right camera's coordinates into the left's, metres. ``rectified``: the images
    are an ideal stereo pair already; then only its x is used. ``depth_unit_m``: metres per step of the depth images.
    ``rate_hz``: frames per second. ``form``: name of the file's format. ``no_pair``: what the file of one
    camera lacks to be a pair's; ``contradiction``: why the pair that it speaks of cannot be. Both are for whoever has
    right images. ``notes``: what of the file is not used, and need not be, a sentence each; ``doubts``: what
    may be wrong.
    """

    left: RawCamera
    right: RawCamera | None = None
    T_left_right: NDArray[np.float64] | None = None
    rectified: bool = True
    depth_unit_m: float | None = None
    rate_hz: float | None = None
    form: str = ""
    no_pair: str = ""
    contradiction: str = ""
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    @property
    def baseline_m(self) -> float | None:
        """Position of the right camera along the left one's x, metres; None for one camera."""
        return None if self.T_left_right is None else float(self.T_left_right[0, 3])
