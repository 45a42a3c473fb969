"""Whether an image is too dark to be followed: then that is why a frame has no pose, whatever failed first."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..reason import Reason

_SHARE = 0.95
_LEVEL = 20
"""Grey levels that this share of a dark image's pixels does not exceed: three times the contrast of the faintest
corner. By day it is 170 and more; images a tenth as bright, 26, are still followed."""
TOO_DARK = "too dark"


def brightness(image: NDArray[np.uint8]) -> int:
    """Grey level, 0 to 255, that 95 % of the pixels do not exceed; lamps and a sky in a corner do not count."""
    below = np.cumsum(np.bincount(image[::2, ::2].ravel(), minlength=256))
    return int(np.searchsorted(below, _SHARE * below[-1]))


def is_dark(image: NDArray[np.uint8]) -> bool:
    """Whether :func:`brightness` is at most that of a dark image; much quicker."""
    seen = image[::2, ::2]
    return int(np.count_nonzero(seen <= _LEVEL)) >= _SHARE * seen.size


def doubt_dark(image: NDArray[np.uint8]) -> Reason:
    """That a pose was found in an image so dark."""
    level = brightness(image)
    return Reason(TOO_DARK, _said(level), (_LEVEL + 2) / (level + 1))


def _said(level: int) -> str:
    return f"{100 * _SHARE:.0f} % of the pixels have at most {level} of 255 grey levels, need {_LEVEL + 1}"


def unless_dark(refusal: Reason, image: NDArray[np.uint8]) -> Reason:
    """The ``refusal`` of an image, or that it is too dark: noise then looks like corners, which are lost, or stand
    still."""
    level = brightness(image)
    if level > _LEVEL:
        return refusal
    return Reason(TOO_DARK, f"{TOO_DARK}: {_said(level)}", (level + 1) / (_LEVEL + 2))
