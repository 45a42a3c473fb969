"""Frames without a pose, shared out over agents: each has one reason, wherever the block is cut."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.tracking.pose_log import LostInterval
from maslam.mas.sequence import LostEntry
from maslam.tools.pipeline.agent_folder import lost_frames, with_images
from maslam.tools.pipeline.tracking import UNREADABLE, lost_gap


def test_a_part_of_a_lost_interval_counts_its_own_frames() -> None:
    """Ten frames lost, of which one was not readable, shared out over two agents."""
    stamps = np.arange(10, dtype=np.int64) * 100
    read = np.arange(10) != 6
    interval = LostInterval(0, 900, 9, "7 of 80 points (nearest of 5 frames); too dark (4 frames)", "few points", (
        ("too dark", 4), ("few points", 5),
    ))  # fmt: skip
    gap = lost_gap(interval, stamps, read)
    assert gap.kinds == (("too dark", 4), ("few points", 2), (UNREADABLE, 1), ("few points", 3))
    assert gap.reason == f"{interval.reason}; {UNREADABLE} (1 frame)"
    said = []
    for first, last in ((0, 5), (6, 9), (0, 9)):
        tracked = SimpleNamespace(trajectories=(Trajectory(stamps[:0], np.zeros((0, 4, 4))),), lost=(gap,))
        share = SimpleNamespace(first=first, last=last)
        plan: Any = SimpleNamespace(sequence=SimpleNamespace(stamps_ns=stamps), tracked=tracked, share=share)
        (entry,) = lost_frames(plan, stamps[:0])
        assert sum(entry.kinds.values()) == entry.last_frame - entry.first_frame + 1 == last - first + 1
        said.append(entry.reason)
    parts = ["too dark (4 frames); few points (2 frames)", f"few points (3 frames); {UNREADABLE} (1 frame)"]
    assert said == [*parts, gap.reason]


def test_intervals_are_named_by_their_images_where_frames_have_other_numbers() -> None:
    """An image is missing before the interval, or the block begins later; names from 0 on say nothing new."""
    entry = LostEntry(first_frame=2, last_frame=3, reason="dark")
    found = []
    for first, names in ((0, range(6)), (0, (0, 2, 3, 4, 5)), (1, range(6)), (0, "abcdef")):
        left = tuple(Path(f"{name:06d}.png" if isinstance(name, int) else f"{name}.png") for name in names)
        plan: Any = SimpleNamespace(sequence=SimpleNamespace(left=left), share=SimpleNamespace(first=first))
        (named,) = with_images(plan, [entry])
        found.append((named.first_image, named.last_image))
    assert found == [("", ""), ("000003", "000004"), ("000003", "000004"), ("c", "d")]
