"""Which row of a table of poses is which image's: in order, by numbers, or by names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..files.pose_table import PoseTable
from ..files.time_units import NotATime, parse_times
from ..files.timestamps import NS_PER_S
from ..files.trajectory import Trajectory
from .base import Problems
from .image_times import TimedImages, rows_of_images
from .numbering import numbers_of

LEFT_OUT = "ground truth left out, errors cannot be known"


def frame_truth(stamps_ns: NDArray[np.int64], poses: NDArray[np.float64]) -> Trajectory | None:
    """Ground truth from ``poses`` ``(N, 4, 4)`` ``T_W_C``, one per frame, at ``stamps_ns`` ``(N,)``; None where the
    stamps do not ascend, which is listed as a problem of its own."""
    return Trajectory(stamps_ns, poses) if (np.diff(stamps_ns) > 0).all() else None


def truth_of_images(path: Path, table: PoseTable, images: TimedImages, problems: Problems) -> Trajectory | None:
    """Poses without times, one an image."""
    if table.names:
        return _of_named(path, table, images, problems)
    rows = rows_of_images(table.count, images.files)
    if rows is None:
        problems.warning(
            f"{path}: {table.count} poses without times for {len(images.files)} images: which is whose? {LEFT_OUT}"
        )
        return None
    place = np.full(table.count, -1)
    place[table.rows] = np.arange(len(table.rows))
    known = place[rows] >= 0
    return frame_truth(images.stamps_ns[known], table.poses[place[rows][known]])


def truth_of_numbers(table: PoseTable, images: TimedImages) -> Trajectory | None:
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
    return frame_truth(images.stamps_ns[known], table.poses[rows[known]]) if known.any() else None


def _of_named(path: Path, table: PoseTable, images: TimedImages, problems: Problems) -> Trajectory | None:
    """Poses with the images' names, with or without folders and suffixes, or with their numbers or times."""
    row = {Path(name).name: k for k, name in enumerate(table.names)}
    row = {Path(name).stem: k for name, k in row.items()} | row
    rows = np.array([row.get(one.name, row.get(one.stem, -1)) for one in images.files])
    if (rows < 0).all() and all(map(str.isdecimal, table.names)):
        rows = _by_number([int(name) for name in table.names], images)
    place = np.full(table.count, -1)
    place[table.rows] = np.arange(len(table.rows))
    known = rows >= 0
    known[known] = place[rows[known]] >= 0
    if known.any():
        return frame_truth(images.stamps_ns[known], table.poses[place[rows[known]]])
    timed = _by_time(table, images)
    if timed is None:
        problems.warning(f"{path}: names no image here (first: {table.names[0]!r}): {LEFT_OUT}")
    return timed


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
    return frame_truth(stamps[order], table.poses[order])
