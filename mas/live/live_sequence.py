"""The sequence of a live agent, made from its journal when its drive is over."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np

from maslam.backend.geometry import transform_points
from maslam.descriptors.container import PlaceVectors
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.files.vo_files import VoTrack

from ..manifest import DescriptorEntry
from ..sequence import AgentSequence
from ..state.keyframe import KeyFrame
from .journal import EntryKind, read_journal
from .observed import Observed, decode_observed


def observed_in(journal: Path) -> list[Observed]:
    """The key-frames of a live agent's journal, in order."""
    return [decode_observed(e.data) for e in read_journal(journal) if e.kind is EntryKind.SEE]


def sequence_of(
    observed: Sequence[Observed], name: str, source: str, metric: bool, descriptor: DescriptorEntry
) -> AgentSequence:
    """What preprocessing would have written of the key-frames and their frames, but for names of images and views."""
    keyframes = [one.keyframe for one in observed]
    tracks = [list(track) for _, track in groupby(keyframes, key=lambda k: k.track)]
    frames = [one.frames for one in observed]
    first = keyframes[0] if keyframes else None
    return AgentSequence(
        name=name,
        tracks=tuple(_track(track) for track in tracks),
        places=PlaceVectors(
            name=descriptor.name,
            sha256=descriptor.sha256,
            dim=descriptor.dim,
            stamps_ns=np.array([k.time_ns for k in keyframes], dtype=np.int64),
            vectors=np.array([k.vector for k in keyframes], dtype=np.float32).reshape(-1, descriptor.dim),
            textured=np.array([k.textured for k in keyframes], dtype=bool),
        ),
        trajectory=Trajectory(
            np.concatenate([np.zeros(0, dtype=np.int64), *(f.stamps_ns for f in frames)]),
            np.concatenate([np.zeros((0, 4, 4)), *(f.poses for f in frames)]),
        ),
        metric=metric,
        start_ns=first.stamp_ns - first.time_ns if first is not None else 0,
        source=source,
    )


def _track(keyframes: Sequence[KeyFrame]) -> VoTrack:
    """Key-frames of one track; each point where the last of them sees it."""
    ids = np.unique(np.concatenate([k.point_ids for k in keyframes]))
    points = np.zeros((len(ids), 3))
    observations = []
    for number, keyframe in enumerate(keyframes):
        rows = np.searchsorted(ids, keyframe.point_ids)
        points[rows] = transform_points(keyframe.T_T_C, keyframe.points_C.astype(np.float64))
        observations.append(np.stack([np.full(len(rows), number), rows], axis=1))
    words = np.concatenate([k.words for k in keyframes])
    return VoTrack(
        stamps_s=np.array([k.time_ns for k in keyframes]) / 1e9,
        poses=np.stack([k.T_T_C for k in keyframes]),
        points=points,
        observations=np.concatenate(observations).astype(np.int32),
        descriptors=np.concatenate([k.descriptors for k in keyframes]),
        words=np.stack([words, words], axis=1),  # agents use level 4 alone, which is all that a key-frame has
    )
