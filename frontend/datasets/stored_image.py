"""Where an image is stored: a file of its own, or inside a recording. Data sets name images of both kinds alike."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import FrontendError
from . import depth_files, images


class StoredImage(ABC):
    """One image inside a recording (a film's frame, a message of a bag).

    It is small and goes to other processes: what it needs to read is opened again there. ``str`` of it names the
    image in messages to people.
    """

    @property
    @abstractmethod
    def file(self) -> Path:
        """The recording."""

    @property
    @abstractmethod
    def name(self) -> str:
        """Name of the image in outputs, from the recording's folder on, with ``/`` as separator; the same at each
        reading."""

    @property
    def stem(self) -> str:
        """The last part of :attr:`name`, as of a file's name without its suffix."""
        return self.name.rpartition("/")[2]

    @abstractmethod
    def read_grey(self) -> NDArray[np.uint8]:
        """``(H, W)`` uint8 grey. :class:`FrontendError` where it is missing or damaged."""

    @abstractmethod
    def read_colour(self) -> NDArray[np.uint8]:
        """``(H, W, 3)`` uint8 BGR, of three equal channels where the image is grey; errors as :meth:`read_grey`'s."""

    @abstractmethod
    def read_depth(self, unit_m: float) -> NDArray[np.float32]:
        """``(H, W)`` float32 metres, ``unit_m`` metres per step where it is stored in steps; 0 = unknown. Errors as
        :meth:`read_grey`'s, and for an image that is no depth."""

    def read_numbers(self) -> NDArray[Any] | None:
        """The image's own numbers where it may have more than 8 bits of them, else None; errors as
        :meth:`read_grey`'s."""
        return None


ImageRef = Path | StoredImage
"""An image of a sequence: a file, or a part of a recording."""


def read_grey(image: ImageRef) -> NDArray[np.uint8]:
    """``(H, W)`` uint8; :class:`FrontendError` where it cannot be read."""
    return image.read_grey() if isinstance(image, StoredImage) else images.read_grey(image)


def read_colour(image: ImageRef) -> NDArray[np.uint8]:
    """``(H, W, 3)`` uint8 BGR; errors as :func:`read_grey`'s."""
    return image.read_colour() if isinstance(image, StoredImage) else images.read_colour(image)


def read_depth(image: ImageRef, unit_m: float) -> NDArray[np.float32]:
    """``(H, W)`` float32 metres; errors as :func:`read_grey`'s."""
    return image.read_depth(unit_m) if isinstance(image, StoredImage) else depth_files.read_depth(image, unit_m)


def file_of(image: ImageRef) -> Path:
    """The file that holds the image."""
    return image.file if isinstance(image, StoredImage) else image


def folder_of(image: ImageRef) -> Path:
    """The folder of image files, or the recording: where images are, for messages."""
    return image.file if isinstance(image, StoredImage) else image.parent


def identities(stored: Iterable[ImageRef]) -> Iterator[str]:
    """Of each image its name with size, times of change and place on the disk of its file: all of them stay while the
    pixels do. A time of last writing can be set to what it was; that of the change cannot."""
    known: dict[Path, str] = {}
    for image in stored:
        file = file_of(image)
        if file not in known:
            status = file.stat() if file.exists() else None
            known[file] = f"{status and (status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)}"
        yield f"{image if isinstance(image, Path) else f'{file} {image.name}'} {known[file]}"


def name_in(image: ImageRef, root: Path) -> str:
    """Name of the image as other programs are given it: from the data set's folder ``root`` on."""
    if isinstance(image, StoredImage):
        file = image.file
        above = file.parent.relative_to(root).as_posix() + "/" if file.parent.is_relative_to(root) else ""
        return above.removeprefix("./") + image.name
    return image.relative_to(root).as_posix() if image.is_relative_to(root) else image.name


def first_size(stored: Sequence[ImageRef]) -> tuple[int, int]:
    """Width and height in pixels of the first image that can be decoded; the first one's error where none can."""
    files = [image for image in stored if isinstance(image, Path)]
    if len(files) == len(stored):
        return images.first_size(files)
    errors = []
    for image in stored:
        try:
            height, width = read_grey(image).shape
        except FrontendError as error:
            errors.append(error)
        else:
            return width, height
    raise errors[0]
