"""Dense RootSIFT-VLAD, the hand-made descriptor that a learned one must beat: grey image to unit vector, no training
of a network.

SIFT on a regular grid, square roots of its L1-normalised histograms (Arandjelovic and Zisserman, CVPR 2012), principal
axes to 64 numbers, 64 centres, residuals summed for each nearest centre and normalised for each (Jegou et al., CVPR
2010; Arandjelovic and Zisserman, CVPR 2013), and, for short codes, whitened principal axes (Jegou and Chum, ECCV 2012).
The settings were chosen on rendered held-out worlds (docs/appendix/netvlad.md).
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from maslam._atomic import write_npz
from maslam.descriptors.clusters import k_means, whitening
from maslam.descriptors.inference import to_working_size

from ..common.errors import ToolError

PIXELS = 19_200
STEP_PX, SIZE_PX = 4.0, 8.0 / 3.0  # of the grid; of a key-point: its histograms cover six times as much
LOCAL_DIM, CENTRES = 64, 64
WHITENED_DIM, WHITENING = 256, 0.375
_CODEBOOK_IMAGES, _FEATURES_PER_IMAGE, _ROUNDS = 800, 120, 25
_CACHE_VERSION = 1


@dataclass(frozen=True)
class SiftVlad:
    """``mean`` ``(128,)`` and ``axes`` ``(64, 128)`` of RootSIFT, ``centres`` ``(64, 64)``; of whole vectors
    ``vlad_mean`` ``(4096,)`` and ``vlad_axes`` ``(256, 4096)``, whitened, strongest first. All float32."""

    mean: NDArray[np.float32]
    axes: NDArray[np.float32]
    centres: NDArray[np.float32]
    vlad_mean: NDArray[np.float32]
    vlad_axes: NDArray[np.float32]

    def describe(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """The raw vector ``(4096,)`` of one image, grey or BGR uint8 of any size."""
        local = self._local(root_sift(to_working_size(image, PIXELS)))
        scores = local @ self.centres.T - 0.5 * np.square(self.centres).sum(axis=1)
        taken = np.zeros((len(local), len(self.centres)), dtype=np.float32)
        taken[np.arange(len(local)), scores.argmax(axis=1)] = 1.0
        residuals = taken.T @ local - taken.sum(axis=0)[:, None] * self.centres
        return unit_rows(unit_rows(residuals).reshape(1, -1))[0]

    def whiten(self, vectors: NDArray[np.float32], dim: int = WHITENED_DIM) -> NDArray[np.float32]:
        """Raw vectors ``(n, 4096)`` to unit ``(n, dim)``."""
        return unit_rows((vectors - self.vlad_mean) @ self.vlad_axes[:dim].T)

    def _local(self, features: NDArray[np.float32]) -> NDArray[np.float32]:
        return unit_rows((features - self.mean) @ self.axes.T)


def root_sift(grey: NDArray[np.uint8]) -> NDArray[np.float32]:
    """RootSIFT ``(n, 128)`` on a grid over a grey image, upright; unit rows (zero where there is nothing)."""
    _, descriptors = _extractor().compute(grey, _grid(*grey.shape))
    return np.asarray(np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6)), dtype=np.float32)


def fit_sift_vlad(
    photos: Sequence[NDArray[np.uint8]],
    images: Sequence[NDArray[np.uint8]],
    rng: np.random.Generator,
    advance: Callable[[int], None] = lambda done: None,
) -> SiftVlad:
    """Codebook from ``photos`` and whitening from ``images``, more than 256, none of which is to be recognised later.

    ``advance`` counts to ``len(images)``.
    """
    if len(images) <= WHITENED_DIM:
        raise ToolError(f"RootSIFT-VLAD needs more than {WHITENED_DIM} images to be fitted on, got {len(images)}")
    chosen = np.sort(rng.choice(len(photos), min(_CODEBOOK_IMAGES, len(photos)), replace=False))
    samples = []
    for index in chosen:
        features = root_sift(to_working_size(photos[index], PIXELS))
        samples.append(features[rng.choice(len(features), min(_FEATURES_PER_IMAGE, len(features)), replace=False)])
    features = np.concatenate(samples)
    mean = features.mean(axis=0)
    _, axes = np.linalg.eigh(np.cov((features - mean).T))
    axes = np.ascontiguousarray(axes[:, ::-1][:, :LOCAL_DIM].T, dtype=np.float32)
    centres = k_means(unit_rows((features - mean) @ axes.T), CENTRES, _ROUNDS, rng)
    nothing = np.zeros(0, dtype=np.float32)
    unwhitened = SiftVlad(mean, axes, centres, nothing, nothing)
    vectors = np.empty((len(images), CENTRES * LOCAL_DIM), dtype=np.float32)
    for row, image in enumerate(images):
        vectors[row] = unwhitened.describe(image)
        advance(row + 1)
    vlad_mean, vlad_axes, _ = whitening(vectors, WHITENED_DIM, WHITENING)
    return SiftVlad(mean, axes, centres, vlad_mean.astype(np.float32), vlad_axes.astype(np.float32))


def fitted(
    photos: Sequence[NDArray[np.uint8]],
    images: Sequence[NDArray[np.uint8]],
    cache: Path,
    advance: Callable[[int], None] = lambda done: None,
) -> SiftVlad:
    """:func:`fit_sift_vlad` with seed 0, kept in folder ``cache`` for the same images and settings."""
    digest = hashlib.sha256(repr((_CACHE_VERSION, len(photos), *_settings())).encode())
    for image in (*photos, *images):
        digest.update(repr(image.shape).encode() + np.ascontiguousarray(image).tobytes())
    path = cache / f"rootsift_vlad_{digest.hexdigest()[:12]}.npz"
    names = ("mean", "axes", "centres", "vlad_mean", "vlad_axes")
    if path.is_file():
        with np.load(path, allow_pickle=False) as file:
            return SiftVlad(*(file[name] for name in names))
    made = fit_sift_vlad(photos, images, np.random.default_rng(0), advance)
    cache.mkdir(parents=True, exist_ok=True)
    write_npz(path, {name: getattr(made, name) for name in names})
    return made


def unit_rows(vectors: NDArray[np.floating]) -> NDArray[np.float32]:
    """Each row over its length; a row of zeros stays one."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12), dtype=np.float32)


def _settings() -> tuple[float, ...]:
    return (
        PIXELS,
        STEP_PX,
        SIZE_PX,
        LOCAL_DIM,
        CENTRES,
        WHITENED_DIM,
        WHITENING,
        _CODEBOOK_IMAGES,
        _FEATURES_PER_IMAGE,
        _ROUNDS,
    )


@lru_cache(maxsize=1)
def _extractor() -> Any:
    return cv2.SIFT.create()


@lru_cache(maxsize=8)
def _grid(height: int, width: int) -> list[Any]:
    """Key-points all over an image, the margin half a step."""
    ys, xs = (np.arange(STEP_PX / 2, side - STEP_PX / 2 + 1e-6, STEP_PX) for side in (height, width))
    return [cv2.KeyPoint(float(x), float(y), SIZE_PX, 0.0, 1.0, 0, -1) for y in ys for x in xs]
