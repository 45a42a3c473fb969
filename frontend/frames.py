"""One moment of one agent's camera, decoded and rectified: the only form in which images travel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Frame:
    """``image`` ``(H, W)`` uint8 grey; ``right`` likewise (stereo); ``depth_m`` ``(H, W)`` float32 metres along +Z,
    0 = unknown (RGB-D). ``index`` counts the frames of the sequence from 0; ``name`` is the image file, for messages to
    people."""

    index: int
    stamp_ns: int
    image: NDArray[np.uint8]
    right: NDArray[np.uint8] | None = None
    depth_m: NDArray[np.float32] | None = None
    name: str = ""
