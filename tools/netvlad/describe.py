"""``maslam netvlad describe``: place vectors of every image of a data set or a folder, kept as they are made."""

from __future__ import annotations

import hashlib
import time
import zipfile
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_npz
from maslam.descriptors.container import PlaceVectors
from maslam.descriptors.inference import NetVlad
from maslam.frontend.datasets import ImageSequence, Severity, open_dataset
from maslam.frontend.datasets.images import IMAGE_SUFFIXES, list_images, read_colour, read_grey
from maslam.frontend.datasets.pixel_values import PixelValues
from maslam.frontend.datasets.stored_image import ImageRef, identities
from maslam.frontend.errors import FrontendError

from ..common.errors import ToolError
from ..common.progress import Progress

UNREADABLE_SHARE = 0.1  # more unreadable images than this, and the source is refused
_CHUNK = 8  # images for each thread between two looks at the clock
_KEEP_EVERY_S = 10.0  # how often unfinished work is written


@dataclass(frozen=True)
class DescribeSettings:
    """``threads`` images are decoded and described at a time, each by one; ``batch`` go through the network
    together."""

    threads: int = 1
    batch: int = 1


@dataclass(frozen=True)
class ImageSet:
    """Images to be described: ``files`` N of them, ``stamps_ns`` ``(N,)`` (plain images: their number), ``read(i)`` one
    of them; ``identity`` says what decides their pixels beside the files."""

    name: str
    files: tuple[ImageRef, ...]
    stamps_ns: NDArray[np.int64]
    read: Callable[[int], NDArray[np.uint8]]
    identity: str


@dataclass(frozen=True)
class _Done:
    """The first ``count`` images: vectors and flags of those that could be read, ``rows`` their numbers."""

    count: int
    rows: NDArray[np.int64]
    vectors: NDArray[np.float32]
    textured: NDArray[np.bool_]


def find_images(sources: Sequence[Path], every: int, colour: bool, say: Callable[[str], None]) -> list[ImageSet]:
    """The sequences of a data set (rectified, with their times), else the images of a folder or those named, as they
    are stored, in natural order."""
    if len(sources) > 1 or sources[0].is_file():
        return [_plain("images", tuple(sources), every, colour)]
    (folder,) = sources
    try:
        dataset = open_dataset(folder)
    except FrontendError as error:
        files = list_images(folder)
        if not files:
            raise
        say(f"no data set ({error}): the images are described as they are stored, numbered for time stamps")
        return [_plain(folder.resolve().name, tuple(files), every, colour)]
    if all(sequence.focal_guess for sequence in dataset.sequences) and (files := list_images(folder)):
        say(f"{folder}: no calibration: the images are described as they are stored, numbered for time stamps")
        return [_plain(folder.resolve().name, tuple(files), every, colour)]
    for problem in (p for sequence in dataset.sequences for p in sequence.problems if p.severity is Severity.WARNING):
        say(f"warning: {problem.message}")
    return [_of_sequence(sequence, every, colour) for sequence in dataset.sequences]


def describe_file(images: ImageSet, model: NetVlad, out: Path, settings: DescribeSettings, progress: Progress) -> str:
    """Write ``out``, the container of all vectors; a line that says what is in it.

    What is done so far stands in ``out.unfinished`` and is taken up again as long as images and model are the same.
    Images that cannot be read are left out and reported; ``ToolError`` where they are too many.
    """
    part = out.with_name(out.name + ".unfinished")
    fingerprint, total = _fingerprint(images, model), len(images.files)
    parts = [_load_part(part, fingerprint, model.dim)]
    task, kept_s = progress.start(images.name, total), time.monotonic()
    out.parent.mkdir(parents=True, exist_ok=True)
    try:
        while (count := sum(one.count for one in parts)) < total:
            progress.advance(task, count)
            if time.monotonic() - kept_s >= _KEEP_EVERY_S:
                parts, kept_s = [_joined(parts)], time.monotonic()
                _save_part(part, fingerprint, parts[0])
            parts += _next(images, model, parts, settings, progress.say)
    except BaseException:  # Ctrl-C too: what is done is kept
        _save_part(part, fingerprint, _joined(parts))
        raise
    progress.advance(task, total)
    done = _joined(parts)
    names = tuple(str(images.files[int(i)]) for i in done.rows)
    stamps = images.stamps_ns[done.rows]
    PlaceVectors(model.name, model.sha256, model.dim, stamps, done.vectors, done.textured, names).save(out)
    part.unlink(missing_ok=True)
    flat, missing = int((~done.textured).sum()), total - len(done.rows)
    return (
        f"{out}: {len(done.rows)} images, {model.dim} numbers each by {model.name} ({model.sha256[:12]})"
        + (f", {flat} without texture" if flat else "")
        + (f", {missing} could not be read" if missing else "")
    )


def _next(
    images: ImageSet, model: NetVlad, parts: Sequence[_Done], settings: DescribeSettings, say: Callable[[str], None]
) -> list[_Done]:
    """The images after those of ``parts``, some for each thread."""
    first, total = sum(one.count for one in parts), len(images.files)
    numbers = np.arange(first, min(first + settings.threads * max(_CHUNK, settings.batch), total))
    shares = [share for share in np.array_split(numbers, settings.threads) if len(share)]
    with ThreadPoolExecutor(settings.threads, thread_name_prefix="describe") as pool:
        made = list(pool.map(lambda share: _describe(images, share, model), shares))
    problems = [line for _, lines in made for line in lines]
    for line in problems:
        say(f"warning: {line}")
    seen = first + len(numbers)
    missing = seen - sum(len(one.rows) for one in (*parts, *(one for one, _ in made)))
    if missing > max(1.0, UNREADABLE_SHARE * total):
        raise ToolError(f"{images.name}: {missing} of the first {seen} images cannot be read: {problems[-1]}")
    return [one for one, _ in made]


def _plain(name: str, files: tuple[Path, ...], every: int, colour: bool) -> ImageSet:
    for path in files:
        if path.is_dir() or path.suffix.lower() not in IMAGE_SUFFIXES:
            raise ToolError(f"{path}: not an image file; several sources must be images, one may be a folder")
    kept, read = files[::every], read_colour if colour else read_grey
    stamps = np.arange(len(files), dtype=np.int64)[::every]
    return ImageSet(name, kept, stamps, lambda i: PixelValues().levels(read(kept[i])), "as stored")


def _of_sequence(sequence: ImageSequence, every: int, colour: bool) -> ImageSet:
    def read(i: int) -> NDArray[np.uint8]:
        return sequence.read_colour(i * every) if colour else sequence.read_image(i * every)

    maps = sequence.rectifier.left if sequence.rectifier is not None else ()
    identity = hashlib.sha256(b"".join(m.tobytes() for m in maps)).hexdigest()
    return ImageSet(sequence.name, sequence.left[::every], sequence.stamps_ns[::every], read, identity)


def _describe(images: ImageSet, numbers: NDArray[np.int64], model: NetVlad) -> tuple[_Done, list[str]]:
    rows, pixels, problems = [], [], []
    for i in numbers:
        try:
            pixels.append(images.read(int(i)))
            rows.append(int(i))
        except FrontendError as error:
            problems.append(str(error))
    return _Done(len(numbers), np.array(rows, dtype=np.int64), *model.look(pixels)), problems


def _joined(parts: Sequence[_Done]) -> _Done:
    return _Done(
        sum(one.count for one in parts),
        np.concatenate([one.rows for one in parts]),
        np.concatenate([one.vectors for one in parts]),
        np.concatenate([one.textured for one in parts]),
    )


def _fingerprint(images: ImageSet, model: NetVlad) -> str:
    digest = hashlib.sha256(f"{model.card.model_dump_json()} {images.identity}".encode() + images.stamps_ns.tobytes())
    for identity in identities(images.files):
        digest.update(identity.encode())
    return digest.hexdigest()


def _save_part(path: Path, fingerprint: str, done: _Done) -> None:
    write_npz(path, {"fingerprint": fingerprint, **vars(done)})


def _load_part(path: Path, fingerprint: str, dim: int) -> _Done:
    """Unfinished work on the same images with the same model, or none."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            if str(stored["fingerprint"]) == fingerprint:
                return _Done(int(stored["count"]), stored["rows"], stored["vectors"], stored["textured"])
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
        pass  # none, or damaged: made anew
    empty = np.zeros((0, dim), dtype=np.float32)
    return _Done(0, np.zeros(0, dtype=np.int64), empty, np.zeros(0, dtype=bool))
