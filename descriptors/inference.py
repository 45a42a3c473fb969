"""Images to place vectors with onnxruntime alone: what agents run. No torch here."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from descriptors.card import Calibration, ModelCard, read_card
from descriptors.errors import DescriptorError

if TYPE_CHECKING:
    from descriptors.container import PlaceVectors

MIN_SIDE_PX = 16
"""An image is never resized below this: the network halves its input three times."""
MAX_SIDE_RATIO = 8.0
_CONTRAST_WINDOW_PX = 9


class NetVlad:
    """A loaded model. ``describe`` gives the same bytes for the same image, alone or among others, on every call."""

    def __init__(self, session: Any, card: ModelCard) -> None:
        self._session, self._card = session, card
        self._input = session.get_inputs()[0].name

    @classmethod
    def load(cls, model: str | Path = "default", threads: int = 1) -> NetVlad:
        """A shipped model by name, or the path of an ``.onnx`` file with its card beside it. ``threads``: for one
        image."""
        import onnxruntime

        if threads < 1:
            raise DescriptorError(f"a descriptor needs at least 1 thread, got {threads}")
        path, card = read_card(model)
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads, options.inter_op_num_threads = threads, 1
        options.log_severity_level = 3
        try:
            session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
        except Exception as error:
            raise DescriptorError(f"{path}: onnxruntime cannot load it: {error}") from error
        return cls(session, card)

    @property
    def name(self) -> str:
        return self._card.name

    @property
    def sha256(self) -> str:
        """Of the ONNX file: vectors of two models never mix."""
        return self._card.sha256

    @property
    def dim(self) -> int:
        return self._card.dim

    @property
    def threshold(self) -> float:
        """Euclidean distance below which two images show one place on appearance alone (precision 0.99 where
        calibrated)."""
        return self._card.threshold

    @property
    def candidate_threshold(self) -> float:
        """Euclidean distance below which a pair is worth a geometric verification: what agents use by default."""
        return self._card.candidate_threshold

    @property
    def min_std(self) -> float:
        """Grey levels of local contrast below which an image has no texture to recognise."""
        return self._card.min_std

    @property
    def calibration(self) -> Calibration | None:
        """How the thresholds were measured."""
        return self._card.calibration

    @property
    def card(self) -> ModelCard:
        return self._card

    def describe(self, images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> NDArray[np.float32]:
        """Place vectors ``(N, dim)`` float32, rows of unit norm.

        ``images``: N images ``(H, W)`` grey or ``(H, W, 3)`` BGR, uint8, each of any size, or one such stack ``(N,
        H, W)``. An image without texture still gets a vector, a meaningless one: see :meth:`textured`.
        """
        # One image at a time: a batch is no faster on one thread, and its sums would depend on what else is in it.
        rows = [self._session.run(None, {self._input: self._prepare(image)[None, None]})[0] for image in images]
        return np.concatenate(rows) if rows else np.zeros((0, self.dim), dtype=np.float32)

    def textured(self, images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8]) -> NDArray[np.bool_]:
        """Whether each image has enough local contrast to be recognised, ``(N,)`` bool."""
        return np.array([local_contrast(self._prepare(image)) >= self.min_std for image in images], dtype=bool)

    def place_vectors(
        self, images: Sequence[NDArray[np.uint8]] | NDArray[np.uint8], stamps_ns: NDArray[np.int64] | Sequence[int]
    ) -> PlaceVectors:
        """Vectors, texture flags and time stamps (nanoseconds, one an image) in the container that is written to
        disk."""
        from descriptors.container import PlaceVectors

        return PlaceVectors(
            self.name,
            self.sha256,
            self.dim,
            np.asarray(stamps_ns, dtype=np.int64),
            self.describe(images),
            self.textured(images),
        )

    def _prepare(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        return to_working_size(image, self._card.input_pixels)


def to_working_size(image: NDArray[np.uint8], pixels: int) -> NDArray[np.uint8]:
    """A grey or BGR uint8 image as grey ``(h, w)`` of about ``pixels`` pixels, its shape kept: every image costs
    the same."""
    grey = np.asarray(image)
    if grey.dtype != np.uint8 or grey.ndim not in (2, 3) or not grey.size:
        raise DescriptorError(
            f"an image must be (H, W) or (H, W, 3) uint8 with pixels in it, got {grey.shape} {grey.dtype}"
        )
    if grey.ndim == 3:
        if grey.shape[2] not in (1, 3):
            raise DescriptorError(f"a colour image must have 3 channels (BGR), got {grey.shape[2]}")
        grey = cv2.cvtColor(grey, cv2.COLOR_BGR2GRAY) if grey.shape[2] == 3 else grey[:, :, 0]
    height, width = grey.shape
    if max(height, width) > MAX_SIDE_RATIO * min(height, width):
        raise DescriptorError(
            f"an image of {width}x{height} px is too narrow: sides may differ by a factor of {MAX_SIDE_RATIO:g}"
        )
    scale = (pixels / (height * width)) ** 0.5
    size = (max(MIN_SIDE_PX, round(width * scale)), max(MIN_SIDE_PX, round(height * scale)))
    if size == (width, height):
        return np.ascontiguousarray(grey)
    # Area averaging when shrinking: anything else aliases fine texture differently from every viewpoint.
    method = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.ascontiguousarray(grey), size, interpolation=method), dtype=np.uint8)


def local_contrast(grey: NDArray[np.uint8]) -> float:
    """Standard deviation, grey levels, of an image minus its own local mean: shading does not count as texture,
    edges do."""
    values = grey.astype(np.float32)
    window = (_CONTRAST_WINDOW_PX, _CONTRAST_WINDOW_PX)
    return float(np.sqrt(np.mean((values - cv2.blur(values, window, borderType=cv2.BORDER_REFLECT)) ** 2)))
