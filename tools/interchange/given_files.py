"""Which file holds the trajectory (or the points) of which sequence, and reading a trajectory of any form."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import ToolError

if TYPE_CHECKING:
    from maslam.frontend.files.other_trajectories import OtherTrajectory

BAGS = (".bag", ".mcap", ".db3")
_FILES = (".txt", ".tum", ".csv", ".kitti", ".npy", *BAGS)


def read_given(file: Path, times: Path | None, topic: str | None) -> OtherTrajectory:
    """The trajectory in a text file, an array or a bag; ``times`` of poses without their own, ``topic`` in a bag."""
    if file.suffix in BAGS or (file.is_dir() and (file / "metadata.yaml").is_file()):
        from .bag_poses import read_bag_poses

        return read_bag_poses(file, topic)
    from maslam.frontend.files.other_trajectories import read_other_trajectory

    return read_other_trajectory(file, times)


def trajectory_files(poses: Path, names: Sequence[str]) -> dict[str, Path]:
    """The trajectory of each sequence: ``poses`` itself for a single one, else the file in that folder named after it.

    :class:`ToolError` where one has none, or several.
    """
    if poses.is_file() or (poses / "metadata.yaml").is_file():
        if len(names) != 1:
            raise ToolError(
                f"{poses}: one trajectory for {len(names)} sequences ({', '.join(names[:4])}); name a folder with one "
                "for each"
            )
        return {names[0]: poses}
    found = sorted(p for p in poses.rglob("*") if p.suffix in _FILES and p.is_file())
    found = [p for p in found if not (p.parent / "metadata.yaml").is_file()]  # parts of bags
    found += sorted(p.parent for p in poses.rglob("metadata.yaml"))
    if len(names) == 1 and len(found) == 1:
        return {names[0]: found[0]}
    return {name: _file_of(poses, name, found) for name in names}


def _file_of(poses: Path, name: str, found: Sequence[Path]) -> Path:
    word = re.compile(rf"(?<![0-9a-zA-Z]){re.escape(name)}(?![0-9a-zA-Z])")
    exact = [p for p in found if p.stem == name]
    hits = exact or [p for p in found if word.search(p.relative_to(poses).as_posix())]
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise ToolError(f"{poses}: several trajectories for {name}: {', '.join(p.name for p in hits[:4])}; leave one")
    raise ToolError(f"{poses}: no trajectory for {name}; name it {name}.txt")
