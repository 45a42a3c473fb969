"""RelPose: are two key-frames views of one place, and how do their cameras stand to each other? (thesis section 3.5)"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from backend.config import RelPoseConfig
from backend.errors import BackendError
from backend.geometry import Array, Sim3


@dataclass(frozen=True, eq=False)
class PlaceView:
    """A key-frame's map points as its own camera sees them.

    ``points_C`` ``(n, 3)`` in the camera's frame; ``descriptors`` ``(n, 32)`` uint8 ORB, or None; ``words`` ``(n,)`` vocabulary ids,
    or None (one of both must be there); ``metric`` False: the unit of length is the robot's own (monocular).
    """

    points_C: Array
    descriptors: NDArray[np.uint8] | None = None
    words: NDArray[np.int32] | None = None
    metric: bool = True

    def __post_init__(self) -> None:
        n = len(self.points_C)
        if self.points_C.shape != (n, 3) or not np.isfinite(self.points_C).all():
            raise BackendError(f"a place view needs (n, 3) finite points, got shape {self.points_C.shape}")
        if self.descriptors is None and self.words is None:
            raise BackendError("a place view needs descriptors or words")
        if self.descriptors is not None and (self.descriptors.shape != (n, 32) or self.descriptors.dtype != np.uint8):
            raise BackendError(f"{n} points need ({n}, 32) uint8 descriptors, got {self.descriptors.shape} {self.descriptors.dtype}")
        if self.words is not None and self.words.shape != (n,):
            raise BackendError(f"{n} points need ({n},) words, got shape {self.words.shape}")


@dataclass(frozen=True, eq=False)
class Verdict:
    """Whether the match holds, why, and how the cameras stand.

    ``reason`` is "accepted" or says what was too little and by how much; ``T_M_Q`` maps the query camera to the match camera (scale 1
    when both are metric); ``matches`` tentative, ``inliers`` of the refined pose; ``rmse`` of the inliers' whitened residuals (about 1
    when the noise is as estimated; NaN without a pose); ``information`` ``(6, 6)`` of the pose, translation first.
    ``T_M_Q`` and ``information`` may be there without acceptance, for the record.
    """

    accepted: bool
    reason: str
    T_M_Q: Sim3 | None
    matches: int
    inliers: int
    rmse: float
    information: Array | None

    @property
    def kind(self) -> str:
        """The reason without its figures, to count by: "too few inliers"."""
        return self.reason.partition(":")[0]


def relative_pose(query: PlaceView, match: PlaceView, config: RelPoseConfig, rng: np.random.Generator) -> Verdict:
    """Match, search, refine, judge. Same inputs and the same state of ``rng``: same verdict, bit for bit."""
    raise NotImplementedError
