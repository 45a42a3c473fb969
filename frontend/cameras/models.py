"""Camera and rig models after rectification, as tracking uses them. Raw, distorted cameras live in ``calibration``."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PinholeCamera:
    """An undistorted pinhole: size of the image, focal lengths and principal point, all in pixels; the centre of the
    top-left pixel is (0, 0), as in OpenCV."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def K(self) -> NDArray[np.float64]:
        """Camera matrix ``(3, 3)``, pixels; camera frame: +Z forward, +X right, +Y down."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


class RigKind(StrEnum):
    """Kind of rig: one camera, a stereo pair, or a camera with depth."""

    MONO = "mono"
    STEREO = "stereo"
    RGBD = "rgbd"


@dataclass(frozen=True)
class Rig:
    """The sensor of one agent, rectified: poses are those of ``camera`` (the left one of a stereo pair).

    ``baseline_m``: stereo only, metres; the right camera sits at ``x = +baseline_m`` in the left camera's frame.
    """

    kind: RigKind
    camera: PinholeCamera
    baseline_m: float | None = None

    @property
    def metric(self) -> bool:
        """Whether poses are in metres; a monocular track is in its own unit."""
        return self.kind is not RigKind.MONO
