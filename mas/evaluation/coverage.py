"""How much of what was read has a place in the end: frames of agents and of the map copies that they hold."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..agent import Agent
from ..sequence import STAMP_TOLERANCE_NS, AgentSequence
from ..state.trajectories import frame_trajectory
from .summary import Coverage, OneFrame

FrameName = tuple[str, int]
"""A frame whoever saw it: its image sequence, and its time stamp in it."""


def coverage_of(agent: Agent, sequence: AgentSequence) -> Coverage:
    """Frames read, tracked, placed and lost of one agent, and how many of its tracks are joined."""
    state = agent.state
    return Coverage(
        sequence=sequence.source,
        read=sequence.read,
        tracked=len(sequence.trajectory),
        placed=len(frame_trajectory(state, sequence)),
        tracks=len(sequence.tracks),
        tracks_placed=sum(piece.frame == state.frame for piece in state.pieces),
        lost=list(sequence.lost),
        doubtful=list(sequence.doubtful),
        missing=list(sequence.missing),
    )


def one_frame(
    groups: Sequence[Sequence[int]], names: Sequence[str], placed: Sequence[int], left_out: Sequence[str]
) -> OneFrame:
    """The largest of ``groups`` of agents, of which those without a ``placed`` frame are in none; ``left_out``:
    sequences without an agent, named as such: agents are numbered anew, and a sequence may be called as one."""
    nowhere = [name for name, frames in zip(names, placed, strict=True) if not frames]
    largest = max((sum(placed[a] > 0 for a in group) for group in groups), default=0)
    return OneFrame(
        agents=largest, of=len(names) + len(left_out), without=[*nowhere, *(f"sequence {name}" for name in left_out)]
    )


def frames_read(sequences: Sequence[AgentSequence]) -> int:
    """Frames that all agents have read, tracked or not; one that several have read counts once."""
    read = {(s.source, index) for s in sequences for index in range(s.first_frame, s.first_frame + s.read)}
    return len(read)


def frame_names(sequence: AgentSequence, stamps_ns: NDArray[np.int64]) -> set[FrameName]:
    """The frames of an agent at these times of its own clock."""
    return {(sequence.source, int(t) + sequence.start_ns) for t in stamps_ns}


def frames_held(sequence: AgentSequence, keyframes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Times ``(n,)``, on the owner's clock, of the frames that a copy with these of its key-frames gives a place: the
    key-frames themselves, and what lies between two neighbours of one track that are both in the copy.

    Only neighbours say where the frames between them are: what leads from one to the next is odometry of that stretch.
    """
    frames, all_stamps = sequence.trajectory.stamps_ns, sequence.keyframe_stamps_ns
    rows = np.unique(keyframes[(keyframes >= 0) & (keyframes < len(all_stamps))]).astype(np.int64)
    tracks, stamps = sequence.keyframe_tracks[rows], all_stamps[rows]
    joined = (np.diff(rows) == 1) & (np.diff(tracks) == 0)
    begins, ends = np.append(stamps[:-1][joined], stamps), np.append(stamps[1:][joined], stamps)
    first = np.searchsorted(frames, begins - STAMP_TOLERANCE_NS, side="left")
    last = np.searchsorted(frames, ends + STAMP_TOLERANCE_NS, side="right")
    held = np.zeros(len(frames), dtype=bool)
    for a, b in zip(first.tolist(), last.tolist(), strict=True):
        held[a:b] = True
    return frames[held]
