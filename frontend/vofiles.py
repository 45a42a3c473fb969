"""The five VO files of one uninterrupted track: the border between a front end and the rest of the system.

Same layout as the public predecessor (dslam_open, ICRA 2018), so its files are read and ours can be read there; thesis section 3.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class VoTrack:
    """K key-frames, P map points, N observations, in the track's own world frame W.

    ``stamps_s`` ``(K,)`` float64 seconds; ``poses`` ``(K, 4, 4)`` ``T_W_C``; ``points`` ``(P, 3)``; ``observations`` ``(N, 2)`` int32:
    key-frame index, map-point index, sorted; ``descriptors`` ``(N, 32)`` uint8 ORB; ``words`` ``(N, 2)`` int32: DBoW2 node id at
    level 3 and at level 4.
    """

    stamps_s: NDArray[np.float64]
    poses: NDArray[np.float64]
    points: NDArray[np.float64]
    observations: NDArray[np.int32]
    descriptors: NDArray[np.uint8]
    words: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.stamps_s)


def write_track(folder: Path, number: int, track: VoTrack) -> None:
    """Write ``poses_<k>.txt times_<k>.txt lm_pos_<k>.txt lm_obs_<k>.txt descs_<k>.txt``."""
    raise NotImplementedError


def read_tracks(folder: Path) -> list[VoTrack]:
    """All tracks in ``folder``, in order of their numbers; a broken line is an error with file and line."""
    raise NotImplementedError
