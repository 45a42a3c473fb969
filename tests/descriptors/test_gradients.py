"""Gradient histograms as convolutions against their definition, pixel by pixel, and against what turning an image
does to them."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from maslam.descriptors.errors import DescriptorError  # noqa: E402
from maslam.descriptors.training.gradients import CHANNELS, GradientDescriptors, smallest_side  # noqa: E402
from tests.descriptors.conftest import textured_image  # noqa: E402


def _standard(image: np.ndarray) -> np.ndarray:
    values = image.astype(np.float64)
    return np.asarray((values - values.mean()) / values.std())


def _describe(image: np.ndarray, levels: tuple[int, ...]) -> np.ndarray:
    x = torch.tensor(_standard(image), dtype=torch.float32)[None, None]
    return np.asarray(GradientDescriptors(levels)(x)[0].numpy()).T


def _by_definition(image: np.ndarray, top: int, left: int) -> np.ndarray:
    """RootSIFT of the 4x4 cells whose first triangular window starts at a pixel."""
    x = np.pad(_standard(image), 1, mode="edge")
    dx, dy = (x[1:-1, 2:] - x[1:-1, :-2]) / 2, (x[2:, 1:-1] - x[:-2, 1:-1]) / 2
    out = []
    for i in range(4):
        for j in range(4):
            cell = np.zeros(8)
            for u in range(7):
                for v in range(7):
                    weight = (4 - abs(u - 3)) * (4 - abs(v - 3)) / 16
                    gx, gy = dx[top + 4 * i + u, left + 4 * j + v], dy[top + 4 * i + u, left + 4 * j + v]
                    strength, angle = np.hypot(gx, gy), np.arctan2(gy, gx)
                    for d in range(8):
                        cell[d] += weight * strength * max(np.cos(angle - d * np.pi / 4), 0.0) ** 4
            out.append(cell)
    histogram = np.concatenate(out)
    cut = np.minimum(histogram / np.linalg.norm(histogram), 0.2)
    return np.asarray(np.sqrt(cut / cut.sum()))


def test_descriptors_are_what_their_definition_says() -> None:
    image = textured_image(3, 43, 51)
    found = _describe(image, (1,))
    columns = (51 - 7) // 4 + 1 - 3
    assert found.shape == (((43 - 7) // 4 + 1 - 3) * columns, CHANNELS)
    for row, column in ((0, 0), (2, 3), (6, 8)):
        expected = _by_definition(image, 4 * row, 4 * column)
        np.testing.assert_allclose(found[row * columns + column], expected, atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-3)


def test_the_second_level_describes_the_image_at_half_size() -> None:
    image = textured_image(4, 80, 96)
    half = image.reshape(40, 2, 48, 2).mean(axis=(1, 3))
    x = torch.tensor(_standard(image).reshape(40, 2, 48, 2).mean(axis=(1, 3)), dtype=torch.float32)[None, None]
    fine = GradientDescriptors((1,))(x)[0]  # of the half-size image, a cell apart
    coarse = GradientDescriptors((2,))(torch.tensor(_standard(image), dtype=torch.float32)[None, None])[0]
    height, width = ((side - 7) // 2 + 1 - 6 for side in half.shape)
    every_second = coarse.reshape(CHANNELS, height, width)[:, ::2, ::2].flatten(1)
    np.testing.assert_allclose(every_second.numpy(), fine.numpy(), atol=1e-5)


def test_turning_the_image_turns_the_histograms() -> None:
    image = textured_image(5, 47, 47)  # cells fall on the same pixels when it is turned
    straight = _describe(image, (1,)).reshape(8, 8, 4, 4, 8)
    turned = _describe(np.rot90(image, 2).copy(), (1,)).reshape(8, 8, 4, 4, 8)
    np.testing.assert_allclose(turned, np.roll(straight[::-1, ::-1, ::-1, ::-1], 4, axis=-1), atol=1e-4)


def test_light_changes_nothing() -> None:
    image = textured_image(6, 64, 80)
    np.testing.assert_allclose(
        _describe(image, (1, 2)), _describe(0.25 * image.astype(np.float64) + 100, (1, 2)), atol=1e-4
    )


def test_every_so_many_descriptors_on_wish() -> None:
    x = torch.tensor(_standard(textured_image(7, 60, 72)), dtype=torch.float32)[None, None]
    layer = GradientDescriptors((1,))
    np.testing.assert_allclose(layer(x, 3, 4).numpy(), layer(x)[:, :, 1::3].numpy(), atol=1e-6)


def test_the_smallest_image_has_one_descriptor() -> None:
    side = smallest_side((1, 2))
    assert GradientDescriptors((1, 2))(torch.rand(1, 1, side, side)).shape[2] >= 2
    with pytest.raises(DescriptorError, match="37x38 px is too small"):
        GradientDescriptors((1, 2))(torch.rand(1, 1, side, side - 1))
    with pytest.raises(ValueError, match="must divide"):
        GradientDescriptors((3,))
