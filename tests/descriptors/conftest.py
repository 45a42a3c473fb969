"""Images and small models that the descriptor tests share."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray


def textured_image(seed: int, height: int = 120, width: int = 160) -> NDArray[np.uint8]:
    """Blobs and edges at several scales, another picture for every seed."""
    import cv2

    rng = np.random.default_rng(seed)
    image = np.zeros((height, width), dtype=np.float32)
    for cells in (3, 6, 12, 24):
        coarse = rng.normal(size=(cells, cells + cells // 3)).astype(np.float32)
        image += cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    for _ in range(12):
        x, y, w, h = rng.integers([0, 0, 8, 8], [width, height, width // 3, height // 3])
        image[y : y + h, x : x + w] += rng.normal() * 1.5
    return np.asarray((127 + 45 * image / image.std()).clip(0, 255).astype(np.uint8))


@pytest.fixture
def images() -> list[NDArray[np.uint8]]:
    """Eight different pictures of 160x120."""
    return [textured_image(seed) for seed in range(8)]
