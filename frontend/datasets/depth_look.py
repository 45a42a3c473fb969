"""Whether pictures of 16 bits are depth, by their content: smooth surfaces between sharp edges and holes, where a
camera's have texture of every size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_WIDTH, _FAR = 320, 40
"""Pictures are thinned out to about this width; over which part of it texture is looked for."""
_SMOOTH, _NOISE = 0.015, 0.04
"""Median bend over that far beyond that of neighbours, and the latter, as a share of the picture's range: measured
on depth, at most 0.013 and 0.036 (a Kinect's, stereo with holes, time of flight with 1 % noise, LiDAR, rendered); on
cameras, thermal ones and night among them, at least 0.02, unless out of focus by 10 px."""
_ROUGH, _LOUD = 0.03, 0.08
"""The same for what may still be depth."""
_HOLES, _JUMPS, _MANY_HOLES = 0.002, 0.001, 0.01
"""Shares of pixels, from which they speak for depth."""
_BESIDE, _SATURATED = 0.3, 0.7
"""Of the median value: what stands beside a hole; what is beside 65535 where that is mere saturation, of itself."""
_JUMP, _CALM = 0.1, 0.1
"""A jump as a share of the picture's range; the steps on both sides of it as a share of the jump."""
_AREA_PX = 9
_LEAST_TOP, _SHIFTED = 256, 16
"""Highest value below which 16 bits hold 8; common step of a camera's bits that were shifted up."""
_UNKNOWN = 65535


class DepthVerdict(StrEnum):
    """What pictures of 16 bits are by their content."""

    CAMERA = "a camera's"
    DOUBT = "in doubt"
    DEPTH = "depth"


@dataclass(frozen=True)
class DepthLook:
    """``verdict``; ``holes``: share of pixels without a value amid others, but for areas that have none in any picture;
    ``near``, ``far``: values between which nine tenths lie."""

    verdict: DepthVerdict
    holes: float = 0.0
    near: int = 0
    far: int = 0

    def text(self) -> str:
        """The grounds, with figures."""
        holes = f"{100 * self.holes:.1f} % of the pixels without a value" if self.holes >= _HOLES else "no noise"
        return f"16 bits, values mostly from {self.near} to {self.far}, smooth surfaces, {holes}"


def look_for_depth(pictures: Sequence[NDArray[Any]]) -> DepthLook:
    """What a sample of pictures of one camera ``(H, W)``, uint16, is."""
    thin = [_thinned(one) for one in pictures if one.dtype == np.uint16 and one.ndim == 2]
    if not thin or max(int(one.max()) for one in thin) < _LEAST_TOP or _step(thin) >= _SHIFTED:
        return DepthLook(DepthVerdict.CAMERA)
    holes = [_holes(one) for one in thin]
    same = len({one.shape for one in thin}) == 1 and len(thin) > 1
    moving = [hole & ~_frame(holes) for hole in holes] if same else holes
    rows = [_measure(*one) for one in zip(thin, holes, moving, strict=True)]
    known = np.array([row for row in rows if row is not None])
    if not len(known):
        return DepthLook(DepthVerdict.CAMERA)
    bend, noise, jumps, share, near, far = np.median(known, axis=0).tolist()
    sharp = share >= _HOLES or jumps >= _JUMPS
    if bend < _SMOOTH and noise < _NOISE:
        verdict = DepthVerdict.DEPTH if sharp else DepthVerdict.DOUBT
    else:
        rough = bend < _ROUGH and noise < _LOUD and share >= _MANY_HOLES
        verdict = DepthVerdict.DOUBT if rough else DepthVerdict.CAMERA
    return DepthLook(verdict, share, round(near), round(far))


def _thinned(picture: NDArray[np.uint16]) -> NDArray[np.uint16]:
    stride = max(1, round(picture.shape[1] / _WIDTH))
    return picture[::stride, ::stride]


def _step(pictures: Sequence[NDArray[np.uint16]]) -> int:
    """What all values are multiples of."""
    values = np.unique(np.concatenate([np.unique(one) for one in pictures]))
    return int(np.gcd.reduce(values[values < _UNKNOWN].astype(np.int64), initial=0))


def _holes(picture: NDArray[np.uint16]) -> NDArray[np.bool_]:
    """Pixels of 0 or 65535 amid other values: where a camera's image is black or saturated, its values rise to that."""
    found = np.zeros(picture.shape, dtype=bool)
    valid = (picture > 0) & (picture < _UNKNOWN)
    if not valid.any():
        return found
    for value in (0, _UNKNOWN):
        hole = picture == value
        beside = picture[(cv2.dilate(hole.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0) & valid]
        if not len(beside):
            continue
        if value == 0:
            sudden = np.percentile(beside, 10) > _BESIDE * np.median(picture[valid])
        else:
            sudden = np.percentile(beside, 90) < _SATURATED * _UNKNOWN
        found |= hole & bool(sudden)
    return found


def _frame(holes: Sequence[NDArray[np.bool_]]) -> NDArray[np.bool_]:
    """Areas without a value in all pictures: what a mask, a lens or rectification leaves dark."""
    always = np.logical_and.reduce(holes).astype(np.uint8)
    return np.asarray(cv2.morphologyEx(always, cv2.MORPH_OPEN, np.ones((_AREA_PX, _AREA_PX), np.uint8)) > 0)


def _measure(
    picture: NDArray[np.uint16], holes: NDArray[np.bool_], moving: NDArray[np.bool_]
) -> tuple[float, float, float, float, float, float] | None:
    """Bend, noise, jumps, ``moving`` holes, and the values between which nine tenths lie; None where all is hole."""
    values = picture[~holes].astype(np.float64)
    if len(values) < _WIDTH:
        return None
    near, far = np.percentile(values, (5, 95)).tolist()
    stored = np.where(holes, np.nan, picture.astype(np.float64))
    # A plane is straight in the inverse of its depth; a picture that is dark for the most part is smooth in one only.
    of_both = [_bend_and_noise(one) for one in (stored, 1.0 / np.maximum(stored, 1.0))]
    bend, noise = (max(one[k] for one in of_both) for k in (0, 1))
    lit = np.where((picture > 0) & (picture < _UNKNOWN), stored, np.nan)
    jumps = float(np.mean([_jumps(one, far - near) for one in (lit, lit.T)]))
    return bend, noise, jumps, float(moving.mean()), near, far


def _bend_and_noise(values: Array) -> tuple[float, float]:
    low, high = np.nanpercentile(values, (5, 95)).tolist()
    if high <= low:
        return 1.0, 1.0
    near, far = (_bend(values, px) / (high - low) for px in (1, max(2, round(values.shape[1] / _FAR))))
    return float(np.sqrt(max(far**2 - near**2, 0.0))), near


def _bend(values: Array, px: int) -> float:
    """Median of the second differences over ``px`` pixels, along rows and columns."""
    bends = [np.abs(a[:, 2 * px :] - 2 * a[:, px:-px] + a[:, : -2 * px]).ravel() for a in (values, values.T)]
    known = np.concatenate([one[np.isfinite(one)] for one in bends])
    return float(np.median(known)) if len(known) else np.inf


def _jumps(values: Array, spread: float) -> float:
    """Share of the pixels at which the values of a row jump, and are calm on both sides."""
    steps = np.abs(np.diff(values, axis=1))
    jump, beside = steps[:, 1:-1], np.maximum(steps[:, :-2], steps[:, 2:])
    return float(((jump > _JUMP * spread) & (beside < _CALM * jump)).mean()) if jump.size else 0.0
