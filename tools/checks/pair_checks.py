"""Whether the two images of a pair belong together: the same picture twice, one camera above the other, or images of
other moments."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from maslam.frontend.datasets import ImageSequence, Problem

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
class _Features:
    uv: NDArray[np.float32]
    descriptors: NDArray[np.uint8] | None


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


def pair_problems(sequence: ImageSequence, samples: list[int]) -> list[Problem]:
    """What the images of the frames ``samples`` of a stereo sequence say about their pairs; nothing where they do not
    tell. Images that cannot be read are passed over."""
    from maslam.frontend.datasets import Problem, Severity
    from maslam.frontend.datasets.stored_image import folder_of

    if not sequence.right:
        return []
    where = folder_of(sequence.right[0])
    read = _Images(sequence)
    usable = [i for i in samples if read.left(i) is not None and read.right(i) is not None]
    matched = [_match(read.left_features(i), read.right_features(i)) for i in usable]
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


class _Images:
    """Images of a sequence as decoded and rectified, and their features; each is read once."""

    def __init__(self, sequence: ImageSequence) -> None:
        self._sequence = sequence
        self._read: dict[tuple[bool, int], NDArray[np.uint8] | None] = {}
        self._features: dict[tuple[bool, int], _Features] = {}

    def left(self, i: int) -> NDArray[np.uint8] | None:
        return self._image(False, i, self._sequence.read_image)

    def right(self, i: int) -> NDArray[np.uint8] | None:
        return self._image(True, i, self._sequence.read_right)

    def left_features(self, i: int) -> _Features:
        return self._found(False, i, self.left(i))

    def right_features(self, i: int) -> _Features:
        return self._found(True, i, self.right(i))

    def __len__(self) -> int:
        return len(self._sequence)

    def _image(self, right: bool, i: int, read: Callable[[int], NDArray[np.uint8]]) -> NDArray[np.uint8] | None:
        from maslam.frontend.errors import FrontendError

        if (right, i) not in self._read:
            try:
                self._read[right, i] = read(i)
            except FrontendError:
                self._read[right, i] = None
        return self._read[right, i]

    def _found(self, right: bool, i: int, image: NDArray[np.uint8] | None) -> _Features:
        import cv2

        if (right, i) not in self._features:
            found = _Features(np.zeros((0, 2), np.float32), None)
            if image is not None:
                points, descriptors = cv2.ORB.create(nfeatures=_FEATURES).detectAndCompute(image, None)
                if descriptors is not None:
                    uv = np.array([point.pt for point in points], dtype=np.float32).reshape(-1, 2)
                    found = _Features(uv, np.asarray(descriptors, dtype=np.uint8))
            self._features[right, i] = found
        return self._features[right, i]


def _match(a: _Features, b: _Features) -> _Matches:
    import cv2

    if a.descriptors is None or b.descriptors is None:
        return _Matches(np.zeros((0, 2), np.float32), np.zeros((0, 2), np.float32))
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(a.descriptors, b.descriptors)
    near = [pair for pair in pairs if pair.distance <= _MATCH_DISTANCE]
    return _Matches(a.uv[[pair.queryIdx for pair in near]], b.uv[[pair.trainIdx for pair in near]])


def _together(matched: Sequence[_Matches]) -> _Matches:
    """Those of several pairs, of each of which too few may be found to conclude anything."""
    return _Matches(np.concatenate([one.left for one in matched]), np.concatenate([one.right for one in matched]))


def _lag(read: _Images, i: int) -> int | None:
    """How many frames later the right image comes that belongs to left image ``i``: 0 for its own; None where no one
    stands out, as of a camera that stands still."""

    def matched(lag: int) -> _Matches:
        return _match(read.left_features(i), read.right_features(i + lag))

    def fit(lag: int, share: float = 0.0) -> int:
        return matched(lag).on_common_rows(share)

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
    given, found = matched(0), matched(best)
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
