"""A look into the files of a sequence, once, before any run: how many bits they use, whether they are a colour mosaic,
how they want to be turned, whether they are depth, and which masks they have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from .base import ImageSequence, Problems
from .depth_look import DepthVerdict, look_for_depth
from .image_headers import ImageHeader
from .images import header_of, read_grey
from .masks import with_masks
from .pixel_values import PixelValues, choose_range, is_mosaic
from .reading_config import ReadingConfig
from .stored_image import ImageRef, StoredImage, folder_of
from .unnamed_depth import one_channel_of_16_bits

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
    if config.depth_by_content:
        for side, images in (("images", sequence.left), ("right images", sequence.right)):
            _check_not_depth(side, images, problems)
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


def _check_not_depth(side: str, images: Sequence[ImageRef], problems: Problems) -> None:
    """Depth pictures are tracked as if their shades were a scene's; nobody wants that."""
    if not images:
        return
    files = _sample([image for image in images if isinstance(image, Path)])
    wide = one_channel_of_16_bits(files) if files else _stored(images)
    look = look_for_depth(wide)
    some = f" ({len(wide)} of {len(files)} looked at)" if len(wide) < len(files) else ""
    where = f"{folder_of(images[0])}: the {side}{some}"
    if look.verdict is DepthVerdict.DEPTH:
        problems.error(
            f"{where} are depth pictures by their content ({look.text()}), no camera's: put the colour images beside "
            "them, in folders called rgb and depth, and depth_unit_m (metres a step) into the calibration; "
            "if a camera took them: --images.depth-by-content false"
        )
    if look.verdict is DepthVerdict.DOUBT:
        problems.warning(
            f"{where} may be depth pictures ({look.text()}); they are read as a camera's; depth belongs into a folder "
            "called depth, beside the colour images"
        )


def _stored(images: Sequence[ImageRef]) -> list[NDArray[Any]]:
    """A sample of a recording's images with their own numbers, where these are more than grey levels."""
    chosen = sorted({round(k * (len(images) - 1) / (_SAMPLES - 1)) for k in range(_SAMPLES)})
    found = []
    for i in chosen:
        image = images[i]
        try:
            numbers = image.read_numbers() if isinstance(image, StoredImage) else None
        except FrontendError:
            continue
        if numbers is None or numbers.dtype != np.uint16:
            return []
        found.append(numbers)
    return found


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
