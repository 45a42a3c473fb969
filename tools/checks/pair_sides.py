"""Whether left and right images change places somewhere along a sequence, and in which frames."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence, Problem
    from maslam.frontend.datasets.orb_points import PairMatches
    from maslam.frontend.frames import Frame

_MAX_ROWS, _ROW_PX = 12.0, 2.0
"""Rows apart, pixels, within which points of a pair lie, and around the offset that all have."""
_ASIDE_PX = 1.0
"""A point lies clearly to one side of its place in the left image; far points do not."""
_ENOUGH, _ONE_WAY = 25, 0.8
"""Points, and their share on one side, from which a frame has a side."""
_ALIKE = 2.0
"""Frames before and after an exchange see points about as far off: their disparities differ by less than this factor.
Those of a camera turned against its calibration pass through zero."""
_NEAR = 3
"""Frames between two that have a side, at most, that they still see about the same."""
_BEYOND = 3.0
"""Times that disparities change more there than from each of the two to its other neighbour."""
_RANGES = 3  # that are named
_PERCENTILES = (1.0, 99.0)
"""Grey levels that become black and white."""


@dataclass(frozen=True)
class PairSide:
    """Where a frame's points lie in the right image: ``sign`` 1 left of their place in the left one, as they must, -1
    right of it, 0 where they do not tell. ``disparity_px``: their median."""

    sign: int
    disparity_px: float

    @classmethod
    def of_frame(cls, frame: Frame, matches: PairMatches | None = None) -> PairSide:
        """By ``matches`` of the frame, or else, where these are too few, by those of its images with their contrast
        stretched: fog and dusk have few key-points."""
        from maslam.frontend.datasets.pair_check import match_pair

        if frame.right is None:
            return cls(0, 0.0)
        found = cls.of(matches or match_pair(frame.image, frame.right))
        return found if found.sign else cls.of(match_pair(_stretched(frame.image), _stretched(frame.right)))

    @classmethod
    def of(cls, matches: PairMatches) -> PairSide:
        """By ``matches`` alone: 0 where too few of them lie in one row, or too few clearly to one side."""
        rows = matches.right_uv[:, 1] - matches.left_uv[:, 1]
        near = np.abs(rows) <= _MAX_ROWS
        if not near.any():
            return cls(0, 0.0)
        near &= np.abs(rows - np.median(rows[near])) <= _ROW_PX
        disparity = (matches.left_uv[:, 0] - matches.right_uv[:, 0])[near]
        right_way, wrong_way = int((disparity > _ASIDE_PX).sum()), int((disparity < -_ASIDE_PX).sum())
        most, aside = max(right_way, wrong_way), right_way + wrong_way
        if most < max(_ENOUGH, _ONE_WAY * aside):
            return cls(0, 0.0)
        sign = 1 if right_way > wrong_way else -1
        return cls(sign, float(np.median(disparity)))


class _PairSides:
    """Sides of a sequence's frames, each found once: those given, others when they are asked for."""

    def __init__(self, sequence: ImageSequence, known: Mapping[int, PairSide]) -> None:
        self._sequence, self.known = sequence, dict(known)

    def __contains__(self, i: int) -> bool:
        return 0 <= i < len(self._sequence)

    def __getitem__(self, i: int) -> PairSide:
        from maslam.frontend.errors import FrontendError

        if i not in self.known:
            try:
                self.known[i] = PairSide.of_frame(self._sequence.read(i))
            except FrontendError:
                self.known[i] = PairSide(0, 0.0)
        return self.known[i]


@dataclass(frozen=True)
class _Change:
    """Frames ``before`` and ``after`` an exchange, the nearest that tell; ``certain``: they see about the same."""

    before: int
    after: int
    certain: bool


def side_problems(
    sequence: ImageSequence, frames: Sequence[Frame], matched: Sequence[PairMatches], more: Sequence[int] = ()
) -> list[Problem]:
    """In which frames left and right images have changed places while they have not in others, by points ``matched`` of
    some ``frames``, and of ``more`` ones that are read for it; nothing where all agree."""
    from maslam.frontend.datasets import Problem, Severity
    from maslam.frontend.datasets.stored_image import folder_of

    known = {frame.index: PairSide.of_frame(frame, one) for frame, one in zip(frames, matched, strict=True)}
    sides, looked_at = _PairSides(sequence, known), sorted({*known, *more})
    telling = [i for i in looked_at if sides[i].sign]
    if len({sides[i].sign for i in telling}) < 2:
        return []
    changes = [_change(sides, a, b) for a, b in pairwise(telling) if sides[a].sign != sides[b].sign]
    ranges = _swapped_ranges(sides, changes, len(sequence))
    seen = [i for i, side in sides.known.items() if side.sign < 0]
    shown = ", ".join(_range_text(sequence, a, b) for a, b in ranges[:_RANGES])
    more_text = f" and {len(ranges) - _RANGES} more times" if len(ranges) > _RANGES else ""
    certain = all(change.certain for change in changes)
    what = "are swapped" if certain else "seem to be swapped"
    cure = "exchange the files of these frames, or leave them out"
    if not certain:
        cure += "; or is the right camera turned against its calibration?"
    message = (
        f"{folder_of(sequence.right[0])}: left and right images {what} in frame{'s' if len(seen) > 1 else ''} "
        f"{shown}{more_text} of {len(sequence)}, and not in the others (seen in {len(seen)} of the "
        f"{len(sides.known)} frames looked at): {cure}"
    )
    return [Problem(Severity.ERROR if certain else Severity.WARNING, message)]


def _range_text(sequence: ImageSequence, first: int, last: int) -> str:
    """Numbers and names."""
    if first == last:
        return f"{first} ({sequence.left[first].name})"
    return f"{first} to {last} ({sequence.left[first].name} to {sequence.left[last].name})"


def _change(sides: _PairSides, before: int, after: int) -> _Change:
    """Between two frames of different sides, narrowed down to the nearest ones that tell."""
    sign = sides[before].sign
    while after - before > 1:
        inside = [m for m in _from_the_middle(before, after) if sides[m].sign]
        if not inside:
            break
        before, after = (inside[0], after) if sides[inside[0]].sign == sign else (before, inside[0])
    return _Change(before, after, after - before <= _NEAR and _is_jump(sides, before, after))


def _is_jump(sides: _PairSides, before: int, after: int) -> bool:
    """Whether disparities turn over at once, as large as before."""
    at_px = [sides[i].disparity_px for i in (before, after)]
    far, near = max(map(abs, at_px)), min(map(abs, at_px))
    usual = [
        abs(sides[i].disparity_px - sides[k].disparity_px)
        for i, k in ((before, before - 1), (after, after + 1))
        if k in sides and sides[k].sign == sides[i].sign
    ]
    return far <= _ALIKE * near and abs(at_px[1] - at_px[0]) > _BEYOND * max(usual, default=0.0)


def _from_the_middle(before: int, after: int) -> list[int]:
    """The frame in the middle and a few around it, as long as they lie between."""
    middle = (before + after) // 2
    return [m for m in (middle, middle + 1, middle - 1, middle + 2) if before < m < after]


def _swapped_ranges(sides: _PairSides, changes: Sequence[_Change], count: int) -> list[tuple[int, int]]:
    """First and last frame of each stretch between changes that is swapped."""
    borders = [0, *(change.after for change in changes), count]
    first = sides[changes[0].before].sign
    return [(borders[k], borders[k + 1] - 1) for k in range(len(borders) - 1) if (first if k % 2 == 0 else -first) < 0]


def _stretched(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    import cv2

    dark, bright = np.percentile(image, _PERCENTILES)
    scale = 255.0 / max(float(bright - dark), 1.0)
    smooth = cv2.GaussianBlur(image, (0, 0), 1.0).astype(np.float32)
    return np.clip((smooth - float(dark)) * scale, 0, 255).astype(np.uint8)
