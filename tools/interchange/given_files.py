"""Which file holds the trajectory of which sequence, and reading it in any form that ground truth has."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..common.errors import ToolError

if TYPE_CHECKING:
    from maslam.frontend.datasets.base import ImageSequence
    from maslam.frontend.datasets.poses_of_images import GivenPoses
    from maslam.frontend.files.pose_table import PoseTable

TRANSFORMS = "transforms.json"
BAGS = (".bag", ".mcap", ".db3")
_FILES = (".txt", ".tum", ".csv", ".kitti", ".npy", *BAGS)
_OFTEN_OTHERS = (".json", ".npz")  # taken where there are no others


def read_given(file: Path, sequence: ImageSequence, times: Path | None, topic: str | None) -> GivenPoses:
    """The trajectory in a text file, an array, JSON, a model of COLMAP or a bag; ``times`` of poses without their own,
    ``topic`` in a bag. :class:`FrontendError` or :class:`ToolError` for what is none, or of other images."""
    if file.suffix in BAGS or (file.is_dir() and (file / "metadata.yaml").is_file()):
        from .given_bag import read_given_bag

        return read_given_bag(file, topic)
    from maslam.frontend.datasets.image_times import TimedImages
    from maslam.frontend.datasets.poses_of_images import given_poses
    from maslam.frontend.files.pose_table import read_poses

    table = read_poses(file)
    images = TimedImages(tuple(Path(str(one)) for one in sequence.left), sequence.stamps_ns, file)
    if times is not None:
        table, images = _at_times(file, table, times), images
    return given_poses(file, table, images)


def _at_times(file: Path, table: PoseTable, times: Path) -> PoseTable:
    """Poses without times with those of a list, one a row."""
    from maslam.frontend.datasets.listed_times import read_listed_times

    if table.stamps_ns is not None:
        raise ToolError(f"{file}: has times of its own; leave out {times}")
    listed = read_listed_times(times)
    if len(listed.stamps_ns) != table.count:
        raise ToolError(f"{times}: {len(listed.stamps_ns)} times for {table.count} poses")
    notes = (*table.notes, *((f"{times.name}: {listed.doubt}",) if listed.doubt else ()))
    return replace(table, stamps_ns=listed.stamps_ns[table.rows], notes=notes, doubt=listed.doubt)


def trajectory_files(poses: Path, names: Sequence[str]) -> dict[str, Path]:
    """The trajectory of each sequence: ``poses`` itself for a single one, else the file in that folder named after it.

    :class:`ToolError` where one has none, or several.
    """
    model = _of_all_images(poses)
    if model is not None and (len(names) == 1 or _in_folders(model)):
        return dict.fromkeys(names, model)
    if poses.is_file() or (poses / "metadata.yaml").is_file():
        if len(names) != 1:
            raise ToolError(
                f"{poses}: one trajectory for {len(names)} sequences ({', '.join(names[:4])}); name a folder with one "
                "for each"
            )
        return {names[0]: poses}
    every = sorted(p for p in poses.rglob("*") if p.is_file())
    found = [p for p in every if p.suffix in _FILES] or [p for p in every if p.suffix in _OFTEN_OTHERS]
    found = [p for p in found if not (p.parent / "metadata.yaml").is_file()]  # parts of bags
    found += sorted(p.parent for p in poses.rglob("metadata.yaml"))
    if len(names) == 1 and len(found) == 1:
        return {names[0]: found[0]}
    return {name: _file_of(poses, name, found) for name in names}


def _of_all_images(poses: Path) -> Path | None:
    """COLMAP's model or ``transforms.json`` at or in ``poses``, whose poses go by the names of the images."""
    from maslam.frontend.files.colmap_poses import find_colmap_images, is_colmap_images

    if poses.is_dir():
        listed = poses / TRANSFORMS
        return find_colmap_images(poses) or (listed if listed.is_file() else None)
    return poses if is_colmap_images(poses) or poses.name == TRANSFORMS else None


def _in_folders(model: Path) -> bool:
    """Whether the names tell the images of several sequences apart."""
    from maslam.frontend.datasets.poses_of_images import folders_of
    from maslam.frontend.errors import FrontendError
    from maslam.frontend.files.pose_table import read_poses

    try:
        return len(folders_of(read_poses(model).names)) > 1
    except FrontendError as error:
        raise ToolError(str(error)) from error


def _file_of(poses: Path, name: str, found: Sequence[Path]) -> Path:
    word = re.compile(rf"(?<![0-9a-zA-Z]){re.escape(name)}(?![0-9a-zA-Z])")
    exact = [p for p in found if p.stem == name]
    hits = exact or [p for p in found if word.search(p.relative_to(poses).as_posix())]
    if len(hits) == 1:
        return hits[0]
    if hits:
        raise ToolError(f"{poses}: several trajectories for {name}: {', '.join(p.name for p in hits[:4])}; leave one")
    raise ToolError(f"{poses}: no trajectory for {name}; name it {name}.txt")
