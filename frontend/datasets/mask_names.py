"""Masks whose names are not the images': by the numbers in both, or in order where there are as many."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from .images import list_images
from .numbering import numbers_of
from .stored_image import ImageRef


def masks_by_number_or_order(folder: Path, images: Sequence[ImageRef]) -> tuple[tuple[Path | None, ...], str]:
    """The mask in ``folder`` of each of ``images``, None where there is none, and how they were paired, for people;
    empty where nothing pairs them."""
    none = (None,) * len(images), ""
    files = list_images(folder) if folder.is_dir() else []
    if not files or {image.name for image in images} & {path.name for path in files}:
        return none
    theirs, ours = numbers_of([path.stem for path in files]), numbers_of([Path(image.name).stem for image in images])
    if theirs is not None and ours is not None and len(set(theirs.tolist())) == len(files):
        mask = dict(zip(theirs.tolist(), files, strict=True))
        if set(mask) <= set(ours.tolist()):
            found = tuple(mask.get(number) for number in ours.tolist())
            image, path = next((image, path) for image, path in zip(images, found, strict=True) if path is not None)
            return found, f"paired by their numbers ({path.name} is that of {image.name})"
    if len(files) != len(images):
        return none
    shown = f"{files[0].name} is that of {images[0].name}, {files[-1].name} that of {images[-1].name}"
    return tuple(files), f"as many as images, paired in order ({shown})"
