"""Trajectories of other systems for ``maslam bench vo --compare``, brought to the clock of a sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.files.text_tables import read_table
from maslam.frontend.files.timestamps import NS_PER_S, stamp_ns_from_s
from maslam.frontend.files.trajectory import Trajectory, read_kitti_poses, read_tum

from ...common.errors import ToolError, UsageError
from .accuracy import half_frame_ns

_TUM, _KITTI, _KITTI_TIMED = 8, 12, 13  # numbers per row


def read_other(path: Path, stamps_ns: NDArray[np.int64]) -> tuple[Trajectory, str]:
    """The trajectory in ``path`` for a sequence with frames at ``stamps_ns``, and what to know about it, or nothing.

    TUM (8 numbers per row) and KITTI with a time (13) go by their times; KITTI without (12) has one row per frame from
    the first on: rows beyond the last frame are left out. ``ToolError`` or ``FrontendError`` in one line for anything
    else.
    """
    values = read_table(path, (_TUM, _KITTI, _KITTI_TIMED), "a pose (TUM, or KITTI without or with a time)")
    if not len(values):
        raise ToolError(f"{path}: no poses in this file")
    if values.shape[1] == _TUM:
        return _in_time(path, read_tum(path), stamps_ns), ""
    times, poses = read_kitti_poses(path)
    if times is not None:
        stamps = stamp_ns_from_s(times)
        for row in np.flatnonzero(np.diff(stamps) <= 0)[:1] + 1:
            raise ToolError(f"{path}: time does not go on at pose {row + 1}: {times[row - 1]} s, then {times[row]} s")
        return _in_time(path, Trajectory(stamps, poses), stamps_ns), ""
    if len(poses) < len(stamps_ns):
        raise ToolError(
            f"{path}: {len(poses)} poses for {len(stamps_ns)} frames: without times, row k is frame k; "
            "a KITTI row with the time in front (13 numbers) or a TUM file may leave frames out"
        )
    note = f"{path}: {len(poses)} poses for {len(stamps_ns)} frames; the first {len(stamps_ns)} are used"
    return Trajectory(stamps_ns, poses[: len(stamps_ns)]), note if len(poses) > len(stamps_ns) else ""


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
        own, images = (f"{s[0] / NS_PER_S:.3f} to {s[-1] / NS_PER_S:.3f} s" for s in (trajectory.stamps_ns, stamps_ns))
        raise ToolError(f"{path}: no pose within half a frame of any image: its times are {own}, the images' {images}")
    return trajectory
