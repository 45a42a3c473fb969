"""Checks of the images themselves: whether there is light, and anything to follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from maslam.frontend.datasets import Problem
    from maslam.frontend.frames import Frame

_FEW = 30
"""Features that a track begins with."""
_MANY_SHARE = 0.25
"""Share of the images looked at from which dark or empty ones are warned of."""


@dataclass(frozen=True)
class ImageCheck:
    """``features``: corners that key-frames are made of, before they are spread; ``brightness``: grey level, 0 to 255,
    that 95 % of the pixels do not exceed; ``dark``: too dark to be followed."""

    features: int
    brightness: int
    dark: bool


def check_image(frame: Frame) -> ImageCheck:
    """Look at the (left) image."""
    import cv2

    from maslam.frontend.config import FeatureConfig
    from maslam.frontend.tracking.darkness import brightness, is_dark

    corners = cv2.FastFeatureDetector.create(FeatureConfig().fast_threshold).detect(frame.image)
    return ImageCheck(len(corners), brightness(frame.image), is_dark(frame.image))


def image_lines(checks: Sequence[ImageCheck]) -> tuple[str, list[Problem]]:
    """The line of the report and what is wrong, from several frames."""
    from maslam.frontend.datasets import Problem, Severity

    features = int(np.median([c.features for c in checks]))
    bright = int(np.median([c.brightness for c in checks]))
    dark = [c for c in checks if c.dark]
    empty = [c for c in checks if c.features < _FEW and not c.dark]
    problems = []
    if len(dark) > _MANY_SHARE * len(checks):
        problems.append(
            Problem(
                Severity.WARNING,
                f"{len(dark)} of {len(checks)} images looked at are too dark to be followed: 95 % of their pixels have "
                f"at most {max(c.brightness for c in dark)} of 255 grey levels",
            )
        )
    if len(empty) > _MANY_SHARE * len(checks):
        most = max(c.features for c in empty)
        problems.append(
            Problem(
                Severity.WARNING,
                f"hardly any feature in {len(empty)} of {len(checks)} images looked at (at most {most}, {_FEW} are "
                "needed): fog, blur, a bare wall, or a lens cap",
            )
        )
    return f"{features} features an image (median), 95 % of the pixels below grey level {bright}", problems
