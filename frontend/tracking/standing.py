"""Whether the camera stands while something moves before it, of which points give the pose away wrongly."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..reason import Reason
from .doubt import PointsFound, stands

Array = NDArray[np.float64]
_ALL_STILL, _STILL_PX = 0.9, 0.3
"""Share of the points that stand still where the camera was seen to stand; how little a pose then moves them that goes
on to stand."""
_AGREE, _AGREE_FIRST, _AGREEING = 0.8, 0.9, 15
"""Share of the points that agree with the pose which stand still since the frame before, where it is that of a camera
that goes on to stand, and, of so many, where it has just come to: a pose by few points wavers."""
_HIDDEN = 0.5
"""Share of the points followed that are found, below which something hides what a standing camera saw."""
_FEWEST, _LEAST_SHARE = 6, 0.04
"""Points, and share of those found, that stand still although the camera's motion would have moved them, and so tell
that a camera that stood a frame ago stands still: it does not leave at once and take none of them along."""
_CLEAR_PX = 2.0
"""How far that motion would have moved them."""
_LEFT_SHARE = 0.5
"""Share of the few points found again that stand still, where nothing else is left of what was followed."""


@dataclass(frozen=True)
class StandingCamera:
    """``stands``: whether the camera stands, as far as known; ``rested``: whether it was seen to, in the frames just
    before; ``held``: its last pose was kept although something moves: that makes no key-frame. ``still`` ``(n,)``: the
    points by which it was held; ``certain``: they tell, however few they are."""

    stands: bool = True
    rested: bool = False
    held: bool = False
    certain: bool = False
    still: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool))

    def after(self, points: PointsFound, away_px: Array, followed: int) -> StandingCamera:
        """By the points of the next frame, of ``followed`` ones, each of which the pose found would have moved by
        ``away_px`` ``(n,)``."""
        telling = points.still & (away_px > _CLEAR_PX)
        certain = self.rested and int(telling.sum()) >= max(_FEWEST, _LEAST_SHARE * len(telling))
        unmoved = self._agree_to_stand(points) or (self.rested and float(np.median(away_px)) < _STILL_PX)
        stands_on = certain or unmoved or stands(points, self.stands)
        hidden = unmoved and len(telling) < _HIDDEN * followed
        held = certain or hidden or (stands_on and points.divided)
        rested = points.still_share >= _ALL_STILL or unmoved or (held and self.rested)
        return StandingCamera(stands_on, rested, held, certain, points.still)

    def _agree_to_stand(self, points: PointsFound) -> bool:
        """Whether the points that agree with the pose stand still, of those that were seen in the frame before."""
        agree = points.still[points.inlier & np.isfinite(points.moved_px)]
        least = 1 if self.rested else _AGREEING
        return len(agree) >= least and float(agree.mean()) >= (_AGREE if self.rested else _AGREE_FIRST)

    def left_alone(self, points: PointsFound) -> StandingCamera | None:
        """Held by the few ``points`` that were found where a pose by them is not possible; None where they do not tell
        that a camera that stood stands still."""
        seen = np.isfinite(points.moved_px)
        count = int(points.still.sum())
        if not self.rested or count < max(_FEWEST, _LEFT_SHARE * int(seen.sum())):
            return None
        return StandingCamera(True, True, True, True, points.still)


def doubt_held(points: PointsFound, followed: int) -> Reason:
    """Why the pose of a camera may be wrong that was held by some of the points ``followed``."""
    count = int(points.still.sum())
    text = f"{count} of {followed} points stand still while something hides or moves the others"
    return Reason("a part of the image stands still", text, followed / max(count, 1))
