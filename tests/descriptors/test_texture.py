"""What counts as an image without texture: pictures made so that nobody could say where they were taken."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.descriptors.inference import NetVlad
from maslam.descriptors.texture import has_texture, noise_level
from tests.descriptors.conftest import textured_image

HEIGHT, WIDTH = 480, 640
Y, X = np.mgrid[:HEIGHT, :WIDTH].astype(np.float64)
FOG = 190 + 60 * (Y / HEIGHT - 0.5) ** 2


def camera(radiance: NDArray[np.float64] | float, noise: float, seed: int = 0) -> NDArray[np.uint8]:
    """An image with noise of so many grey levels, cut off at black and white."""
    level = np.broadcast_to(radiance, (HEIGHT, WIDTH)) + np.random.default_rng(seed).normal(0, noise, (HEIGHT, WIDTH))
    return np.clip(level, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def model() -> NetVlad:
    return NetVlad.load()


@pytest.mark.parametrize(
    ("name", "image"),
    [
        ("black", camera(0, 0)),
        ("white", camera(255, 0)),
        ("lens cap, read noise", camera(3, 3)),
        ("lens cap, high gain", camera(10, 15)),
        ("bare wall", camera(128, 2)),
        ("bare wall, shaded", camera(60 + 130 * X / WIDTH, 2)),
        ("bare wall at night", camera(90, 12)),
        ("noise alone", camera(128, 30)),
        ("noise of every level", camera(128, 200)),
        ("vignette", camera(180 - 100 * ((X - 320) ** 2 + (Y - 240) ** 2) / 320**2, 2)),
        ("fog", camera(FOG, 2)),
        ("fog and a horizon", camera(np.where(Y < 250, 200, 188), 2)),
        ("edge of a wall", camera(np.where(X < 290, 60, 180), 0)),
        ("edge of a wall, aslant", camera(np.where(X + 0.4 * Y < 384, 60, 180), 2)),
        ("one bright window", camera(np.where((abs(X - 320) < 60) & (abs(Y - 240) < 60), 255, 20), 2)),
        ("defocused", cv2.GaussianBlur(textured_image(1, HEIGHT, WIDTH), (0, 0), 40)),
    ],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_nothing_to_recognise(model: NetVlad, name: str, image: NDArray[np.uint8]) -> None:
    assert model.textured([image]).tolist() == [False], name
    assert np.isfinite(model.describe([image])).all()


@pytest.mark.parametrize("noise", [0.0, 4.0, 12.0])
@pytest.mark.parametrize("gain", [0.4, 1.0])
def test_pictures_pass_in_dim_light_and_with_noise(model: NetVlad, noise: float, gain: float) -> None:
    pictures = [camera(gain * textured_image(seed, HEIGHT, WIDTH), noise, seed) for seed in range(6)]
    assert model.textured(pictures).all()
    slightly_blurred = [cv2.GaussianBlur(picture, (0, 0), 3) for picture in pictures]
    assert model.textured(slightly_blurred).all()


def test_local_contrast_sees_edges_and_not_shading() -> None:
    ramp = np.tile(np.linspace(0, 255, 160), (120, 1)).astype(np.uint8)
    edge = np.where(np.arange(160) % 40 < 20, 60, 180).astype(np.uint8) * np.ones((120, 1), dtype=np.uint8)
    assert not has_texture(ramp, 1.0)
    assert has_texture(edge, 10.0)


def test_noise_is_measured_beside_edges() -> None:
    for sigma in (1.0, 5.0, 20.0):
        stripes = np.where(X % 80 < 40, 90.0, 160.0)
        assert noise_level(camera(stripes, sigma)) == pytest.approx(sigma, rel=0.1)
    assert noise_level(np.zeros((16, 16), dtype=np.uint8)) == 0.0


def test_an_image_has_texture_where_a_seventh_of_its_area_has() -> None:
    for share in (0.0, 0.08, 0.25, 0.5, 1.0):
        checks = np.where((X // 8 + Y // 8) % 2 > 0, 100.0, 160.0)
        image = camera(np.where(share * WIDTH > X, checks, 128.0), 2.0)
        assert has_texture(image, 2.5) is (share > 1 / 7)
