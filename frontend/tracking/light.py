"""A light that goes out for a moment: what was followed before is kept, and followed on when the light is back.

Patches are compared by their correlation, so that some are still found in an image with a twentieth of the light. But
what is cut out there, of a dozen grey levels, is found in no bright image again: a key-frame made there ended the
track.
"""

from __future__ import annotations

from copy import copy

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse

from ..config import PoseConfig
from ..mapping.map import Map, MapKeyFrame
from .darkness import brightness, is_dark
from .tracker import Tracker

_FALL = 0.5
"""Share of the brightness of the latest key-frame below which a dark image shows that the light is out. An evening that
falls slowly never does."""
_ENOUGH = 4
"""Times the fewest points of a pose: with so many of them no key-frame is made as long as the light is out. With fewer
one is: the light may stay away, and images with a tenth of it are followed on by what is cut out of them."""


class AmbientLight:
    """Brightness of the latest key-frame made in the light, and the tracker as it was when the light went out."""

    def __init__(self) -> None:
        self.out = False
        """Whether the light is out in the frame last looked at."""
        self._level = 0
        self._before: Tracker | None = None
        self._keyframe = -1

    def look(self, image: NDArray[np.uint8], tracker: Tracker, latest: MapKeyFrame) -> None:
        """See whether the light is out in the next frame; where it has just gone, keep the ``tracker``."""
        self.out = is_dark(image) and brightness(image) < _FALL * self._level
        if self.out and self._before is None:
            self._before, self._keyframe = copy(tracker), latest.number

    def at_keyframe(self, image: NDArray[np.uint8]) -> None:
        """A key-frame is made of ``image``."""
        if not self.out:
            self._level = brightness(image)
            self.forget()

    def allows_keyframe(self, inliers: int, config: PoseConfig) -> bool:
        """Whether a frame with so many points may become a key-frame: without light only where there is no other way to
        go on."""
        return not self.out or inliers < _ENOUGH * config.min_inliers

    def kept(self, map_: Map) -> Tracker | None:
        """Where the light is back: the tracker as it was before, in the map as it is now."""
        old = self._before
        if self.out or old is None:
            return None
        tracker, anchor_T = copy(old), map_.pose(self._keyframe)
        tracker.T_C_W, tracker.anchor_T = product(product(old.T_C_W, se3_inverse(old.anchor_T)), anchor_T), anchor_T
        tracker.followed = old.followed.take(map_.alive[old.followed.point])
        return tracker

    def forget(self) -> None:
        """The camera is followed in the light again: nothing need be kept."""
        self._before = None
