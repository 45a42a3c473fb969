"""Descriptors by name, by file, or as a user's object."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeGuard

import numpy as np
from numpy.typing import NDArray

from maslam.extensions import ExtensionGroup, check_name, load_extension, made, name_of

from .base import Images, PlaceDescriptor
from .card import MODELS
from .errors import DescriptorError
from .inference import NetVlad
from .session import CPU

DescriptorLike = PlaceDescriptor | type[PlaceDescriptor] | Callable[[], PlaceDescriptor]
"""A descriptor, or what makes one."""
_UNIT = 1e-3  # a vector may be off unit length by this


def check_descriptor(given: str) -> None:
    """Refuse a name that is no shipped model's, no ONNX file's and no entry point's."""
    if not is_model(given):
        check_name(ExtensionGroup.DESCRIPTORS, "descriptor", given, _shipped())


def load_descriptor(given: DescriptorLike | str | Path, provider: str = CPU) -> PlaceDescriptor:
    """A shipped model by name, an ONNX file with its card beside it, an entry point by name, or a user's object.

    ``provider``: where onnxruntime runs a model. :class:`DescriptorError` where there is no such descriptor.
    """
    if is_model(given):
        return NetVlad.load(given, provider=provider)
    if isinstance(given, str):
        check_descriptor(given)
        name, extension = given, load_extension(ExtensionGroup.DESCRIPTORS, given)
    else:
        name, extension = name_of(given), given
    descriptor = made(extension, PlaceDescriptor, f"descriptor {name}")  # type: ignore[type-abstract]
    return descriptor if isinstance(descriptor, NetVlad | CheckedDescriptor) else CheckedDescriptor(descriptor)


def is_model(given: object) -> TypeGuard[str | Path]:
    """Whether ``given`` names a model that onnxruntime runs: shipped, or an ONNX file."""
    return isinstance(given, Path) or (isinstance(given, str) and (given.endswith(".onnx") or given in _shipped()))


def _shipped() -> tuple[str, ...]:
    return tuple(sorted(path.stem for path in MODELS.glob("*.onnx")))


class CheckedDescriptor(PlaceDescriptor):
    """``inner`` with its vectors checked: what does not fit is said where it was made."""

    def __init__(self, inner: PlaceDescriptor) -> None:
        self.inner = inner

    @property
    def name(self) -> str:
        return self.inner.name

    @property
    def dim(self) -> int:
        return self.inner.dim

    @property
    def threshold(self) -> float:
        return self.inner.threshold

    @property
    def candidate_threshold(self) -> float:
        return self.inner.candidate_threshold

    @property
    def sha256(self) -> str:
        return self.inner.sha256

    @property
    def min_std(self) -> float:
        return self.inner.min_std

    @property
    def colour(self) -> bool:
        return self.inner.colour

    def textured(self, images: Images) -> NDArray[np.bool_]:
        return self.inner.textured(images)

    def describe(self, images: Images) -> NDArray[np.float32]:
        vectors = np.asarray(self.inner.describe(images))
        if vectors.shape != (len(images), self.dim):
            raise DescriptorError(
                f"descriptor {self.name}: made {vectors.shape} of {len(images)} images, not ({len(images)}, {self.dim})"
            )
        lengths = np.linalg.norm(vectors, axis=1)
        if not (np.abs(lengths - 1.0) <= _UNIT).all():
            raise DescriptorError(
                f"descriptor {self.name}: a vector has length {lengths[np.argmax(np.abs(lengths - 1.0))]:.4g}, not 1"
            )
        return vectors.astype(np.float32)
