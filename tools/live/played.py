"""A recording that a live agent was played, as a sequence: what it saw of it, and ground truth for the evaluation."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.files.trajectory import Trajectory
from maslam.mas.live.credentials import name_of_agent
from maslam.mas.live.live_sequence import observed_in, sequence_of
from maslam.mas.manifest import LostEntry
from maslam.mas.sequence import AgentSequence

from ..pipeline.descriptor_entry import descriptor_entry

if TYPE_CHECKING:
    from maslam.descriptors.base import PlaceDescriptor
    from maslam.frontend.datasets.base import ImageSequence

_NO_POSE = "no pose: dropped, as the next came too soon, or not tracked"


def played_sequence(me: int, images: ImageSequence, journal: Path, model: PlaceDescriptor) -> AgentSequence:
    """Agent ``me``'s sequence by its journal, with all frames of its recording counted."""
    observed = observed_in(journal) if journal.exists() else []
    made = sequence_of(observed, name_of_agent(me), images.name, images.rig.metric, descriptor_entry(model))
    start_ns = made.start_ns if observed else int(images.stamps_ns[0])
    truth = images.groundtruth
    return replace(
        made,
        start_ns=start_ns,
        groundtruth=None if truth is None else Trajectory(truth.stamps_ns - start_ns, truth.poses),
        frames=len(images),
        lost=lost_between(images.stamps_ns, made.trajectory.stamps_ns + start_ns),
    )


def lost_between(stamps_ns: NDArray[np.int64], placed_ns: NDArray[np.int64]) -> tuple[LostEntry, ...]:
    """Intervals of frames that have no pose."""
    without = np.flatnonzero(~np.isin(stamps_ns, placed_ns)).tolist()
    entries = []
    for _, numbered in groupby(enumerate(without), key=lambda pair: pair[1] - pair[0]):
        frames = [frame for _, frame in numbered]
        entries.append(LostEntry(first_frame=frames[0], last_frame=frames[-1], reason=_NO_POSE))
    return tuple(entries)
