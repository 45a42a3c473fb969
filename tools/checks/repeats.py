"""Images that are the one before once more, of a camera or a recorder that hung, and empty files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence, Problem
    from maslam.frontend.datasets.pixel_values import PixelValues

_LOOKED_AT = 60
"""Neighbours of one size that are compared, of each camera."""
_EMPTY = 2.0
"""Grey levels of spread, below which an image shows nothing."""
_PART = 4096
"""Bytes in the middle that are compared before the whole."""


def repeat_problems(sequence: ImageSequence) -> list[Problem]:
    """A warning for each camera some of whose images are, byte for byte, the one before, or files of no bytes."""
    from maslam.frontend.datasets import Problem, Severity

    problems = []
    cameras = (("image", sequence.left), ("right image", sequence.right), ("depth image", sequence.depth))
    for what, images in cameras:
        files = [image for image in images if isinstance(image, Path)]  # those of a recording have no bytes to compare
        sizes = np.array([_size(path) for path in files], dtype=np.int64)
        empty = np.flatnonzero(sizes == 0)
        if len(empty):
            count = f"{len(empty)} of {len(files)} {what}s are empty files"
            problems.append(Problem(Severity.WARNING, f"{files[empty[0]]}: {count}; these frames cannot be read"))
        pairs, candidates = _alike_in_size(sizes)
        repeated = [i for i in pairs if _same_bytes(files[i], files[i + 1])]
        if repeated and not (what != "depth image" and _is_empty(sequence.values, files[repeated[0]])):
            of = f"of {len(files)}" if len(pairs) == candidates else f"of {len(pairs)} looked at"
            problems.append(
                Problem(
                    Severity.WARNING,
                    f"{files[repeated[0] + 1]}: the same as the {what} before, byte for byte; {len(repeated)} {of} are "
                    "like this: did the camera hang?",
                )
            )
    return problems


def _alike_in_size(sizes: NDArray[np.int64]) -> tuple[list[int], int]:
    """Numbers of images that have the size in bytes of the next, at most some, spread evenly; how many there are."""
    rows = np.flatnonzero((np.diff(sizes) == 0) & (sizes[:-1] > 0)) if len(sizes) > 1 else np.zeros(0, dtype=np.int64)
    count = len(rows)
    if count > _LOOKED_AT:
        rows = rows[np.linspace(0, count - 1, _LOOKED_AT).astype(np.int64)]
    return rows.tolist(), count


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return -1


def _same_bytes(one: Path, two: Path) -> bool:
    if one == two:
        return False  # named already: one file listed twice
    try:
        if _middle(one) != _middle(two):
            return False
        return one.read_bytes() == two.read_bytes()
    except OSError:
        return False


def _is_empty(values: PixelValues, path: Path) -> bool:
    """Whether the image shows nothing, as in the dark: such images are alike without a fault of time."""
    from maslam.frontend.datasets.images import read_grey
    from maslam.frontend.errors import FrontendError

    try:
        return float(values.levels(read_grey(path)).std()) < _EMPTY
    except FrontendError:
        return True


def _middle(path: Path) -> bytes:
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size // 2 - _PART // 2))
        return file.read(_PART)
