"""A look into the files of a sequence, once, before any run: how many bits they use, whether they are a colour mosaic,
how they want to be turned, and which masks they have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from ..errors import FrontendError
from .base import ImageSequence, Problems
from .image_headers import ImageHeader
from .images import header_of, read_grey
from .masks import with_masks
from .pixel_values import PixelValues, choose_range, is_mosaic
from .reading_config import ReadingConfig

_SAMPLES = 8
"""Images looked into, evenly over the sequence."""
_LOSSLESS = ("PNG", "TIFF", "BMP", "PNM")


def look_into(sequence: ImageSequence, folder: Path, config: ReadingConfig) -> ImageSequence:
    """``sequence`` with what its files say and what ``config`` wants of them; all that is done is in its ``notes``.

    Damaged files are passed over here. :class:`FrontendError` for masks that are asked for and not there.
    """
    problems = Problems()
    files = [[image for image in side if isinstance(image, Path)] for side in (sequence.left, sequence.right)]
    headers = _headers((*_sample(files[0]), *_sample(files[1])))
    values, notes = _values(headers, config)
    turned = sorted({header.orientation for header in headers.values()} - {1})
    if turned:
        first = next(path for path, header in headers.items() if header.orientation != 1)
        problems.warning(
            f"{first}: EXIF wants the picture turned (orientation {', '.join(map(str, turned))}); images are used as "
            "stored, as by COLMAP, and so must the calibration be"
        )
    looked = with_masks(replace(sequence, values=values), folder, config.masks, problems)
    return replace(
        looked,
        notes=(*sequence.notes, *notes, *looked.notes[len(sequence.notes) :]),
        problems=tuple(dict.fromkeys((*sequence.problems, *problems.found))),
    )


def _sample(files: Sequence[Path]) -> list[Path]:
    """Files evenly over the sequence, without those that are not there."""
    count = len(files)
    chosen = sorted({round(k * (count - 1) / (_SAMPLES - 1)) for k in range(_SAMPLES)}) if count else []
    return [files[i] for i in chosen if files[i].is_file()]


def _headers(files: tuple[Path, ...]) -> dict[Path, ImageHeader]:
    """The headers that can be read."""
    found = {}
    for path in files:
        try:
            found[path] = header_of(path)
        except FrontendError:
            continue
    return found


def _values(headers: dict[Path, ImageHeader], config: ReadingConfig) -> tuple[PixelValues, list[str]]:
    """How stored values become grey levels, and that in words."""
    # Coded with loss, no mosaic would be left, and there are no more than 8 bits.
    plain = {path: header for path, header in headers.items() if header.format in _LOSSLESS}
    wide = any(header.bits > 8 for header in plain.values())
    single = bool(plain) and all(header.channels <= 2 for header in plain.values())
    images = _decoded(list(plain)) if wide or (single and config.mosaic == "auto") else []
    mosaic = config.mosaic == "yes" or (config.mosaic == "auto" and single and is_mosaic(images))
    notes = []
    values = PixelValues(mosaic=mosaic)
    deep = [image for image in images if image.dtype == "uint16"]
    if deep:
        dark, bright, why = choose_range(deep)
        values = PixelValues(dark, bright, mosaic)
        notes.append(f"images of 16 bits, {why}, the same in all images")
    if mosaic:
        how = "as set" if config.mosaic == "yes" else "by their content; --images.mosaic no reads them as they are"
        notes.append(f"images are a Bayer mosaic ({how}): each pixel takes the mean of its surroundings, R + 2 G + B")
    return values, notes


def _decoded(files: list[Path]) -> list[NDArray[Any]]:
    images = []
    for path in files:
        try:
            images.append(read_grey(path))
        except FrontendError:
            continue
    return images
