"""A key-frame as an agent's sensors give it to the agent: nothing in it knows the truth or another agent."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Array, se3_inverse, transform_points
from maslam.frontend.files.trajectory import stamp_ns_from_s

from ..sequence import STAMP_TOLERANCE_NS, AgentSequence

# Median depth where a key-frame sees no map point at all; only a scale for tolerances.
_DEPTH_WITHOUT_POINTS = 1.0


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """``time_ns``: logical time, from the agent's own start; ``stamp_ns``: the image's in the source; ``recording``: 32
    bits that stand for the name of its recording; ``T_T_C`` ``(4, 4)``: odometry, in the track's frame.

    ``points_C`` ``(n, 3)`` float32 map points in the camera; ``descriptors`` ``(n, 32)`` uint8; ``words`` ``(n,)``
    vocabulary ids at level 4; ``point_ids`` ``(n,)``: numbers of the map points, the same in all key-frames that see
    them; ``first_seen`` ``(n,)`` bool: this key-frame is the first that observes the point;
    ``depth``: median depth, own unit; ``vector`` ``(dim,)`` float32 unit; ``textured``: whether the image has enough
    texture for its vector to mean something.
    """

    index: int
    time_ns: int
    stamp_ns: int
    recording: int
    track: int
    T_T_C: Array
    points_C: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    words: NDArray[np.int32]
    point_ids: NDArray[np.int64]
    first_seen: NDArray[np.bool_]
    depth: float
    vector: NDArray[np.float32]
    textured: bool

    def is_image(self, recording: int, stamp_ns: int) -> bool:
        """Whether it was made from this very image. Two agents of one recording may have been given the same image."""
        return self.recording == recording and abs(self.stamp_ns - stamp_ns) <= STAMP_TOLERANCE_NS


def recording_of(name: str) -> int:
    """What stands for a recording's name in messages: 32 bits of its hash."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=4).digest(), "big")


def keyframes_of(sequence: AgentSequence) -> list[KeyFrame]:
    """The key-frames of all tracks in order, numbered from 0 through all tracks."""
    out: list[KeyFrame] = []
    before = 0  # points of earlier tracks
    recording = recording_of(sequence.source)
    for number, track in enumerate(sequence.tracks):
        order = np.argsort(track.observations[:, 0], kind="stable")
        starts = np.searchsorted(track.observations[order, 0], np.arange(len(track) + 1))
        seen = np.zeros(len(track.points), dtype=bool)
        stamps_ns = stamp_ns_from_s(track.stamps_s)
        for k in range(len(track)):
            rows = order[starts[k] : starts[k + 1]]
            points = track.observations[rows, 1]
            points_C = transform_points(se3_inverse(track.poses[k]), track.points[points])
            depths = points_C[points_C[:, 2] > 0, 2]
            index = len(out)
            out.append(
                KeyFrame(
                    index=index,
                    time_ns=int(stamps_ns[k]),
                    stamp_ns=int(stamps_ns[k]) + sequence.start_ns,
                    recording=recording,
                    track=number,
                    T_T_C=np.asarray(track.poses[k], dtype=np.float64),
                    points_C=points_C.astype(np.float32),
                    descriptors=track.descriptors[rows],
                    words=track.words[rows, 1].astype(np.int32),
                    point_ids=before + points.astype(np.int64),
                    first_seen=~seen[points],
                    depth=float(np.median(depths)) if len(depths) else _DEPTH_WITHOUT_POINTS,
                    vector=np.asarray(sequence.places.vectors[index], dtype=np.float32),
                    textured=bool(sequence.places.textured[index]),
                )
            )
            seen[points] = True
        before += len(track.points)
    return out
