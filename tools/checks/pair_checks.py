"""Whether the two images of a pair belong together: the same picture twice, one camera above the other, or images of
other moments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence, Problem
    from maslam.frontend.datasets.orb_points import OrbPoints
    from maslam.frontend.frames import Frame

_FEATURES = 600
_MATCH_DISTANCE = 40
_ENOUGH = 40
"""Fewest matches from which anything is concluded."""
_SAME_PX = 0.3
_SAME = 0.9
"""Share of points that keep their place, from which two images are one, saved again perhaps."""
_ROW_PX = 1.2
"""Points of a pair of one moment are on rows so near, after the offset that all have."""
_COLUMN_PX = 1.5
_MOST = 0.6
"""Share of the matches that agree."""
_ALONE = 1.15
"""A partner fits so much better than its neighbours in time, or is looked for farther off."""
_BETTER = 1.25
"""Another partner fits so much better than the one given, in at least so many frames: only then it is said."""
_FRAMES = 2
_FITS = 0.75
"""Share of its points on common rows, from which an image is a partner: by chance fewer are."""
_AS_GOOD = 0.9
"""Where the share of points on common rows is so near to the best partner's, the one given is a pair of its own."""
_NEARER = 0.5
"""A partner of another moment sees points about as far off; in a view that a camera moving sideways had from the same
place they lie where they were."""
_LAGS = 6


@dataclass(frozen=True)
class _Matches:
    """Points of one image ``(n, 2)`` found in the other, pixels."""

    left: NDArray[np.float32]
    right: NDArray[np.float32]

    def on_common_rows(self, share: float = 0.0) -> int:
        """How many lie on common rows, and not right of their place in the left image; 0 where they are a smaller
        ``share``."""
        if len(self.left) < _ENOUGH:
            return 0
        rows = self.right[:, 1] - self.left[:, 1]
        offset = np.median(rows[np.abs(rows) < 10 * _ROW_PX]) if (np.abs(rows) < 10 * _ROW_PX).any() else 0.0
        disparity = self.left[:, 0] - self.right[:, 0]
        good = (np.abs(rows - offset) <= _ROW_PX) & (disparity > -1.0)
        return int(good.sum()) if good.mean() >= share else 0

    def row_share(self) -> float:
        """Share of the points that lie on common rows."""
        return self.on_common_rows() / max(len(self.left), 1)

    def disparity_px(self) -> float:
        """Median, 0 where there are no points."""
        return float(np.median(self.left[:, 0] - self.right[:, 0])) if len(self.left) else 0.0

    def in_one_place(self) -> bool:
        """Whether hardly any point moves."""
        still = (np.abs(self.right - self.left) <= _SAME_PX).all(axis=1)
        return len(still) >= _ENOUGH and bool(still.mean() >= _SAME)

    def one_above_the_other(self) -> bool:
        """Whether points keep their column and change their row, all the same way."""
        if len(self.left) < _ENOUGH:
            return False
        columns, rows = (self.right - self.left).T
        moved = rows[np.abs(columns) <= _COLUMN_PX]
        one_way = max((moved > _COLUMN_PX).sum(), (moved < -_COLUMN_PX).sum())
        return bool(one_way >= _MOST * len(rows))


def pair_problems(sequence: ImageSequence, frames: Sequence[Frame]) -> list[Problem]:
    """What ``frames``, a sample of a stereo sequence, say about its pairs; nothing where they do not tell. Images that
    cannot be read are passed over."""
    from maslam.frontend.datasets import Problem, Severity
    from maslam.frontend.datasets.stored_image import folder_of

    if not sequence.right:
        return []
    where = folder_of(sequence.right[0])
    read = _Points(sequence, frames)
    usable = [frame.index for frame in frames]
    matched = [read.matched(i) for i in usable]
    if matched and _together(matched).in_one_place():
        message = "left and right images are the same pictures: no depth comes from these"
        return [Problem(Severity.ERROR, f"{where}: {message}")]
    if usable and sum(one.one_above_the_other() for one in matched) > len(usable) / 2:
        message = (
            "a point keeps its column and changes its row from left to right: the cameras stand one above the other"
        )
        cure = "pairs like this are not read; turn both images by 90 degrees, and calibrate them so"
        return [Problem(Severity.ERROR, f"{where}: {message}; {cure}")]
    lags = {i: lag for i in usable if (lag := _lag(read, i)) is not None}
    if not usable or sum(lag != 0 for lag in lags.values()) < min(_FRAMES, len(usable)):
        return []
    return [Problem(Severity.ERROR, f"{where}: {_lag_text(sequence, lags)}")]


class _Points:
    """Key-points of a sequence's images and their matches, each found once."""

    def __init__(self, sequence: ImageSequence, frames: Sequence[Frame]) -> None:
        self._sequence = sequence
        self._frames = {frame.index: frame for frame in frames}
        self._left: dict[int, OrbPoints] = {}
        self._right: dict[int, OrbPoints] = {}
        self._matches: dict[tuple[int, int], _Matches] = {}

    def __len__(self) -> int:
        return len(self._sequence)

    def matched(self, i: int, lag: int = 0) -> _Matches:
        """Of the left image of frame ``i``, one of those given, and the right one ``lag`` frames later."""
        from maslam.frontend.datasets.orb_points import find_points, match_points

        if (i, lag) not in self._matches:
            if i not in self._left:
                self._left[i] = find_points(self._frames[i].image, _FEATURES)
            if i + lag not in self._right:
                self._right[i + lag] = find_points(self._right_image(i + lag), _FEATURES)
            found = match_points(self._left[i], self._right[i + lag], _MATCH_DISTANCE)
            self._matches[i, lag] = _Matches(found.left_uv, found.right_uv)
        return self._matches[i, lag]

    def _right_image(self, i: int) -> NDArray[np.uint8] | None:
        from maslam.frontend.errors import FrontendError

        if i in self._frames:
            return self._frames[i].right
        try:
            return self._sequence.read_right(i)
        except FrontendError:
            return None


def _together(matched: Sequence[_Matches]) -> _Matches:
    """Those of several pairs, of each of which too few may be found to conclude anything."""
    return _Matches(np.concatenate([one.left for one in matched]), np.concatenate([one.right for one in matched]))


def _lag(read: _Points, i: int) -> int | None:
    """How many frames later the right image comes that belongs to left image ``i``: 0 for its own; None where no one
    stands out, as of a camera that stands still."""

    def fit(lag: int, share: float = 0.0) -> int:
        return read.matched(i, lag).on_common_rows(share)

    inside = [lag for lag in range(-_LAGS, _LAGS + 1) if 0 <= i + lag < len(read)]
    fits = {lag: fit(lag) for lag in inside if abs(lag) <= 1}
    own = fits[0]
    if {-1, 1} <= set(inside) and own >= _ENOUGH and all(own >= _ALONE * other for lag, other in fits.items() if lag):
        return 0
    fits |= {lag: fit(lag) for lag in inside if abs(lag) > 1}
    best = max(fits, key=lambda lag: (fits[lag], -abs(lag)))
    others = [value for lag, value in fits.items() if lag != best]
    if fits[best] < _ENOUGH or any(fits[best] < _ALONE * value for value in others) or not fit(best, _FITS):
        return None
    if best == 0:
        return 0 if {-1, 1} <= set(inside) else None  # at an end its own partner may be the one that is not there
    given, found = read.matched(i), read.matched(i, best)
    sideways = found.disparity_px() < _NEARER * given.disparity_px()
    if sideways or given.row_share() >= _AS_GOOD * found.row_share():
        return None
    return best if fits[best] >= _BETTER * own else None


def _lag_text(sequence: ImageSequence, lags: dict[int, int]) -> str:
    """The lag that most frames with one show, by an example, and whether others have none."""
    lag, _ = Counter(value for value in lags.values() if value).most_common(1)[0]
    shown = next(i for i, value in lags.items() if value == lag)
    example = f"{sequence.right[shown + lag].name} belongs to {sequence.left[shown].name}"
    frames = f"{abs(lag)} frame{'s' if abs(lag) > 1 else ''}"
    text = f"right images {'lag' if lag > 0 else 'lead'} by {frames}: by its content {example}"
    if all(lags.values()):
        return f"{text}; shift them, or give both cameras' times"
    return f"{text}, but not everywhere: was an image lost on one side?"
