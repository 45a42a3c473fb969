"""Pixels of image messages: every encoding against the colours that were encoded."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from test_bags import SCENE, STAMPS, info, messages, only, packed, png, raw

from maslam.frontend.datasets.recordings.pixel_formats import compressed_depth, depth_metres, raw_pixels
from maslam.frontend.errors import FrontendError

pytest.importorskip("rosbags", reason="the extra `bags` is not installed")

BLUE, GREEN, RED = 40, 120, 220
BGR = np.full((8, 12, 3), (BLUE, GREEN, RED), dtype=np.uint8)
MOSAICS = {"rggb": "RGGB", "bggr": "BGGR", "gbrg": "GBRG", "grbg": "GRBG"}


def message(pixels: np.ndarray, encoding: str, padding: int = 0, big: bool = False) -> Any:
    """As deserialised, each row ``padding`` bytes longer than its pixels."""
    stored = pixels.astype(pixels.dtype.newbyteorder(">")) if big else pixels
    rows = np.frombuffer(stored.tobytes(), dtype=np.uint8).reshape(pixels.shape[0], -1)
    rows = np.hstack([rows, np.full((len(rows), padding), 99, dtype=np.uint8)])
    return SimpleNamespace(
        height=pixels.shape[0], width=pixels.shape[1], encoding=encoding, is_bigendian=int(big), step=rows.shape[1],
        data=rows.ravel(),
    )  # fmt: skip


def mosaic(order: str, dtype: Any) -> np.ndarray:
    """A plain colour as a sensor with filters in this order sees it, row by row."""
    value = {"R": RED, "G": GREEN, "B": BLUE}
    block = np.array([[value[order[0]], value[order[1]]], [value[order[2]], value[order[3]]]])
    return np.tile(block, (4, 6)).astype(dtype)


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize(
    ("pixels", "encoding"),
    [
        (BGR, "bgr8"),
        (BGR[:, :, ::-1], "rgb8"),
        (np.dstack([BGR, np.full((8, 12), 7, np.uint8)]), "bgra8"),
        (np.dstack([BGR[:, :, ::-1], np.full((8, 12), 7, np.uint8)]), "rgba8"),
        (BGR, "8UC3"),
        *[(mosaic(order, np.uint8), f"bayer_{name}8") for name, order in MOSAICS.items()],
    ],
)
def test_colours(pixels: np.ndarray, encoding: str, padding: int) -> None:
    decoded = raw_pixels(message(np.ascontiguousarray(pixels), encoding, padding), "x")
    assert decoded.shape == BGR.shape
    np.testing.assert_allclose(decoded.astype(int), BGR, atol=1)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("encoding", ["mono16", "16UC1"])
def test_sixteen_bits_in_either_order(encoding: str, big: bool) -> None:
    pixels = np.arange(96, dtype=np.uint16).reshape(8, 12) * 600
    np.testing.assert_array_equal(raw_pixels(message(pixels, encoding, 2, big), "x"), pixels)


def test_yuv() -> None:
    yuyv = np.zeros((8, 12, 2), dtype=np.uint8)
    yuyv[:, :, 0], yuyv[:, :, 1] = 150, 128  # grey
    for encoding, pixels in (("yuv422_yuy2", yuyv), ("yuv422", yuyv[:, :, ::-1])):
        decoded = raw_pixels(message(np.ascontiguousarray(pixels), encoding), "x")
        assert decoded.shape == (8, 12, 3) and np.ptp(decoded.astype(int)) <= 1


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"encoding": "jpeg2000"}, "pixels encoded as 'jpeg2000', which is not read"),
        ({"height": 9}, "bytes in rows of 36 are no image of 12x9 bgr8"),
        ({"step": 35}, "in rows of 35 are no image"),
        ({"width": 0}, "are no image of 0x8"),
        ({"height": 2**31, "width": 2**31}, "are no image"),
    ],
)
def test_what_is_no_image_is_refused(changes: dict[str, Any], said: str) -> None:
    broken = SimpleNamespace(**{**vars(message(BGR, "bgr8")), **changes})
    with pytest.raises(FrontendError, match=f"bag: {said}" if said[0] == "p" else said):
        raw_pixels(broken, "bag")


class TestSixteenBitsAsGrey:
    def test_twelve_bits_fill_the_grey_levels_of_all_images_alike(self, tmp_path: Path) -> None:
        pixels = (SCENE.images.astype(np.uint16) * 16)[:, ::-1]
        sequence = only(tmp_path / "run.bag", [raw("/image_raw", pixels, "mono16"), info("/camera_info")])
        for i in (0, 3):
            assert np.abs(sequence.read_image(i).astype(int) - SCENE.images[i][::-1]).max() <= 1
        assert "images of 16 bits" in messages(sequence) and "0 to 4095 become 0 to 255" in messages(sequence)

    def test_floats_are_no_images(self, tmp_path: Path) -> None:
        with pytest.raises(FrontendError, match="32-bit floats are depth, no images"):
            only(
                tmp_path / "run.bag",
                [raw("/image_raw", SCENE.images.astype(np.float32), "32FC1"), info("/camera_info")],
            )


class TestCompressed:
    @pytest.mark.parametrize("form", ["png", "mono8; png compressed "])
    def test_png_is_as_it_was(self, tmp_path: Path, form: str) -> None:
        files = [png(image) for image in SCENE.images]
        sequence = only(tmp_path / "mcap", [packed("/image_raw/compressed", files, form), info("/camera_info")])
        np.testing.assert_array_equal(sequence.read_image(4), SCENE.images[4])

    def test_jpeg_in_colour(self, tmp_path: Path) -> None:
        colour = np.full((64, 96, 3), (BLUE, GREEN, RED), dtype=np.uint8)
        files = [cv2.imencode(".jpg", colour)[1].tobytes()] * len(STAMPS)
        topic = packed("/image_raw/compressed", files, "bgr8; jpeg compressed bgr8")
        sequence = only(tmp_path / "sqlite3", [topic, info("/camera_info")])
        np.testing.assert_allclose(sequence.read_colour(1).astype(int), colour, atol=3)
        np.testing.assert_allclose(
            sequence.read_image(1).astype(int), 0.114 * BLUE + 0.587 * GREEN + 0.299 * RED, atol=3
        )

    def test_a_half_image_is_an_error_of_that_frame(self, tmp_path: Path) -> None:
        files = [png(image) for image in SCENE.images]
        files[3] = files[3][: len(files[3]) // 2]
        sequence = only(tmp_path / "run.bag", [packed("/image_raw/compressed", files, "png"), info("/camera_info")])
        assert sequence.read(2).image.shape == SCENE.images[2].shape
        with pytest.raises(FrontendError, match=rf"/image_raw/compressed at {STAMPS[3]} ns: the image is cut off"):
            sequence.read(3)

    def test_the_raw_topic_comes_first_where_both_are_there(self, tmp_path: Path) -> None:
        files = [png(255 - image) for image in SCENE.images]
        topics = [raw("/image_raw", SCENE.images, "mono8"), packed("/image_raw/compressed", files, "png")]
        sequence = only(tmp_path / "run.bag", [*topics, info("/camera_info")])
        np.testing.assert_array_equal(sequence.read_image(1), SCENE.images[1])


class TestDepthSteps:
    def test_inverse_depth(self) -> None:
        """The formula of compressed_depth_image_transport: steps = a / depth + b."""
        depth, a, b = np.array([[0.5, 1.0], [4.0, 8.0]]), 1000.0, -10.0
        steps = np.rint(a / depth + b).astype(np.uint16)
        steps[1, 1] = 0  # unknown
        head = np.zeros(1, "<i4").tobytes() + np.array([a, b], "<f4").tobytes()
        data = np.frombuffer(head + png(steps), dtype=np.uint8)
        decoded = compressed_depth(SimpleNamespace(data=data, format="32FC1; compressedDepth png"), "x")
        np.testing.assert_allclose(decoded, [[0.5, 1.0], [4.0, 0.0]], rtol=0.01)

    def test_other_compressions_of_depth_are_refused(self) -> None:
        with pytest.raises(FrontendError, match=r"depth compressed as '16UC1; compressedDepth rvl', of which only png"):
            compressed_depth(SimpleNamespace(data=np.zeros(90, np.uint8), format="16UC1; compressedDepth rvl"), "x")

    def test_unknown_is_zero(self) -> None:
        np.testing.assert_array_equal(
            depth_metres(np.array([[0, 65535, 2000]], np.uint16), 0.001, "x"), np.float32([[0, 0, 2]])
        )
        floats = np.array([[np.nan, np.inf, -1, 2.5]], np.float32)
        np.testing.assert_array_equal(depth_metres(floats, 0.001, "x"), np.float32([[0, 0, 0, 2.5]]))

    def test_colour_is_no_depth(self) -> None:
        with pytest.raises(FrontendError, match="found 3 of 8 bits"):
            depth_metres(BGR, 0.001, "x")
