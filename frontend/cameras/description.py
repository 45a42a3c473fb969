"""What was understood of a camera, in a sentence and as values."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .calibration import COEFFICIENT_NAMES, Distortion, RawCamera
from .models import PinholeCamera

_IN_WORDS = {
    Distortion.NONE: "without distortion",
    Distortion.RADIAL_TANGENTIAL: "radial-tangential distortion",
    Distortion.EQUIDISTANT: "equidistant (Kannala-Brandt)",
    Distortion.FIELD_OF_VIEW: "field-of-view model",
    Distortion.DOUBLE_SPHERE: "double sphere",
    Distortion.EXTENDED_UNIFIED: "extended unified model",
    Distortion.OMNIDIRECTIONAL: "omnidirectional (Mei)",
}


@dataclass(frozen=True)
class UnderstoodCamera:
    """One camera of a sequence as its file describes it: ``side`` (camera, left, right), the ``source`` file and its
    ``form``, and the ``ideal`` camera that its images are rectified to; None where they are used as stored."""

    side: str
    camera: RawCamera
    source: Path
    form: str
    ideal: PinholeCamera | None

    @property
    def coefficients(self) -> dict[str, float]:
        """The lens's numbers under their names."""
        names = COEFFICIENT_NAMES[self.camera.distortion]
        return dict(zip(names, self.camera.coefficients, strict=False))

    @property
    def done(self) -> str:
        """What is done to the images."""
        if self.ideal is None:
            return "used as stored"
        x, y = (_degrees(*one) for one in _sides(self.ideal))
        return f"rectified here, to a pinhole of {x:.0f} x {y:.0f} degrees"

    def sentence(self) -> str:
        """One line: model, numbers, source, and what is done."""
        c = self.camera
        size = "size not in the file" if c.size is None else f"{c.size[0]}x{c.size[1]} px"
        lens = "".join(f" {name} {value:.6g}" for name, value in self.coefficients.items())
        form = f" ({self.form})" if self.form else ""
        return (
            f"{_IN_WORDS[c.distortion]}{lens}; {size}, fx {c.fx:.2f} fy {c.fy:.2f} cx {c.cx:.2f} cy {c.cy:.2f} px; "
            f"from {self.source.name}{form}; {self.done}"
        )


def _sides(c: PinholeCamera) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    return (c.width - 1.0, c.fx, c.cx), (c.height - 1.0, c.fy, c.cy)


def _degrees(extent: float, focal: float, centre: float) -> float:
    return float(np.degrees(np.arctan(centre / focal) + np.arctan((extent - centre) / focal)))
