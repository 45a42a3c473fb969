"""One sequence shared out over several agents, as the predecessor does it (dslam_open; thesis sections 3.3 and 4.1).

Frames are cut in N consecutive blocks of equal length, the last may be shorter; where that leaves none for the last,
the blocks' lengths differ by one. Each block is extended by ``overlap``
key-frames into both neighbours, so that agents can meet there. Every agent gets its own origin (its first key-frame's
camera) and its own map points.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import product, se3_inverse, transform_points
from maslam.frontend.files.point_views import PointViews
from maslam.frontend.files.vo_files import VoTrack

from ..common.errors import UsageError


@dataclass(frozen=True)
class SequenceShare:
    """One agent's share: frames ``first`` to ``last`` (inclusive), and of each track the key-frames
    ``keyframes[track]`` (a slice).
    """

    first: int
    last: int
    keyframes: tuple[slice, ...]


def check_shares(frames: int, agents: int) -> None:
    """Each agent must get a frame at least."""
    if agents < 1:
        raise UsageError(f"--agents {agents}: at least 1 is needed")
    if agents > max(frames, 1):
        raise UsageError(f"--agents {agents}: the sequence has {frames} frames to share out")


def share_out(frames: int, keyframe_indices: list[NDArray[np.int64]], agents: int, overlap: int) -> list[SequenceShare]:
    """Shares of ``agents`` agents; ``keyframe_indices`` holds the ascending frame numbers of each track's key-frames.

    A block in which nothing was tracked gives a share without key-frames.
    """
    check_shares(frames, agents)
    length = -(-frames // agents)
    starts = [agent * length for agent in range(agents)]
    if starts[-1] >= frames:
        starts = [agent * frames // agents for agent in range(agents)]
    every = np.sort(np.concatenate([np.zeros(0, dtype=np.int64), *keyframe_indices]))
    shares = []
    for agent, (first, end) in enumerate(pairwise([*starts, frames])):
        last = end - 1
        lower, upper = int(np.searchsorted(every, first)), int(np.searchsorted(every, last + 1))
        if lower < upper and agent > 0 and overlap:
            first = min(first, int(every[max(lower - overlap, 0)]))
        if lower < upper and agent < agents - 1 and overlap:
            last = max(last, int(every[min(upper + overlap, len(every)) - 1]))
        shares.append(SequenceShare(first, last, tuple(_between(k, first, last) for k in keyframe_indices)))
    return shares


def _between(ascending: NDArray[np.int64], first: int, last: int) -> slice:
    return slice(int(np.searchsorted(ascending, first)), int(np.searchsorted(ascending, last + 1)))


def cut_track(track: VoTrack, keyframes: slice, stamps_s: NDArray[np.float64]) -> VoTrack:
    """The part of ``track`` that one agent made: its key-frames, the points they observe, both numbered anew from 0.

    The origin becomes the camera of the first key-frame kept; ``stamps_s`` are the times of the key-frames kept, on the
    agent's clock.
    """
    lower, upper, _ = keyframes.indices(len(track))
    kept = _between_keyframes(track.observations, lower, upper)
    observed, point = np.unique(track.observations[kept, 1], return_inverse=True)
    T_O_W = se3_inverse(track.poses[lower])
    return VoTrack(
        stamps_s=stamps_s,
        poses=product(T_O_W, track.poses[lower:upper]),
        points=transform_points(T_O_W, track.points[observed]),
        observations=np.column_stack([track.observations[kept, 0] - lower, point]).astype(np.int32),
        descriptors=track.descriptors[kept],
        words=track.words[kept],
    )


def cut_views(views: PointViews, track: VoTrack, keyframes: slice) -> PointViews:
    """The views of ``track`` in the part that :func:`cut_track` makes of it, numbered as there."""
    lower, upper, _ = keyframes.indices(len(track))
    number = np.full(len(track.points), -1)
    observed = np.unique(track.observations[_between_keyframes(track.observations, lower, upper), 1])
    number[observed] = np.arange(len(observed))
    kept = _between_keyframes(views.observations, lower, upper) & (number[views.observations[:, 1]] >= 0)
    keyframe, point = views.observations[kept].T
    return PointViews.sorted(keyframe - lower, number[point], views.uv[kept])


def _between_keyframes(observations: NDArray[np.int32], lower: int, upper: int) -> NDArray[np.bool_]:
    return (observations[:, 0] >= lower) & (observations[:, 0] < upper)
