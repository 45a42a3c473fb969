"""Whether each image is two pictures side by side, of a stereo camera's left and right one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence, Problem
    from maslam.frontend.frames import Frame

_WIDE = 2.0
"""Width over height from which an image may hold two."""
_ROW_SHARE = 0.03
"""Of the height: rows of one point in two pictures that nobody rectified."""
_ENOUGH, _SHARE = 40, 0.15
"""Matches on about the same rows and to one side, and their share of the points of the left half, in a frame that is
two pictures: halves of one view have none."""
_MOST_APART = 0.35
"""Of a half's width: disparities of a pair."""


def side_by_side_problems(sequence: ImageSequence, frames: Sequence[Frame]) -> list[Problem]:
    """An error where most of ``frames``, a sample of a sequence of single images, are two pictures of one scene."""
    from maslam.frontend.datasets import Problem, Severity
    from maslam.frontend.datasets.checks import SPLIT_CURE
    from maslam.frontend.datasets.stored_image import folder_of

    width, height = sequence.stored_size
    if sequence.right or width < _WIDE * height or width % 2:
        return []
    double = sum(_is_double(frame) for frame in frames)
    if not frames or 2 * double <= len(frames):
        return []
    message = (
        f"{folder_of(sequence.left[0])}: each image of {width}x{height} pixels is two pictures of "
        f"{width // 2}x{height} side by side, of a left and a right camera ({double} of the {len(frames)} looked at): "
        f"{SPLIT_CURE}"
    )
    return [Problem(Severity.ERROR, message)]


def _is_double(frame: Frame) -> bool:
    """Whether points of the left half lie on the same rows of the right half."""
    from maslam.frontend.datasets.pair_check import match_pair

    height, width = frame.image.shape
    half = width // 2
    found = match_pair(np.ascontiguousarray(frame.image[:, :half]), np.ascontiguousarray(frame.image[:, half:]))
    rows = np.abs(found.right_uv[:, 1] - found.left_uv[:, 1]) <= _ROW_SHARE * height
    disparity = found.left_uv[:, 0] - found.right_uv[:, 0]
    pair = rows & (disparity > -2.0) & (disparity < _MOST_APART * half)
    return int(pair.sum()) >= max(_ENOUGH, _SHARE * found.features) and int(pair.sum()) > len(pair) // 2
