"""When each image of a folder was taken: by a list, by the names, or by a rate; and the images in that order."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.pose_arrays import ARRAY_SUFFIXES
from ..files.timestamps import NS_PER_S
from .base import Problems
from .listed_times import ListedTimes, read_listed_times
from .named_times import times_of_names
from .numbering import MissingImages, missing_images, numbered_steps, numbers_of

_LISTS = ("times", "timestamps", "timestamp", "time")
_SUFFIXES = (".txt", ".csv")
_DEFAULT_RATE_HZ = 10.0
_HOLE = 1.5  # usual intervals: a hole in numbers is one in time as well, or nothing is missing


@dataclass(frozen=True)
class TimedImages:
    """``files`` and their ``stamps_ns`` ``(N,)``, in order of time where the names are times; ``source`` of these, for
    messages. ``measured``: the camera's own times, by which images of two cameras can be paired; False for a rate.
    ``missing``: images that the names' numbers lack."""

    files: tuple[Path, ...]
    stamps_ns: NDArray[np.int64]
    source: Path
    measured: bool = True
    missing: tuple[MissingImages, ...] = ()


def timed_images(folder: Path, files: Sequence[Path], rate_hz: float | None, problems: Problems) -> TimedImages:
    """The images ``files`` of one camera of the sequence in ``folder``, with their times; ``rate_hz``: of the
    calibration, None where it has none. What was assumed or left out is added to ``problems``."""
    known = known_times(folder, files, problems)
    if known is not None:
        return known
    if rate_hz is None or rate_hz <= 0:
        rate_hz = _DEFAULT_RATE_HZ
        problems.warning(
            f"{folder}: no times.txt, no times in the file names, no rate in the calibration: {rate_hz:.0f} Hz taken"
        )
    stems = [path.stem for path in files]
    numbers, step = numbered_steps(stems)
    ticks = (numbers - numbers[0]) // step if step else np.arange(len(files))
    stamps = np.rint(ticks * (NS_PER_S / rate_hz)).astype(np.int64)
    return TimedImages(tuple(files), stamps, folder, False, missing_images(stems))


def known_times(folder: Path, files: Sequence[Path], problems: Problems) -> TimedImages | None:
    """The images with times of their own, by a list in their folder or in ``folder``, or by their names; else None."""
    path = find_list(files[0].parent, folder)
    if path is not None and path.suffix in ARRAY_SUFFIXES:
        known = _by_array(files, path, problems)
        if known is not None:
            return known
    elif path is not None:
        listed = read_listed_times(path)
        if listed.doubt:
            problems.warning(f"{path}: {listed.doubt}")
        return by_list(files, listed, path, problems)
    named = times_of_names([path.stem for path in files])
    if named is None:
        return None
    if named.doubt:
        problems.warning(f"{files[0].parent}: {named.doubt}")
    order = np.argsort(named.stamps_ns, kind="stable")
    return TimedImages(tuple(files[i] for i in order), named.stamps_ns[order], files[0].parent)


def find_list(inside: Path, folder: Path) -> Path | None:
    """The list of times of the images in ``inside``, which lies there, or in ``folder`` under a usual name."""
    named = [f"{inside.name}_{name}" for name in _LISTS] if inside != folder else []
    places = [(inside, name) for name in (*_LISTS, "data")] + [(folder, name) for name in (*named, *_LISTS)]
    named_so = [at / f"{name}{end}" for ends in (_SUFFIXES, ARRAY_SUFFIXES) for at, name in places for end in ends]
    return next((path for path in named_so if path.is_file()), None)


def _by_array(files: Sequence[Path], path: Path, problems: Problems) -> TimedImages | None:
    """As :func:`by_list`; JSON or an array of something else, which is said, is no list of times."""
    try:
        listed = read_listed_times(path)
        timed = by_list(files, listed, path, problems)
    except FrontendError as error:
        problems.warning(f"{error}: not read as times")
        return None
    if listed.doubt:
        problems.warning(f"{path}: {listed.doubt}")
    return timed


def by_list(files: Sequence[Path], listed: ListedTimes, path: Path, problems: Problems) -> TimedImages:
    """Images and listed times brought together: by name, in order, or by the number in the name where some images
    were taken out."""
    if listed.names:
        return _by_names(files, listed, path, problems)
    count = len(listed.stamps_ns)
    stems = [one.stem for one in files]
    rows = rows_of_images(count, files)
    if rows is None:
        raise FrontendError(f"{path}: {count} times for {len(files)} images in {files[0].parent}")
    missing = missing_images(stems)
    if count != len(files):
        problems.warning(f"{path}: {count} times for {len(files)} images; taken by the number in the file name")
    stamps = listed.stamps_ns[rows]
    steps = np.diff(stamps)
    usual = float(np.median(steps)) if len(steps) else 0.0
    holes = tuple(one for one in missing if count != len(files) or steps[one.after] > _HOLE * usual)
    return TimedImages(tuple(files), stamps, path, missing=holes)


def rows_of_images(count: int, files: Sequence[Path]) -> NDArray[np.int64] | None:
    """Row of a table with ``count`` rows, one an image, for each of ``files``: in order, or by the numbers in their
    names, from 0 or 1, where some images were taken out; None where neither fits."""
    if count == len(files):
        return np.arange(count)
    stems = [path.stem for path in files]
    numbers = numbers_of(stems)
    if numbers is None or count < len(files):
        return None
    first, last = int(numbers.min()), int(numbers.max())
    if last < count:
        return numbers
    if last == count and first >= 1:
        return numbers - 1
    _, step = numbered_steps(stems)
    return (numbers - first) // step if step and (last - first) // step + 1 == count else None


def _by_names(files: Sequence[Path], listed: ListedTimes, path: Path, problems: Problems) -> TimedImages:
    by_name = {file.name: file for file in files} | {file.stem: file for file in files}
    named = [by_name.get(Path(name).name) for name in listed.names]
    rows = np.array([row for row, file in enumerate(named) if file is not None], dtype=np.int64)
    if not len(rows):
        raise FrontendError(f"{path}: names no image of {files[0].parent} (first: {listed.names[0]!r})")
    if len(rows) < len(named):
        first = listed.names[next(row for row, file in enumerate(named) if file is None)]
        problems.warning(f"{path}: {len(named) - len(rows)} of {len(named)} listed images are not there: first {first}")
    kept = tuple(file for file in named if file is not None)
    unlisted = sorted(set(files) - set(kept))
    if unlisted:
        problems.warning(
            f"{path}: no time for {len(unlisted)} of {len(files)} images, which are left out: first {unlisted[0].name}"
        )
    return TimedImages(kept, listed.stamps_ns[rows], path)
