"""What the tracker follows from a key-frame on, and what comes of it in a frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..image.patch_alignment import Patches, cut_patches
from ..mapping.map import FrameObservations, Ints
from ..reason import NO_REASON, Reason

Array = NDArray[np.float64]


@dataclass(frozen=True)
class TrackedFrame:
    """Result of tracking a frame: ``T_C_W`` ``(4, 4)``, None where tracking failed, and then its ``refusal``.
    ``inliers``: map points that agree with the pose; ``doubt``: why it may be wrong nevertheless."""

    T_C_W: Array | None
    inliers: int
    refusal: Reason = NO_REASON
    doubt: Reason = NO_REASON

    @property
    def reason(self) -> str:
        """Why there is no pose, with figures."""
        return self.refusal.text


@dataclass(frozen=True)
class FollowedPoints:
    """n map points that are followed from the last key-frame.

    ``point`` ``(n,)``: their numbers; ``anchor_uv`` ``(n, 2)``: pixels in the key-frame; ``patches``: what they look
    like there; ``uv`` ``(n, 2)``: pixels where each was last found; ``found`` ``(n,)``: in the last frame; ``agreed``
    ``(n,)``: number of poses since that each agreed with.
    """

    point: Ints
    anchor_uv: Array
    patches: Patches
    uv: Array
    found: NDArray[np.bool_]
    agreed: Ints

    @classmethod
    def at_keyframe(cls, seen: FrameObservations, image: list[NDArray[np.uint8]]) -> FollowedPoints:
        """Begin with ``seen`` in the key-frame's ``image`` and its halvings."""
        n = len(seen.point)
        found, agreed = np.ones(n, dtype=bool), np.zeros(n, dtype=np.int64)
        return cls(seen.point, seen.uv, cut_patches(image, seen.uv), seen.uv, found, agreed)

    def take(self, rows: NDArray[np.bool_]) -> FollowedPoints:
        """The points of ``rows``, a mask."""
        at, uv, found, agreed = self.anchor_uv[rows], self.uv[rows], self.found[rows], self.agreed[rows]
        return FollowedPoints(self.point[rows], at, self.patches.take(rows), uv, found, agreed)

    @property
    def seen(self) -> FrameObservations:
        """Those found in the last frame."""
        return FrameObservations(self.point[self.found], self.uv[self.found])
