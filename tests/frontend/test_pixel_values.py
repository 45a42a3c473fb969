"""Images of more than 8 bits, and colour mosaics: one choice for a sequence, by its content, and it is said."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import COUNT, HEIGHT, WIDTH, make_scene, numbered, own_camera, write_images, write_rendered
from numpy.typing import NDArray

from maslam.frontend.datasets import ImageSequence, ReadingConfig, open_dataset

SCENE = make_scene()


def opened(folder: Path, images: NDArray[np.generic], suffix: str = ".png", mosaic: str = "auto") -> ImageSequence:
    write_images(folder, numbered(suffix), images)
    (folder / "camera.yaml").write_text(own_camera("rate_hz: 1\n"))
    [sequence] = open_dataset(folder, reading=ReadingConfig(mosaic=mosaic)).sequences
    return sequence


def scaled(top: int) -> NDArray[np.uint16]:
    """The scene with its brightest pixel at ``top``."""
    images = SCENE.images.astype(np.float64)
    return np.rint(images * (top / images.max())).astype(np.uint16)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
@pytest.mark.parametrize(("top", "bits"), [(255, 8), (1000, 10), (4000, 12), (16_000, 14), (65_000, 16)])
def test_the_bits_that_values_need_become_eight(tmp_path: Path, top: int, bits: int, suffix: str) -> None:
    stored = scaled(top)
    sequence = opened(tmp_path, stored, suffix)
    expected = stored * (255.0 / (2**bits - 1))
    for i in range(COUNT):
        np.testing.assert_allclose(sequence.read(i).image, expected[i], atol=0.51)
        np.testing.assert_allclose(sequence.read_colour(i), np.repeat(expected[i][..., None], 3, axis=2), atol=1.01)
    [note] = sequence.notes
    assert f"images of 16 bits, values up to {top}, so {bits} bits are used" in note
    assert sequence.problems == ()


def test_images_of_eight_bits_stored_in_sixteen_come_back(tmp_path: Path) -> None:
    sequence = opened(tmp_path, SCENE.images.astype(np.uint16) * 257)
    for i in range(COUNT):
        np.testing.assert_array_equal(sequence.read(i).image, SCENE.images[i])


def test_one_dark_image_is_not_brightened(tmp_path: Path) -> None:
    stored = scaled(4000)
    stored[3] //= 8
    sequence = opened(tmp_path, stored)
    np.testing.assert_allclose(sequence.read(3).image, stored[3] * (255.0 / 4095), atol=0.51)


def test_a_few_dead_pixels_do_not_darken_all(tmp_path: Path) -> None:
    stored = scaled(4000)
    stored[:, 5, 7] = 65535
    image = opened(tmp_path / "a", np.repeat(np.repeat(stored, 2, axis=1), 2, axis=2)[:, :HEIGHT, :WIDTH]).read(0).image
    assert image.mean() > 0.8 * SCENE.images[0, : HEIGHT // 2, : WIDTH // 2].mean() * 4000 / 4095


def test_narrow_content_is_stretched(tmp_path: Path) -> None:
    """As of a thermal camera: a few hundred steps far from zero."""
    stored = (21_000 + SCENE.images.astype(np.uint16) * 4).astype(np.uint16)
    sequence = opened(tmp_path, stored)
    images = np.stack([sequence.read(i).image for i in range(COUNT)]).astype(float)
    assert np.ptp(images) > 150 and images.min() > 0 and images.max() < 255
    for i, image in enumerate(images):
        assert np.corrcoef(image.ravel(), SCENE.images[i].ravel())[0, 1] > 0.9999
    assert "become 0 to 255, the same in all images" in sequence.notes[0]


def test_both_cameras_of_a_pair_take_one_range(tmp_path: Path) -> None:
    write_rendered(tmp_path, SCENE, "stereo")
    write_images(tmp_path / "image_0", numbered(), scaled(4000))
    write_images(tmp_path / "image_1", numbered(), SCENE.rights.astype(np.uint16) * 2)
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_allclose(sequence.read(0).right, SCENE.rights[0] * (2 * 255.0 / 4095), atol=0.51)


# ---- colour mosaics

GAINS = {"RGGB": [[0.45, 1.0], [1.0, 0.6]], "GRBG": [[1.0, 0.45], [0.6, 1.0]], "BGGR": [[0.6, 1.0], [1.0, 0.45]]}


def mosaic(order: str, top: int = 255) -> NDArray[np.uint16]:
    """A grey world under a greenish lamp, as the sensor stores it."""
    gain = np.tile(np.array(GAINS[order]), (HEIGHT // 2, WIDTH // 2))
    return np.rint(SCENE.images * gain * (top / 255)).astype(np.uint16)


@pytest.mark.parametrize("order", GAINS)
@pytest.mark.parametrize("top", [255, 4095])
def test_a_mosaic_is_recognised_and_becomes_grey(tmp_path: Path, order: str, top: int) -> None:
    stored = mosaic(order, top)
    sequence = opened(tmp_path, stored.astype(np.uint8) if top == 255 else stored)
    assert sequence.values.mosaic and "Bayer mosaic" in sequence.notes[-1]
    image = sequence.read(1).image.astype(float)
    world = SCENE.images[1] * np.mean(GAINS[order])  # (R + 2 G + B) / 4
    assert np.corrcoef(image.ravel(), world.ravel())[0, 1] > 0.99 and abs(image.mean() - world.mean()) < 0.5
    # Nothing of the pattern is left: neighbours differ no more than in the world itself.
    assert abs(image[::2, ::2].mean() - image[::2, 1::2].mean()) < 0.5


@pytest.mark.parametrize("order", GAINS)
def test_one_colour_becomes_one_grey(tmp_path: Path, order: str) -> None:
    """R + 2 G + B over 4, at every pixel, whatever the order; nothing moves."""
    flat = np.full((COUNT, HEIGHT, WIDTH), 200.0)
    flat[:, :, WIDTH // 2 :] = 100.0
    stored = np.rint(flat * np.tile(np.array(GAINS[order]), (HEIGHT // 2, WIDTH // 2))).astype(np.uint8)
    image = opened(tmp_path, stored).read(0).image
    grey = np.mean(GAINS[order])
    np.testing.assert_allclose(image[:, : WIDTH // 2 - 1], 200.0 * grey, atol=1)
    np.testing.assert_allclose(image[:, WIDTH // 2 + 1 :], 100.0 * grey, atol=1)


def test_pictures_are_no_mosaics(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    noisy = np.clip(SCENE.images + rng.normal(0, 12, SCENE.images.shape), 0, 255).astype(np.uint8)
    rows = SCENE.images.copy()
    rows[:, ::2] //= 2  # interlaced
    for name, images in (("plain", SCENE.images), ("noisy", noisy), ("interlaced", rows)):
        (tmp_path / name).mkdir()
        assert not opened(tmp_path / name, images).values.mosaic, name


def test_a_setting_decides_about_mosaics(tmp_path: Path) -> None:
    stored = mosaic("RGGB").astype(np.uint8)
    sequence = opened(tmp_path, stored, mosaic="no")
    np.testing.assert_array_equal(sequence.read(0).image, stored[0])
    assert opened(tmp_path, SCENE.images, mosaic="yes").values.mosaic


def test_a_colour_image_is_never_taken_for_a_mosaic(tmp_path: Path) -> None:
    images = np.repeat(mosaic("RGGB").astype(np.uint8)[..., None], 3, axis=3)
    assert not opened(tmp_path, images).values.mosaic
    assert cv2.imread(str(tmp_path / "000000.png"), cv2.IMREAD_UNCHANGED).ndim == 3
