"""Frames without a pose, shared out over agents: each has one reason, wherever the block is cut."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from maslam.descriptors.inference import NetVlad
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.config import OdometryConfig
from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import ImageSizeError
from maslam.frontend.files.trajectory import Trajectory
from maslam.frontend.tracking.pose_log import LostInterval
from maslam.frontend.vocabulary.vocabulary import Vocabulary
from maslam.mas.manifest import LostEntry
from maslam.tools.pipeline.agent_folder import lost_frames, with_images
from maslam.tools.pipeline.tracking import OTHER_SIZE, UNREADABLE, lost_gap, track
from maslam.tools.pipeline.tracking_cache import load_tracked, save_tracked


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
        tracked = SimpleNamespace(
            trajectories=(Trajectory(stamps[:0], np.zeros((0, 4, 4))),), lost=(gap,), other_size=()
        )
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


def test_an_image_of_another_size_is_said_as_such() -> None:
    stamps = np.arange(6, dtype=np.int64) * 100
    read = np.array([True, True, False, False, True, True])
    interval = LostInterval(0, 500, 4, "too dark (4 frames)", "too dark", (("too dark", 4),))
    gap = lost_gap(interval, stamps, read, (3,))
    assert gap.kinds == (("too dark", 2), (UNREADABLE, 1), (OTHER_SIZE, 1), ("too dark", 2))
    assert gap.reason == f"too dark (4 frames); {UNREADABLE} (1 frame); {OTHER_SIZE} (1 frame)"
    placed = np.delete(stamps, 3)  # it lies between frames that have a pose
    tracked = SimpleNamespace(
        trajectories=(Trajectory(placed, np.tile(np.eye(4), (5, 1, 1))),), lost=(), other_size=(3,)
    )
    plan: Any = SimpleNamespace(
        sequence=SimpleNamespace(stamps_ns=stamps), tracked=tracked, share=SimpleNamespace(first=1, last=5)
    )
    (entry,) = lost_frames(plan, placed)
    assert (entry.first_frame, entry.last_frame, entry.kinds) == (2, 2, {OTHER_SIZE: 1})


def test_frames_of_another_size_are_told_apart_and_kept(town_stereo: Path, tmp_path: Path) -> None:
    """Frame 5 is whole but half as wide, frame 8 is damaged."""
    source = tmp_path / "agent"
    shutil.copytree(town_stereo / "agent_00", source)
    images = sorted((source / "image_0").iterdir())
    assert cv2.imwrite(str(images[5]), cv2.imread(str(images[5]))[:, ::2])
    images[8].write_bytes(images[8].read_bytes()[:500])
    [sequence] = open_dataset(source, RigKind.STEREO, strict=False).sequences
    with pytest.raises(ImageSizeError, match=r"000005.png: 160x180 pixels, but this sequence has 320x180"):
        sequence.read(5)
    tracked = track(sequence, OdometryConfig(), Vocabulary.load(None), NetVlad.load(), lambda _: None)
    assert tracked.other_size == (5,) and len(tracked.unreadable) == 2
    save_tracked(tmp_path / "kept.npz", tracked, "x")
    kept = load_tracked(tmp_path / "kept.npz", "x")
    assert kept is not None and kept.other_size == (5,)
