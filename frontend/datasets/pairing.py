"""Images of a second camera (right, or depth) brought together with those of the first: by name, time, or number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from ..files.timestamps import span_text
from .base import Problems
from .image_times import TimedImages, find_list, known_times
from .numbering import numbers_of
from .sides import sides_of

_APART = 0.1  # usual intervals: pairs farther apart in time (median) are not of one moment for a camera that moves
_FAR = 0.3  # the same of the farthest pair
_SAME = 0.5  # share of names that both have, from which a name is the partner's


@dataclass(frozen=True)
class Pairs:
    """``kept`` ``(M,)``: rows of the first camera that have a partner; ``second`` ``(M,)``: the partners' rows."""

    kept: NDArray[np.int64]
    second: NDArray[np.int64]


def pair_by_time(first_ns: NDArray[np.int64], second_ns: NDArray[np.int64], tolerance_ns: int) -> Pairs:
    """Images of two cameras, times ``(N,)`` and ``(M,)`` ascending, that are each other's nearest in time, within the
    tolerance: no image is used twice."""
    none = np.zeros(0, dtype=np.int64)
    if not len(first_ns) or not len(second_ns):
        return Pairs(none, none)
    to_second, to_first = _nearest(first_ns, second_ns), _nearest(second_ns, first_ns)
    mutual = to_first[to_second] == np.arange(len(first_ns))
    kept = np.flatnonzero(mutual & (np.abs(second_ns[to_second] - first_ns) <= tolerance_ns))
    return Pairs(kept, to_second[kept])


def half_interval_ns(stamps_ns: NDArray[np.int64]) -> int:
    """Half the usual interval of a camera: what is nearer than this in time belongs to the same image."""
    return int(np.median(np.diff(stamps_ns))) // 2 if len(stamps_ns) > 1 else 0


def paired_in_time(
    first: TimedImages, second: TimedImages, what: str, problems: Problems, tolerance_ns: int | None = None
) -> tuple[TimedImages, tuple[Path, ...]]:
    """The frames that both cameras have, and the second one's files for them; ``what`` the second images are called.

    What is left out on either side is counted in ``problems``, and pairs that are not of one moment.
    :class:`FrontendError` where times go back, or none fits: with both spans.
    """
    for one in (first, second):
        if (np.diff(one.stamps_ns) <= 0).any():
            raise FrontendError(f"{one.source}: time goes back or stands still")
    half_ns = half_interval_ns(first.stamps_ns)
    within_ns = half_ns if tolerance_ns is None else tolerance_ns
    pairs = pair_by_time(first.stamps_ns, second.stamps_ns, within_ns)
    if not len(pairs.kept):
        own, images = (span_text(one.stamps_ns) for one in (second, first))
        raise FrontendError(
            f"{second.source}: no {what} within {within_ns / 1e6:.0f} ms of an image: its times are {own}, "
            f"the images' {images}: on another clock?"
        )
    apart_ns = second.stamps_ns[pairs.second] - first.stamps_ns[pairs.kept]
    _warn_left_out(first, second, what, pairs, apart_ns, problems)
    if tolerance_ns is None:  # a kind of data set with a tolerance of its own is known to be unsynchronised
        _warn_apart(second.source, what, apart_ns, 2 * half_ns, problems)
    kept = TimedImages(
        tuple(first.files[i] for i in pairs.kept), first.stamps_ns[pairs.kept], first.source, first.measured
    )
    return kept, tuple(second.files[i] for i in pairs.second)


def with_partners(
    folder: Path, first: TimedImages, files: Sequence[Path], what: str, problems: Problems
) -> tuple[TimedImages, tuple[Path, ...]]:
    """The frames of ``first`` that have an image of the second camera among ``files``, and those images.

    By name, whatever the suffix; by time where both cameras' images have times of their own and names differ; else, in
    one folder, by the names but for the side, or by the numbers in the names. A partner that is missing by name or
    number is named as the path that it would have.
    :class:`FrontendError` where nothing brings them together.
    """
    by_stem = {path.stem: path for path in files}
    stems = [path.stem for path in first.files]
    common = sum(stem in by_stem for stem in stems)
    if common < len(stems) or len(files) > len(stems):
        second = _own_times(folder, first, files)
        if second is not None:
            return paired_in_time(first, second, what, problems)
    if common >= _SAME * len(stems):
        _warn_unused(files, len(files) - common, what, problems)
        return first, tuple(by_stem.get(path.stem, files[0].parent / path.name) for path in first.files)
    sides = sides_of([*first.files, *files]) if files[0].parent == first.files[0].parent else None
    if sides is not None and len(sides.left.keys() & sides.right.keys()) >= _SAME * len(sides.left):
        _warn_unused(files, len(sides.right.keys() - sides.left.keys()), what, problems)
        folder = files[0].parent
        return first, tuple(sides.right.get(rest, folder / sides.names[rest]) for rest in sides.left)
    numbers, others = numbers_of(stems), numbers_of([path.stem for path in files])
    if numbers is not None and others is not None and len(np.intersect1d(numbers, others)) >= _SAME * len(stems):
        by_number = dict(zip(others.tolist(), files, strict=True))
        _warn_unused(files, len(np.setdiff1d(others, numbers)), what, problems)
        found = (
            by_number.get(n, files[0].parent / path.name) for n, path in zip(numbers.tolist(), first.files, strict=True)
        )
        return first, tuple(found)
    raise FrontendError(
        f"{files[0].parent}: which {what} belongs to which image? names ({files[0].name}, {first.files[0].name}) have "
        "neither times nor numbers in common; give both the same names"
    )


def _own_times(folder: Path, first: TimedImages, files: Sequence[Path]) -> TimedImages | None:
    """The second camera's times where it has some of its own, not the first one's list."""
    if not first.measured or find_list(files[0].parent, folder) == first.source:
        return None
    return known_times(folder, files, Problems())


def _warn_left_out(
    first: TimedImages, second: TimedImages, what: str, pairs: Pairs, apart_ns: NDArray[np.int64], problems: Problems
) -> None:
    frames, others = len(first.files) - len(pairs.kept), len(second.files) - len(pairs.second)
    if frames or others:
        also = f"; no image for {others} of {len(second.files)} {what}s" if others else ""
        problems.warning(
            f"{second.source}: no {what} for {frames} of {len(first.files)} frames{also}; these are left out: "
            f"{len(pairs.kept)} pairs, {abs(float(np.median(apart_ns))) / 1e6:.1f} ms apart (median)"
        )


def _warn_apart(source: Path, what: str, apart_ns: NDArray[np.int64], interval_ns: int, problems: Problems) -> None:
    """Warn of pairs that are not of one moment; ``apart_ns`` the second image's time less the first one's."""
    usual_ns, most_ns = float(np.median(apart_ns)), float(np.abs(apart_ns).max())
    if abs(usual_ns) > _APART * interval_ns or most_ns > _FAR * interval_ns:
        when = "after" if usual_ns > 0 else "before"
        problems.warning(
            f"{source}: not synchronised: a {what} is taken {abs(usual_ns) / 1e6:.1f} ms {when} its image (median; "
            f"at most {most_ns / 1e6:.1f} ms apart): a camera that moves sees another place then"
        )


def _warn_unused(files: Sequence[Path], count: int, what: str, problems: Problems) -> None:
    if count:
        problems.warning(f"{files[0].parent}: {count} of {len(files)} {what}s belong to no image; these are not used")


def _nearest(stamps: NDArray[np.int64], among: NDArray[np.int64]) -> NDArray[np.int64]:
    after = np.clip(np.searchsorted(among, stamps), 0, len(among) - 1)
    before = np.maximum(after - 1, 0)
    return np.where(stamps - among[before] <= among[after] - stamps, before, after)
