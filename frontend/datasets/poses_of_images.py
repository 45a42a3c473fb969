"""The poses of a table at their times, or those of the images that they are of: in order, by numbers, or by names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.pose_table import PoseTable
from ..files.time_units import NotATime, parse_times
from ..files.timestamps import NS_PER_S
from ..files.trajectory import Trajectory
from .image_times import TimedImages, rows_of_images
from .numbering import numbers_of


@dataclass(frozen=True)
class GivenPoses:
    """``trajectory``: the poses as given; ``form``: what was read, and ``notes``: what to know of it, for people;
    ``timed``: they have times of their own, not those of the images that they are of."""

    trajectory: Trajectory
    form: str
    timed: bool
    notes: tuple[str, ...] = ()


def given_poses(path: Path, table: PoseTable, images: TimedImages) -> GivenPoses:
    """The poses in time. :class:`FrontendError` where it is not known which image's they are."""
    trajectory = _of_numbers(path, table, images)
    if trajectory is not None:
        notes = [note for note in table.notes if note != table.doubt]
        counts = "its first column counts and is no time of the images: taken as their numbers"
        return GivenPoses(trajectory, f"{table.form}, by number", False, (*notes, counts))
    if table.stamps_ns is not None:
        trajectory, more = table.in_time()
        return GivenPoses(trajectory, f"{table.form}, with times", True, (*table.notes, *more))
    if table.names:
        return _of_named(path, table, images)
    rows = rows_of_images(table.count, images.files)
    if rows is None:
        raise FrontendError(
            f"{path}: {table.count} poses without times for {len(images.files)} images: which is whose?"
        )
    notes = list(table.notes)
    if table.count != len(images.files):
        first = images.files[int(np.argmax(rows >= 0))].name
        notes.append(
            f"{table.count} poses for {len(images.files)} images: each image takes that of the number in its name "
            f"({first}: row {int(rows[rows >= 0][0]) + 1})"
        )
    return GivenPoses(_at_images(path, table, rows, images), f"{table.form}, one an image", False, tuple(notes))


def _at_images(path: Path, table: PoseTable, rows: NDArray[np.int64], images: TimedImages) -> Trajectory:
    """Poses of the ``rows`` ``(N,)`` of the file that belong to the images; -1, or a row without a pose: none."""
    place = np.full(table.count, -1)
    place[table.rows] = np.arange(len(table.rows))
    found = np.where(rows >= 0, place[rows], -1)
    known = found >= 0
    return _in_order(path, images.stamps_ns[known], table.poses[found[known]])


def _in_order(path: Path, stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Trajectory:
    if (np.diff(stamps_ns) <= 0).any():
        raise FrontendError(f"{path}: the images' times do not go on, so that their poses have no order")
    return Trajectory(stamps_ns, poses)


def _of_numbers(path: Path, table: PoseTable, images: TimedImages) -> Trajectory | None:
    """Poses whose times count 0, 1, 2 …, or from 1, and as seconds are not the images': they are the numbers of the
    images in order, or in their names. None where they are times, or fit no image."""
    stamps = table.stamps_ns
    if stamps is None or len(stamps) < 2 or stamps[0] not in (0, NS_PER_S):
        return None
    numbers, rest = np.divmod(stamps, NS_PER_S)
    first, last = images.stamps_ns[0] - NS_PER_S, images.stamps_ns[-1] + NS_PER_S
    inside = (stamps >= first) & (stamps <= last)
    if rest.any() or (np.diff(numbers) < 1).any() or np.median(np.diff(numbers)) != 1 or inside.mean() > 0.5:
        return None
    named, count = numbers_of([one.stem for one in images.files]), len(images.files)
    in_order = len(numbers) == count == numbers[-1] - numbers[0] + 1
    if not in_order and named is not None and np.isin(numbers, named).all():
        own = named
    elif in_order or numbers[-1] - numbers[0] < count:
        own = np.arange(count) + numbers[0]
    else:
        return None
    row = {int(number): k for k, number in enumerate(numbers)}
    rows = np.array([row.get(int(number), -1) for number in own])
    known = rows >= 0
    return _in_order(path, images.stamps_ns[known], table.poses[rows[known]]) if known.any() else None


def _of_named(path: Path, table: PoseTable, images: TimedImages) -> GivenPoses:
    """Poses with the images' names, with or without folders and suffixes, or with their numbers or times."""
    rows = _by_name(path, table.names, images.files)
    if (rows < 0).all() and all(map(str.isdecimal, table.names)):
        rows = _by_number([int(name) for name in table.names], images)
    if (rows >= 0).any():
        return GivenPoses(
            _at_images(path, table, rows, images), f"{table.form}, by the images' names", False, table.notes
        )
    timed = _by_time(table, images)
    if timed is None:
        raise FrontendError(f"{path}: names no image here (first: {table.names[0]!r})")
    return GivenPoses(timed, f"{table.form}, by time", True, table.notes)


def _by_name(path: Path, names: Sequence[str], files: Sequence[Path]) -> NDArray[np.int64]:
    """Row of each image: the one whose name ends as the image's path does, the more folders the better; -1. Of names in
    several folders, of cameras or robots, the last folder must be the image's. :class:`FrontendError` where several fit
    equally."""
    least = int(len(folders_of(names)) > 1)
    every: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        last = PurePosixPath(name.replace("\\", "/"))
        for key in {last.name, last.stem}:
            every.setdefault(key, []).append(k)
    rows = np.full(len(files), -1)
    for i, file in enumerate(files):
        fitting = every.get(file.name) or every.get(file.stem, [])
        alike = [_alike(names[k], file) for k in fitting]
        best = [k for k, count in zip(fitting, alike, strict=True) if count == max(alike) >= least]
        if len({names[k] for k in best}) > 1:
            raise FrontendError(f"{path}: {names[best[0]]} and {names[best[1]]} may be {file.parent.name}/{file.name}")
        rows[i] = best[0] if best else -1
    return rows


def folders_of(names: Sequence[str]) -> set[str]:
    """The folders that images are named with."""
    return {str(PurePosixPath(name.replace("\\", "/")).parent) for name in names}


def _alike(name: str, file: Path) -> int:
    """How many folders at the end of a name are those of the image, too."""
    pairs = zip(reversed(PurePosixPath(name.replace("\\", "/")).parts[:-1]), reversed(file.parts[:-1]), strict=False)
    return len(list(takewhile(lambda pair: pair[0] == pair[1], pairs)))


def _by_number(numbers: Sequence[int], images: TimedImages) -> NDArray[np.int64]:
    """Row of each image whose name has its number, or of all in order where as many numbers count from 0 or 1; -1."""
    count = len(images.files)
    row = {number: k for k, number in enumerate(numbers)}
    named = numbers_of([one.stem for one in images.files])
    if named is not None and set(numbers) <= set(named.tolist()):
        return np.array([row.get(number, -1) for number in named.tolist()])
    first = min(numbers)
    if first in (0, 1) and len(row) == count and max(numbers) == first + count - 1:
        return np.array([row[first + k] for k in range(count)])
    return np.full(count, -1)


def _by_time(table: PoseTable, images: TimedImages) -> Trajectory | None:
    """Poses whose names are times, of the images among others; None where they are not."""
    try:
        stamps = parse_times(table.names).stamps_ns[table.rows]
    except NotATime:
        return None
    inside = (stamps >= images.stamps_ns[0] - NS_PER_S) & (stamps <= images.stamps_ns[-1] + NS_PER_S)
    if not inside.any():
        return None
    order = np.argsort(stamps, kind="stable")
    first = np.diff(stamps[order], prepend=stamps[order][:1] - 1) > 0
    return Trajectory(stamps[order][first], table.poses[order][first])
