"""Masks as programs of segmentation and cameras' tools write them: with transparency, or as lossy images."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from dataset_makers import HEIGHT, WIDTH, numbered, write_images
from numpy.typing import NDArray
from test_masks import MASKS, check, opened, written

from maslam.frontend.datasets import ImageSequence


def masked_as(folder: Path, suffix: str, make: Callable[[NDArray[np.uint8]], NDArray[np.uint8]]) -> ImageSequence:
    write_images(written(folder) / "masks", numbered(suffix), np.stack([make(mask) for mask in MASKS]))
    return opened(folder)


def test_transparent_pixels_of_a_mask_are_masked(tmp_path: Path) -> None:
    """As programs cut out what they have segmented: colours everywhere, and alpha."""
    grey = np.random.default_rng(1).integers(1, 255, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    check(masked_as(tmp_path, ".png", lambda mask: np.dstack([grey, mask])))


def test_a_jpegs_noise_beside_black_is_black(tmp_path: Path) -> None:
    """Compression leaves values a little above 0 on the black side of an edge."""
    noise = np.random.default_rng(1).integers(0, 40, (HEIGHT, WIDTH)).astype(np.uint8)
    sequence = masked_as(tmp_path, ".jpg", lambda mask: np.where(mask > 0, 255 - noise, noise))
    for i, frame in enumerate(sequence.frames()):
        assert frame.used is not None and (frame.used == (MASKS[i] > 0)).all()


def test_masks_that_mask_nothing_or_most_are_doubted(tmp_path: Path) -> None:
    sequence = masked_as(tmp_path / "white", ".png", np.ones_like)
    assert any("nothing is masked" in problem.message for problem in sequence.problems)
    sequence = masked_as(tmp_path / "inverted", ".png", lambda mask: 255 - mask)
    assert any("are the masks inverted" in problem.message for problem in sequence.problems)
