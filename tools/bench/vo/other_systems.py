"""Trajectories of other systems for ``maslam bench vo --compare``, brought to the clock of a sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.files.pose_table import read_poses
from maslam.frontend.files.timestamps import span_text
from maslam.frontend.files.trajectory import Trajectory

from ...common.errors import ToolError, UsageError
from .accuracy import half_frame_ns


def read_other(path: Path, stamps_ns: NDArray[np.int64]) -> tuple[Trajectory, str]:
    """The trajectory in ``path`` for a sequence with frames at ``stamps_ns``, and what to know about it, or nothing.

    In any form that ``read_poses`` knows. Poses with times go by these, whatever their unit; without, there is one row
    per frame from the first on: rows beyond the last frame are left out. ``ToolError`` or ``FrontendError`` in one line
    for anything else.
    """
    table = read_poses(path)
    if table.stamps_ns is not None:
        trajectory, notes = table.in_time()
        return _in_time(path, trajectory, stamps_ns), "; ".join(f"{path}: {note}" for note in (*table.notes, *notes))
    if table.names:
        raise ToolError(
            f"{path}: poses by names of images ({table.names[0]} …), in any order; times, or a row for each frame, are "
            "compared"
        )
    if table.count < len(stamps_ns):
        raise ToolError(
            f"{path}: {table.count} poses for {len(stamps_ns)} frames: without times, row k is frame k; "
            "a KITTI row with the time in front (13 numbers) or a TUM file may leave frames out"
        )
    used = table.rows < len(stamps_ns)
    note = f"{path}: {table.count} poses for {len(stamps_ns)} frames; the first {len(stamps_ns)} are used"
    notes = (*table.notes, *([note] if table.count > len(stamps_ns) else []))
    return Trajectory(stamps_ns[table.rows[used]], table.poses[used]), "; ".join(notes)


def assign(given: list[str], names: list[str]) -> dict[str, list[Path]]:
    """``[SEQUENCE=]FILE`` words to the sequences ``names``; without a name only where there is one sequence."""
    files: dict[str, list[Path]] = {name: [] for name in names}
    for word in given:
        name, equals, path = word.partition("=")
        if equals and name in files:
            files[name].append(Path(path))
        elif len(names) == 1:
            files[names[0]].append(Path(word))
        else:
            raise UsageError(f"--compare {word}: of which sequence? SEQUENCE=FILE, with one of {', '.join(names)}")
    return files


def _in_time(path: Path, trajectory: Trajectory, stamps_ns: NDArray[np.int64]) -> Trajectory:
    """The trajectory, if it has anything to do with these frames."""
    if (trajectory.nearest(stamps_ns, half_frame_ns(stamps_ns)) < 0).all():
        own, images = span_text(trajectory.stamps_ns), span_text(stamps_ns)
        raise ToolError(f"{path}: no pose within half a frame of any image: its times are {own}, the images' {images}")
    return trajectory
