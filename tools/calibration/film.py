"""Frames of a film or of a folder of images, one after the other."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..common.errors import ToolError

Grey = NDArray[np.uint8]


def frames_of(source: Path, stride: int) -> tuple[int, Iterator[tuple[str, Grey]]]:
    """How many frames are looked at, about, and each n-th frame of ``source`` with its name; grey, ``(H, W)``.

    ``ToolError`` for what is neither a folder of images nor a film that OpenCV decodes.
    """
    if source.is_dir():
        return _images(source, stride)
    if not source.is_file():
        raise ToolError(f"{source}: no such file or folder")
    return _film(source, stride)


def _images(source: Path, stride: int) -> tuple[int, Iterator[tuple[str, Grey]]]:
    from maslam.frontend.datasets.images import list_images

    paths = list_images(source)[::stride]
    if not paths:
        raise ToolError(f"{source}: no images in this folder")
    return len(paths), ((path.name, _levels(path)) for path in paths)


def _levels(path: Path) -> Grey:
    """8 bits of an image; of one of 16 bits in its own range: a board is found by its contrast."""
    from maslam.frontend.datasets.images import read_grey
    from maslam.frontend.datasets.pixel_values import PixelValues, choose_range

    stored = read_grey(path)
    dark, bright, _ = choose_range([stored]) if stored.dtype == np.uint16 else (0.0, 255.0, "")
    return PixelValues(dark, bright).levels(stored)


def _film(source: Path, stride: int) -> tuple[int, Iterator[tuple[str, Grey]]]:
    """The only use of OpenCV's film reader."""
    import cv2

    film = cv2.VideoCapture(str(source))
    if not film.isOpened():
        raise ToolError(f"{source}: not a film that can be decoded")
    count = max(int(film.get(cv2.CAP_PROP_FRAME_COUNT)), 0)

    def frames() -> Iterator[tuple[str, Grey]]:
        number = 0
        while film.grab():
            if number % stride == 0:
                decoded, image = film.retrieve()
                if decoded:
                    grey = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
                    yield f"frame {number}", np.asarray(grey, dtype=np.uint8)
            number += 1
        film.release()

    return -(-count // stride), frames()
