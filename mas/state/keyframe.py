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
# Longest time between two frames over which an antenna's way is a straight line.
_FIX_SPAN_NS = 1_000_000_000


@dataclass(frozen=True, eq=False)
class Fix:
    """A position measured since the key-frame before: ``enu`` ``(3,)`` metres with ``sigma`` ``(3,)``; ``lever``
    ``(3,)``: where the antenna was then, in the key-frame's camera and unit, by odometry."""

    enu: Array
    sigma: Array
    lever: Array


@dataclass(frozen=True, eq=False)
class KeyFrame:
    """``time_ns``: logical time, from the agent's own start; ``stamp_ns``: the image's in the source; ``recording``: 32
    bits that stand for the name of its recording; ``T_T_C`` ``(4, 4)``: odometry, in the track's frame.

    ``points_C`` ``(n, 3)`` float32 map points in the camera; ``descriptors`` ``(n, 32)`` uint8; ``words`` ``(n,)``
    vocabulary ids at level 4; ``point_ids`` ``(n,)``: numbers of the map points, the same in all key-frames that see
    them; ``first_seen`` ``(n,)`` bool: this key-frame is the first that observes the point;
    ``depth``: median depth, own unit; ``vector`` ``(dim,)`` float32 unit; ``textured``: whether the image has enough
    texture for its vector to mean something; ``fixes``: positions that go with it.
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
    fixes: tuple[Fix, ...] = ()

    def is_image(self, recording: int, stamp_ns: int) -> bool:
        """Whether it was made from this very image. Two agents of one recording may have been given the same image."""
        return self.recording == recording and abs(self.stamp_ns - stamp_ns) <= STAMP_TOLERANCE_NS


def recording_of(name: str) -> int:
    """What stands for a recording's name in messages: 32 bits of its hash."""
    return int.from_bytes(hashlib.blake2b(name.encode(), digest_size=4).digest(), "big")


def median_depth(points_C: Array) -> float:
    """Median depth of points ``(n, 3)`` in the camera, own unit; 1 where none lies ahead."""
    depths = points_C[points_C[:, 2] > 0, 2]
    return float(np.median(depths)) if len(depths) else _DEPTH_WITHOUT_POINTS


def fixes_of(sequence: AgentSequence) -> dict[int, list[Fix]]:
    """The fixes that go with each key-frame: the next one of its track, as odometry moved in between. A fix between two
    frames that are far apart, or in no track, goes with none."""
    positions, frames = sequence.positions, sequence.trajectory
    out: dict[int, list[Fix]] = {}
    if positions is None or not len(positions) or not len(frames):
        return out
    keyframes_ns, tracks = sequence.keyframe_stamps_ns, sequence.keyframe_tracks
    poses = np.concatenate([track.poses for track in sequence.tracks])
    frame_track = sequence.track_of(frames.stamps_ns)
    for k, t in enumerate(positions.stamps_ns.tolist()):
        index = int(np.searchsorted(keyframes_ns, t))
        right = int(np.searchsorted(frames.stamps_ns, t))
        left = right if right < len(frames) and frames.stamps_ns[right] == t else right - 1
        if index >= len(keyframes_ns) or left < 0 or right >= len(frames):
            continue
        span = int(frames.stamps_ns[right] - frames.stamps_ns[left])
        if span > _FIX_SPAN_NS or not frame_track[left] == frame_track[right] == tracks[index]:
            continue
        ends = frames.poses[[left, right]]
        antenna = ends[:, :3, :3] @ positions.antenna + ends[:, :3, 3]
        share = (t - int(frames.stamps_ns[left])) / span if span else 0.0
        point = antenna[0] + share * (antenna[1] - antenna[0])
        lever = transform_points(se3_inverse(poses[index]), point[None])[0]
        out.setdefault(index, []).append(Fix(positions.enu[k], positions.sigma[k], lever))
    return out


def keyframes_of(sequence: AgentSequence) -> list[KeyFrame]:
    """The key-frames of all tracks in order, numbered from 0 through all tracks."""
    out: list[KeyFrame] = []
    before = 0  # points of earlier tracks
    recording = recording_of(sequence.source)
    fixes = fixes_of(sequence)
    for number, track in enumerate(sequence.tracks):
        order = np.argsort(track.observations[:, 0], kind="stable")
        starts = np.searchsorted(track.observations[order, 0], np.arange(len(track) + 1))
        seen = np.zeros(len(track.points), dtype=bool)
        stamps_ns = stamp_ns_from_s(track.stamps_s)
        for k in range(len(track)):
            rows = order[starts[k] : starts[k + 1]]
            points = track.observations[rows, 1]
            points_C = transform_points(se3_inverse(track.poses[k]), track.points[points])
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
                    depth=median_depth(points_C),
                    vector=np.asarray(sequence.places.vectors[index], dtype=np.float32),
                    textured=bool(sequence.places.textured[index]),
                    fixes=tuple(fixes.get(index, ())),
                )
            )
            seen[points] = True
        before += len(track.points)
    return out
