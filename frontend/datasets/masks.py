"""Masks: images that say where another image shows what is no scene, such as the robot's own body, sky or people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import FrontendError
from .base import ImageSequence, Problems
from .images import MASK_FILES, list_images
from .mask_files import FrameMasks
from .mask_names import masks_by_number_or_order
from .stored_image import ImageRef

_FOUND = ("masks", "mask", *MASK_FILES)
"""What masks are called where nobody says."""

_SAMPLES = 8
_FEW = 0.4
"""Share of pixels used below which masks may be inverted."""


def with_masks(sequence: ImageSequence, folder: Path, given: Path | None, problems: Problems) -> ImageSequence:
    """``sequence`` with the masks ``given`` (a file or a folder), or found in ``folder`` where it names none itself;
    without any as it is.

    :class:`FrontendError` where those given are not there or belong to no image.
    """
    if given is not None and not given.exists():
        raise FrontendError(f"{given}: no such mask, nor folder of masks")
    source = given or next((p for name in _FOUND if (p := folder / name).is_dir() or p.is_file()), None)
    if source is None or not len(sequence) or (given is None and sequence.masks is not None):
        return sequence
    if source.is_file():
        masks, said = _of_all(sequence, (source,) * len(sequence), ()), f"{source}: masks every image"
    else:
        inside = source / sequence.name if given is not None and (source / sequence.name).is_dir() else source
        left = _of_images(inside, _paths(sequence.left, folder), folder, [inside])
        right = _of_images(inside, _paths(sequence.right, folder), folder, [])
        if not any(left):
            left, how = masks_by_number_or_order(inside, sequence.left)
            if how:
                problems.warning(f"{inside}: masks of other names than the images: {how}")
        if not any(left):
            first = sequence.left[0].name
            where = f"{inside}: no mask of any image; that of {first} would be {first}.png, or {first}"
            if given is not None:
                raise FrontendError(where)
            problems.warning(f"{where}; no masks are used")
            return sequence
        masks = _of_all(sequence, left, right if any(right) else ())
        said = f"{inside}: masks {sum(map(bool, left))} of {len(sequence)} images" + _and_right(right)
        _check_complete(inside, sequence, left, problems)
    used = _used(masks, problems)
    if used is None:
        return sequence
    _say_doubts(str(source), masks, used, problems)
    note = f"{said}; {100 * (1 - used):.1f} % of the pixels give no points; place descriptors see the whole images"
    return replace(sequence, masks=masks, notes=(*sequence.notes, note))


def with_named_masks(
    sequence: ImageSequence, left: tuple[Path | None, ...], source: Path, problems: Problems
) -> ImageSequence:
    """``sequence`` with the masks ``left`` that ``source`` names for its images, None where it names none."""
    if not any(left):
        return sequence
    masks = _of_all(sequence, left, ())
    _check_complete(source, sequence, left, problems)
    used = _used(masks, problems)
    if used is None:
        return replace(sequence, problems=tuple(dict.fromkeys((*sequence.problems, *problems.found))))
    _say_doubts(f"{source}: mask_path", masks, used, problems)
    said = f"{source}: mask_path masks {sum(map(bool, left))} of {len(sequence)} images"
    note = f"{said}; {100 * (1 - used):.1f} % of the pixels give no points; place descriptors see the whole images"
    found = tuple(dict.fromkeys((*sequence.problems, *problems.found)))
    return replace(sequence, masks=masks, notes=(*sequence.notes, note), problems=found)


def _say_doubts(source: str, masks: FrameMasks, used: float, problems: Problems) -> None:
    if used < _FEW:
        problems.warning(f"{source}: {100 * used:.1f} % of the pixels are used: white is used; are the masks inverted?")
    if used == 1.0 and len(set(masks.left)) <= _SAMPLES:  # of many, those that were not looked at may mask something
        problems.warning(f"{source}: nothing is masked: black is, and there is none")


def _of_all(sequence: ImageSequence, left: tuple[Path | None, ...], right: tuple[Path | None, ...]) -> FrameMasks:
    return FrameMasks(left, right, sequence.stored_size, sequence.rectifier)


def _and_right(right: tuple[Path | None, ...]) -> str:
    count = sum(map(bool, right))
    return f" and {count} right ones" if count else ""


def _check_complete(source: Path, sequence: ImageSequence, left: tuple[Path | None, ...], problems: Problems) -> None:
    missing = [image.name for image, mask in zip(sequence.left, left, strict=True) if mask is None]
    if missing:
        problems.warning(
            f"{source}: no mask for {len(missing)} of {len(sequence)} images ({missing[0]} is the first): these are "
            "used whole"
        )


def _used(masks: FrameMasks, problems: Problems) -> float | None:
    """Share of the stored pixels that a sample of masks leaves; None where one cannot be used, which is an error."""
    there = list(dict.fromkeys(path for path in masks.left if path is not None))
    sample = [there[i] for i in sorted({round(k * (len(there) - 1) / (_SAMPLES - 1)) for k in range(_SAMPLES)})]
    try:
        return float(np.mean([masks.stored(path).mean() for path in sample]))
    except FrontendError as error:
        problems.error(str(error))
        return None


def _of_images(
    source: Path, images: Sequence[Path], folder: Path, otherwise: Sequence[Path]
) -> tuple[Path | None, ...]:
    """The mask of each image: in the folder of ``source`` that is named as the image's, else in ``otherwise``; None
    where there is none. Right images have no other: a mask beside would be that of the left image of the same name."""
    listed: dict[Path, dict[str, Path]] = {}
    found: list[Path | None] = []
    for image in images:
        places = [*(source / name for name in _folders_of(image, folder)), *otherwise]
        place = next((p for p in places if p in listed or p.is_dir()), None)
        if place is None:
            found.append(None)
            continue
        if place not in listed:
            files = list_images(place)
            listed[place] = {path.stem: path for path in files} | {path.name: path for path in files}
        names = listed[place]
        mask = names.get(f"{image.name}.png") or names.get(image.name) or names.get(image.stem)
        found.append(mask if mask != image else None)
    return tuple(found)


def _paths(images: Sequence[ImageRef], folder: Path) -> list[Path]:
    """The files; of a recording's images what their names would be as files."""
    return [image if isinstance(image, Path) else folder / image.name for image in images]


def _folders_of(image: Path, folder: Path) -> list[Path]:
    """What a folder of masks may call the folder that the image lies in."""
    parent = image.parent
    if parent == folder:
        return []
    names = [parent.relative_to(folder)] if parent.is_relative_to(folder) else []
    return [*names, Path(parent.name), *([Path(parent.parent.name)] if parent.name == "data" else [])]
