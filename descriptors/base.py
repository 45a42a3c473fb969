"""Interface of a place descriptor for the pipeline: :class:`maslam.descriptors.inference.NetVlad` is one, a user's own
may be another."""

from __future__ import annotations

import hashlib
import inspect
from abc import ABC, abstractmethod
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from .texture import has_texture

Images = Sequence[NDArray[np.uint8]] | NDArray[np.uint8]

_TEXTURE_PIXELS = 20_000  # texture is judged on an image of this size, that of the shipped model


class PlaceDescriptor(ABC):
    """Maps an image to a unit vector: near vectors are views of one place.

    A user's own derives from this class, sets ``name``, ``dim`` and ``threshold``, writes :meth:`describe`, and is
    given as ``maslam.preprocess(..., descriptor=...)`` or by an entry point of the group ``maslam.descriptors``.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """Name for messages and ``manifest.json``."""

    @property
    @abstractmethod
    def dim(self) -> int:
        """Numbers in a vector."""

    @property
    @abstractmethod
    def threshold(self) -> float:
        """Euclidean distance of unit vectors, 0 to 2, below which appearance alone says that two images show one
        place."""

    @abstractmethod
    def describe(self, images: Images) -> NDArray[np.float32]:
        """Place vectors ``(N, dim)`` float32, rows of unit norm.

        ``images``: N images ``(H, W)`` grey or ``(H, W, 3)`` BGR, uint8, each of any size. The same image gives the
        same bytes, alone or among others.
        """

    @property
    def candidate_threshold(self) -> float:
        """Euclidean distance below which a pair is worth a geometric verification."""
        return self.threshold

    @property
    def sha256(self) -> str:
        """Identity of the model, 64 hexadecimal digits: vectors of two models never mix, and results of another model
        are made anew. By default from the class's name and source; override it where weights lie elsewhere."""
        return hashlib.sha256(f"{self.name} {self.dim} {_source(type(self))}".encode()).hexdigest()

    @property
    def min_std(self) -> float:
        """Grey levels of local contrast below which an image has no texture to be recognised by."""
        return 2.5

    @property
    def colour(self) -> bool:
        """Whether the descriptor uses colour."""
        return False

    def textured(self, images: Images) -> NDArray[np.bool_]:
        """Whether each image has texture to be recognised by (``maslam.descriptors.texture``), ``(N,)`` bool."""
        return np.array([has_texture(_small_grey(image), self.min_std) for image in images], dtype=bool)

    def look(self, images: Images) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
        """:meth:`describe` and :meth:`textured` together."""
        return self.describe(images), self.textured(images)


def _source(kind: type) -> str:
    try:
        return inspect.getsource(kind)
    except (OSError, TypeError):  # typed in at a prompt
        return f"{kind.__module__}:{kind.__qualname__}"


def _small_grey(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    height, width = grey.shape
    scale = (_TEXTURE_PIXELS / (height * width)) ** 0.5
    if scale >= 1:
        return np.asarray(grey, dtype=np.uint8)
    size = (max(1, round(width * scale)), max(1, round(height * scale)))
    return np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
