"""A key-frame as a live camera's front end passes it on, and its bytes in the journal."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import Any

import numpy as np

from maslam.frontend.files.trajectory import Trajectory

from ..state.keyframe import KeyFrame

_NUMBERS = ("index", "time_ns", "stamp_ns", "recording", "track", "textured")
_ARRAYS = ("T_T_C", "points_C", "descriptors", "words", "point_ids", "first_seen", "vector")


@dataclass(frozen=True, eq=False)
class Observed:
    """``frames``: poses ``T_T_C`` of the frames since the key-frame before, in the track's frame; times from the
    agent's own start, as the key-frame's. The last of a track has those after it as well."""

    keyframe: KeyFrame
    frames: Trajectory


def encode_observed(observed: Observed) -> bytes:
    """As a journal has it: a NumPy archive. Positions (``fixes``) are not in it: a live camera brings none."""
    keyframe = observed.keyframe
    numbers = np.array([int(getattr(keyframe, name)) for name in _NUMBERS], dtype=np.int64)
    arrays: dict[str, Any] = {name: getattr(keyframe, name) for name in _ARRAYS}
    out = io.BytesIO()
    np.savez(
        out,
        allow_pickle=False,
        numbers=numbers,
        depth=np.float64(keyframe.depth),
        frame_times=observed.frames.stamps_ns,
        frame_poses=observed.frames.poses,
        **arrays,
    )
    return out.getvalue()


def decode_observed(data: bytes) -> Observed:
    """The key-frame of :func:`encode_observed`; ``ValueError`` or ``KeyError`` for other bytes."""
    with np.load(io.BytesIO(data), allow_pickle=False) as stored:
        numbers: dict[str, Any] = dict(zip(_NUMBERS, stored["numbers"].tolist(), strict=True))
        numbers["textured"] = bool(numbers["textured"])
        arrays = {name: stored[name] for name in _ARRAYS}
        frames = Trajectory(stored["frame_times"], stored["frame_poses"])
        return Observed(KeyFrame(**numbers, **arrays, depth=float(stored["depth"])), frames)
