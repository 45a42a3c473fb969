"""Place vectors of images by onnxruntime alone: the part that agents run, without torch."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from .base import Images, PlaceDescriptor
from .card import Calibration, ModelCard, read_card
from .errors import DescriptorError
from .session import CPU, ModelSession
from .texture import has_texture

if TYPE_CHECKING:
    from .container import PlaceVectors

log = logging.getLogger(__name__)
MIN_SIDE_PX = 16
"""An image is never resized below this: the network halves its input three times."""
MAX_SIDE_RATIO = 8.0


class NetVlad(PlaceDescriptor):
    """A loaded model: images in, place vectors out. ``describe`` gives the same bytes for the same image, alone or
    among others, on every call."""

    def __init__(self, session: ModelSession, card: ModelCard, batch: int = 1) -> None:
        self._session, self._card, self._batch = session, card, batch

    @classmethod
    def load(cls, model: str | Path = "default", threads: int = 1, provider: str = CPU, batch: int = 1) -> NetVlad:
        """A shipped model by name, or the path of an ``.onnx`` file with its card beside it.

        ``threads`` share the work on one image. ``provider``: where onnxruntime runs it, by its name in full or in
        short (``cuda``). ``batch``: images of one size that go through the network together; 1 promises the same
        bytes for an image whatever is described with it, more is for graphics cards
        (docs/appendix/netvlad.md has what it gains).
        """
        for name, count in (("thread", threads), ("image in a batch", batch)):
            if count < 1:
                raise DescriptorError(f"a descriptor needs at least 1 {name}, got {count}")
        path, card = read_card(model)
        log.info("place descriptor %s (%s), %d numbers, on %s", card.name, card.sha256[:12], card.dim, provider)
        return cls(ModelSession.open(path, card, threads, provider), card, batch)

    @property
    def name(self) -> str:
        """Name of the model, for messages and ``manifest.json``."""
        return self._card.name

    @property
    def path(self) -> Path:
        """Path of the ONNX file; the other files of the model stand beside it."""
        return self._session.path

    @property
    def sha256(self) -> str:
        """SHA-256 of the ONNX file, hexadecimal: vectors of two models never mix."""
        return self._card.sha256

    @property
    def dim(self) -> int:
        """Numbers in a vector."""
        return self._card.dim

    @property
    def threshold(self) -> float:
        """Euclidean distance of unit vectors, 0 to 2, below which two images show one place on appearance alone
        (precision 0.99 where calibrated)."""
        return self._card.threshold

    @property
    def candidate_threshold(self) -> float:
        """Euclidean distance of unit vectors, 0 to 2, below which a pair is verified by geometry."""
        return self._card.candidate_threshold

    @property
    def min_std(self) -> float:
        """Grey levels of local contrast below which an image, or a part of it, has no texture to recognise."""
        return self._card.min_std

    @property
    def calibration(self) -> Calibration | None:
        """Measurement of the thresholds; None for an uncalibrated model."""
        return self._card.calibration

    @property
    def card(self) -> ModelCard:
        """The model's card: input, output and thresholds."""
        return self._card

    @property
    def colour(self) -> bool:
        """Whether the network uses colour."""
        return self._card.colour

    def describe(self, images: Images) -> NDArray[np.float32]:
        """Place vectors ``(N, dim)`` float32, rows of unit norm.

        ``images``: N images ``(H, W)`` grey or ``(H, W, 3)`` BGR, uint8, each of any size, or one such stack ``(N,
        H, W)``. An image without texture still gets a vector, a meaningless one: see :meth:`textured`.
        """
        return self._run(self._prepare(image) for image in images)

    def textured(self, images: Images) -> NDArray[np.bool_]:
        """Whether each image has texture to be recognised by (``maslam.descriptors.texture``), ``(N,)`` bool."""
        return np.array([self._has_texture(self._prepare(image)) for image in images], dtype=bool)

    def look(self, images: Images) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """:meth:`describe` and :meth:`textured` together: vectors ``(N, dim)`` float32 and flags ``(N,)`` bool; each
        image is resized once."""
        flags: list[bool] = []

        def gated() -> Iterator[NDArray[np.uint8]]:
            for image in images:
                prepared = self._prepare(image)
                flags.append(self._has_texture(prepared))
                yield prepared

        vectors = self._run(gated())
        return vectors, np.array(flags, dtype=bool)

    def place_vectors(self, images: Images, stamps_ns: NDArray[np.int64] | Sequence[int]) -> PlaceVectors:
        """Vectors, texture flags and time stamps (integer nanoseconds, one per image) in the container that is written
        to disk."""
        from .container import PlaceVectors

        stamps = np.asarray(stamps_ns, dtype=np.int64)
        return PlaceVectors(self.name, self.sha256, self.dim, stamps, *self.look(images))

    def _prepare(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """The network's input for one image, ``(C, h, w)`` uint8."""
        if not self._card.colour:
            return to_working_size(image, self._card.input_pixels, self._card.input_size)[None]
        return np.ascontiguousarray(
            colour_to_working_size(image, self._card.input_pixels, self._card.input_size)[:, :, ::-1].transpose(2, 0, 1)
        )

    def _has_texture(self, prepared: NDArray[np.uint8]) -> bool:
        grey = prepared[0] if len(prepared) == 1 else cv2.cvtColor(prepared.transpose(1, 2, 0), cv2.COLOR_RGB2GRAY)
        return has_texture(np.asarray(grey, dtype=np.uint8), self.min_std)

    def _run(self, prepared: Iterable[NDArray[np.uint8]]) -> NDArray[np.float32]:
        """Neighbours of one size go together, at most ``batch`` of them; no more than these are held."""
        rows: list[NDArray[np.float32]] = []
        waiting: list[NDArray[np.uint8]] = []
        for image in prepared:
            if waiting and (len(waiting) == self._batch or image.shape != waiting[0].shape):
                rows.append(self._session.run(np.stack(waiting)))
                waiting = []
            waiting.append(image)
        if waiting:
            rows.append(self._session.run(np.stack(waiting)))
        return np.concatenate(rows) if rows else np.zeros((0, self.dim), dtype=np.float32)


def to_working_size(image: NDArray[np.uint8], pixels: int, exact: tuple[int, int] | None = None) -> NDArray[np.uint8]:
    """A grey or BGR uint8 image as grey ``(h, w)`` of about ``pixels`` pixels, its shape kept: every image costs
    the same. ``exact`` (h, w): of this size instead, its shape as it may be."""
    checked = _checked(image)
    grey = cv2.cvtColor(checked, cv2.COLOR_BGR2GRAY) if checked.ndim == 3 else checked
    return _resized(np.asarray(grey, dtype=np.uint8), pixels, exact)


def colour_to_working_size(
    image: NDArray[np.uint8], pixels: int, exact: tuple[int, int] | None = None
) -> NDArray[np.uint8]:
    """The same in colour, ``(h, w, 3)`` BGR; a grey image has three equal channels."""
    checked = _checked(image)
    colour = checked if checked.ndim == 3 else cv2.cvtColor(checked, cv2.COLOR_GRAY2BGR)
    return _resized(np.asarray(colour, dtype=np.uint8), pixels, exact)


def _checked(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """``(H, W)`` or ``(H, W, 3)``, or an error that says what it is instead."""
    found = np.asarray(image)
    if found.dtype != np.uint8 or found.ndim not in (2, 3) or not found.size:
        raise DescriptorError(
            f"an image must be (H, W) or (H, W, 3) uint8 with pixels in it, got {found.shape} {found.dtype}"
        )
    if found.ndim == 3 and found.shape[2] not in (1, 3):
        raise DescriptorError(f"a colour image must have 3 channels (BGR), got {found.shape[2]}")
    height, width = found.shape[:2]
    if max(height, width) > MAX_SIDE_RATIO * min(height, width):
        raise DescriptorError(
            f"an image of {width}x{height} px is too narrow: sides may differ by a factor of {MAX_SIDE_RATIO:g}"
        )
    return np.ascontiguousarray(found[:, :, 0] if found.shape[2:] == (1,) else found)


def _resized(image: NDArray[np.uint8], pixels: int, exact: tuple[int, int] | None) -> NDArray[np.uint8]:
    height, width = image.shape[:2]
    scale = (pixels / (height * width)) ** 0.5
    size = (max(MIN_SIDE_PX, round(width * scale)), max(MIN_SIDE_PX, round(height * scale)))
    if exact is not None:
        size = exact[1], exact[0]
    if size == (width, height):
        return image
    # Area averaging when shrinking: anything else aliases fine texture differently from every viewpoint.
    shrinks = size[0] * size[1] < width * height
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(image, size, interpolation=method), dtype=np.uint8)
