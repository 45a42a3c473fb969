"""From the values that image files store to grey levels of 8 bits: chosen once for a sequence, by its content, so that
a place looks the same in all its images."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

_VALUES = 65536
_ABOVE = 1e-4
"""Share of pixels that may lie above the range: dead pixels, a lamp."""
_BITS = (8, 10, 12, 14, 16)
_NARROW = 0.25
"""Content that fills less of its bits is stretched: what a thermal camera sees differs in a few hundred steps."""
_TAIL, _MARGIN = 1e-3, 0.25
"""Share of pixels left out at each end of narrow content; what is then added on each side, of its width."""
_MOSAIC = 0.03
"""Contrast of the four places of a 2x2 block, of their mean, from which an image is a colour mosaic: neighbours of any
other picture have one mean."""
_GREENS = 0.35
"""Share of that contrast by which the two green places may differ."""
_CROSS = np.array([0.25, 0.5, 0.25])


@dataclass(frozen=True)
class PixelValues:
    """``dark``, ``bright``: the values of an image of 16 bits that become 0 and 255; those of 8 bits stay as they are.

    ``mosaic``: images of one channel are a Bayer mosaic of any order. The mean over each pixel's surroundings that has
    as much red, green and blue everywhere, R + 2 G + B, is its grey.
    """

    dark: float = 0.0
    bright: float = _VALUES - 1.0
    mosaic: bool = False

    def levels(self, image: NDArray[Any]) -> NDArray[np.uint8]:
        """Levels of 8 bits of an image as stored, ``(H, W)`` or ``(H, W, 3)``, uint8 or uint16; of the same shape."""
        stored = cv2.sepFilter2D(image, -1, _CROSS, _CROSS) if self.mosaic else image
        if stored.dtype == np.uint16:
            return _table(self.dark, self.bright)[stored]
        return stored.astype(np.uint8, copy=False)


@lru_cache(maxsize=8)
def _table(dark: float, bright: float) -> NDArray[np.uint8]:
    """Grey level of each value of 16 bits."""
    levels = (np.arange(_VALUES) - dark) * (255.0 / (bright - dark))
    return np.clip(np.rint(levels), 0, 255).astype(np.uint8)


def choose_range(images: list[NDArray[np.uint16]]) -> tuple[float, float, str]:
    """``dark`` and ``bright`` for images like these, and why in words: the bits that their values need, or the values
    themselves where they fill a small part of these."""
    counts = sum((np.bincount(image.ravel(), minlength=_VALUES) for image in images), np.zeros(_VALUES, dtype=np.int64))
    cumulated = np.cumsum(counts)
    top = _quantile(cumulated, 1.0 - _ABOVE)
    bits = next(bits for bits in _BITS if top < 2**bits)
    low, high = _quantile(cumulated, _TAIL), _quantile(cumulated, 1.0 - _TAIL)
    step = int(np.gcd.reduce(np.diff(np.flatnonzero(counts)), initial=0))
    fine = 0 < step < 2 ** (bits - 8)  # else these are 8 bits in 16, and no finer steps can be shown
    if fine and high - low < _NARROW * 2**bits:
        margin = max(_MARGIN * (high - low), 8.0)
        dark, bright = max(low - margin, 0.0), min(high + margin, _VALUES - 1.0)
        return dark, bright, f"values mostly from {low} to {high}: {dark:.0f} to {bright:.0f} become 0 to 255"
    bright = 2.0**bits - 1.0
    return 0.0, bright, f"values up to {top}, so {bits} bits are used: 0 to {bright:.0f} become 0 to 255"


def _quantile(cumulated: NDArray[np.int64], share: float) -> int:
    """Smallest value that this share of the pixels does not exceed."""
    return int(np.searchsorted(cumulated, np.ceil(share * cumulated[-1])))


def is_mosaic(images: list[NDArray[Any]]) -> bool:
    """Whether images of one channel, uint8 or uint16, are a Bayer mosaic: in each the same two places of a 2x2 block,
    on one diagonal, are alike, and the four differ."""
    means = np.array([[[image[r::2, c::2].mean() for c in (0, 1)] for r in (0, 1)] for image in map(_even, images)])
    if not len(means):
        return False
    contrast = np.ptp(means, axis=(1, 2)) / np.maximum(means.mean(axis=(1, 2)), 1e-9)
    whole = means.mean(axis=0)
    greens = min(abs(whole[0, 0] - whole[1, 1]), abs(whole[0, 1] - whole[1, 0]))
    return bool((contrast > _MOSAIC).all() and greens < _GREENS * np.ptp(whole))


def _even(image: NDArray[Any]) -> NDArray[Any]:
    return image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
