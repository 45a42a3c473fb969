"""Whether each image is two pictures of a stereo camera's left and right one, side by side or one above the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from maslam.frontend.datasets import ImageSequence, Problem
    from maslam.frontend.frames import Frame

    Grey = NDArray[np.uint8]

_WIDE = 2.0
"""Width over height from which an image may hold two side by side."""
_HALF_WIDE = (1.0, 4.0)
"""Width over height of pictures that lie one above the other."""
_ROW_SHARE = 0.03
"""Of the height: rows of one point in two pictures that nobody rectified."""
_ENOUGH, _SHARE = 40, 0.15
"""Matches on about the same rows and to one side, and their share of the points of the first half, in a frame that is
two pictures: halves of one view have none."""
_MOST_APART = 0.35
"""Of a half's width: disparities of a pair."""


def side_by_side_problems(sequence: ImageSequence, frames: Sequence[Frame]) -> list[Problem]:
    """An error where most of ``frames``, a sample of a sequence of single images, are two pictures of one scene."""
    from maslam.frontend.datasets import Problem, Severity
    from maslam.frontend.datasets.checks import SPLIT_CURE, STACKED_CURE

    width, height = sequence.stored_size
    if sequence.right or not frames:
        return []
    if width >= _WIDE * height and width % 2 == 0:
        double = sum(_is_pair(*np.hsplit(_even(frame.image), 2)) for frame in frames)
        if 2 * double > len(frames):
            how = f"{width // 2}x{height} side by side, of a left and a right camera"
            return [Problem(Severity.ERROR, _said(sequence, how, double, len(frames), SPLIT_CURE))]
    if _HALF_WIDE[0] <= 2 * width / height <= _HALF_WIDE[1] and height % 2 == 0:
        double = sum(_is_stacked(*np.vsplit(_even(frame.image), 2)) for frame in frames)
        if 2 * double > len(frames):
            how = f"{width}x{height // 2} one above the other, of two cameras"
            return [Problem(Severity.ERROR, _said(sequence, how, double, len(frames), STACKED_CURE))]
    return []


def _said(sequence: ImageSequence, how: str, double: int, count: int, cure: str) -> str:
    from maslam.frontend.datasets.stored_image import folder_of

    width, height = sequence.stored_size
    return (
        f"{folder_of(sequence.left[0])}: each image of {width}x{height} pixels is two pictures of {how} ({double} of "
        f"the {count} looked at): {cure}"
    )


def _even(image: Grey) -> Grey:
    """Without the last row or column where a rectified image has an odd number of them."""
    height, width = image.shape
    return image[: height // 2 * 2, : width // 2 * 2]


def _is_stacked(upper: Grey, lower: Grey) -> bool:
    """Either may be the left camera's picture."""
    return _is_pair(upper, lower) or _is_pair(lower, upper)


def _is_pair(left: Grey, right: Grey) -> bool:
    """Whether points of the left picture lie on the same rows of the right one."""
    from maslam.frontend.datasets.pair_check import match_pair

    height, width = left.shape
    found = match_pair(np.ascontiguousarray(left), np.ascontiguousarray(right))
    rows = np.abs(found.right_uv[:, 1] - found.left_uv[:, 1]) <= _ROW_SHARE * height
    disparity = found.left_uv[:, 0] - found.right_uv[:, 0]
    pair = rows & (disparity > -2.0) & (disparity < _MOST_APART * width)
    return int(pair.sum()) >= max(_ENOUGH, _SHARE * found.features) and int(pair.sum()) > len(pair) // 2
