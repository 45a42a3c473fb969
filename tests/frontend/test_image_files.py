"""Image files as cameras, phones and editors write them: read as stored, or refused in one line that names what they
are."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import HEIGHT, WIDTH, make_scene, own_camera, write_images
from numpy.typing import NDArray
from PIL import Image

from maslam.frontend.datasets import Severity, open_dataset
from maslam.frontend.datasets.image_headers import MAX_PIXELS, read_header
from maslam.frontend.datasets.images import read_colour, read_grey
from maslam.frontend.errors import FrontendError

IMAGE = make_scene().images[0]
FILM = b"\x00\x00\x00\x18ftypmp42" + np.random.default_rng(3).integers(0, 256, 60_000, dtype=np.uint8).tobytes()


def jpeg(image: NDArray[np.uint8] = IMAGE, **how: object) -> bytes:
    """By Pillow, which is none of the code under test."""
    data = io.BytesIO()
    picture = Image.fromarray(image)
    (picture.convert(str(how.pop("mode"))) if "mode" in how else picture).save(data, "JPEG", quality=95, **how)
    return data.getvalue()


def png(image: NDArray[np.generic]) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def put(tmp_path: Path, data: bytes, name: str = "a.jpg") -> Path:
    path = tmp_path / name
    path.write_bytes(data)
    return path


def app_segment(marker: int, body: bytes) -> bytes:
    return bytes([0xFF, marker]) + (len(body) + 2).to_bytes(2, "big") + body


def with_segment(data: bytes, segment: bytes) -> bytes:
    return data[:2] + segment + data[2:]


def orientation_exif(value: int) -> bytes:
    directory = struct.pack(">HHHIHHI", 1, 0x0112, 3, 1, value, 0, 0)
    return b"Exif\0\0" + b"MM\0*" + struct.pack(">I", 8) + directory


ODD_JPEGS = {
    "progressive": jpeg(progressive=True),
    "restart markers": jpeg(restart_marker_blocks=2),
    "a film behind it": jpeg() + FILM,
    "another JPEG behind it, cut off": jpeg() + jpeg()[:200],
    "zeros behind it": jpeg() + bytes(1000),
    "a thumbnail inside": with_segment(jpeg(), app_segment(0xE1, b"Exif\0\0II*\0" + jpeg(IMAGE[:16, :16].copy()))),
    "a cut-off thumbnail inside": with_segment(jpeg(), app_segment(0xE1, b"Exif\0\0MM\0*" + jpeg()[:300])),
    "a comment of markers": with_segment(jpeg(), app_segment(0xFE, b"\xff\xd9\xff\xda\xff\xd9")),
    "filled up before a marker": with_segment(jpeg(), b"\xff\xff\xff" + app_segment(0xFE, b"x")[0:]),
    "colours of print": jpeg(mode="CMYK"),
    "colours": jpeg(mode="RGB"),
}


@pytest.mark.parametrize("kind", ODD_JPEGS)
def test_odd_jpegs_are_read(tmp_path: Path, kind: str) -> None:
    image = read_grey(put(tmp_path, ODD_JPEGS[kind]))
    assert image.dtype == np.uint8
    np.testing.assert_allclose(image.astype(int), IMAGE, atol=12)
    assert read_colour(put(tmp_path, ODD_JPEGS[kind])).shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("kind", ODD_JPEGS)
def test_odd_jpegs_that_stop_early_are_refused(tmp_path: Path, kind: str) -> None:
    header = read_header(ODD_JPEGS[kind])
    assert header.end is not None and (header.width, header.height) == (WIDTH, HEIGHT)
    for kept in (header.end - 1, header.end - 2, header.end // 2):
        with pytest.raises(FrontendError, match=f"a.jpg: the image is cut off after {kept} bytes"):
            read_grey(put(tmp_path, ODD_JPEGS[kind][:kept]))


def frame_marker(data: bytes, marker: int) -> bytes:
    """The JPEG with another coding claimed."""
    at = data.index(b"\xff\xc0")
    return data[: at + 1] + bytes([marker]) + data[at + 2 :]


def deep(data: bytes, bits: int) -> bytes:
    at = data.index(b"\xff\xc0") + 4
    return data[:at] + bytes([bits]) + data[at + 1 :]


def huge_jpeg() -> bytes:
    at = jpeg().index(b"\xff\xc0") + 5
    return jpeg()[:at] + struct.pack(">HH", 20_000, 20_000) + jpeg()[at + 4 :]


def huge_png() -> bytes:
    data = png(IMAGE)
    return data[:16] + struct.pack(">II", 50_000, 50_000) + data[24:]


def tiff_of(width: int, height: int, bits: int = 8, sample_format: int = 1) -> bytes:
    tags = [(256, 4, 1, width), (257, 4, 1, height), (258, 3, 1, bits), (277, 3, 1, 1), (339, 3, 1, sample_format)]
    return (
        b"II*\0"
        + struct.pack("<IH", 8, len(tags))
        + b"".join(struct.pack("<HHII", *tag) for tag in tags)
        + struct.pack("<I", 0)
    )


@pytest.mark.parametrize(
    ("data", "said"),
    [
        (frame_marker(jpeg(), 0xC9), "a JPEG that is arithmetic-coded, which is not read; save it as baseline JPEG"),
        (frame_marker(jpeg(), 0xCA), "a JPEG that is arithmetic-coded"),
        (frame_marker(jpeg(), 0xC3), "a JPEG that is lossless"),
        (deep(jpeg(), 12), "a JPEG of 12 bits, which is not read; save it as PNG of 16 bits"),
        (huge_jpeg(), "20000x20000 pixels by its header, more than the 100 million that are decoded"),
        (huge_png(), "50000x50000 pixels by its header"),
        (tiff_of(60_000, 60_000), "60000x60000 pixels by its header"),
        (tiff_of(96, 64, 32, 3), "a TIFF of real numbers"),
        (b"P5\n# huge\n99999 99999\n255\n", "99999x99999 pixels by its header"),
        (b"BM" + bytes(16) + struct.pack("<ii", 90_000, -90_000) + bytes(30), "90000x90000 pixels by its header"),
        (b"\0\0\0\x18ftypheic\0\0\0\0mif1heic" + bytes(40), "a picture in HEIC, which is not read; convert it"),
        (b"\0\0\0\x18ftypmif1\0\0\0\0avifmif1" + bytes(40), "a picture in AVIF"),
        (b"\0\0\0\x18ftypavif\0\0\0\0mif1miaf" + bytes(40), "a picture in AVIF"),
        (FILM, "a picture in the format of a film"),
        (b"GIF89a" + bytes(40), "a picture in GIF"),
        (b"\0\0\0\x0cJXL \r\n\x87\n" + bytes(40), "a picture in JPEG XL"),
        (b"RIFF" + bytes(4) + b"WEBPVP8X" + bytes(4) + b"\x02" + bytes(20), "a picture in animated WebP"),
        (b"", "the file is empty"),
        (b"no picture at all, but longer than a header", "not an image that can be decoded"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, data: bytes, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    decoded: list[int] = []
    decode = cv2.imdecode
    monkeypatch.setattr(cv2, "imdecode", lambda *of: decoded.append(1) or decode(*of))
    with pytest.raises(FrontendError, match=said) as raised:
        read_grey(put(tmp_path, data))
    assert "\n" not in str(raised.value) and str(tmp_path / "a.jpg") in str(raised.value)
    assert bool(decoded) == said.startswith("not an image"), "refused before it is decoded"


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".pgm", ".webp"])
def test_sizes_are_read_from_headers(suffix: str) -> None:
    header = read_header(cv2.imencode(suffix, IMAGE)[1].tobytes())
    assert (header.width, header.height, header.whole, header.refusal) == (WIDTH, HEIGHT, True, "")
    assert WIDTH * HEIGHT < MAX_PIXELS


def test_bits_of_sixteen_are_known_from_headers() -> None:
    image = IMAGE.astype(np.uint16) * 257
    assert [read_header(cv2.imencode(s, image)[1].tobytes()).bits for s in (".png", ".tif", ".pgm")] == [16, 16, 16]


@pytest.mark.parametrize("orientation", range(1, 9))
def test_an_orientation_is_ignored_and_said_once(tmp_path: Path, orientation: int) -> None:
    scene = make_scene()
    write_images(tmp_path, [f"{i}.jpg" for i in range(6)], scene.images)
    (tmp_path / "camera.yaml").write_text(own_camera("rate_hz: 1\n"))
    for path in tmp_path.glob("*.jpg"):
        path.write_bytes(with_segment(path.read_bytes(), app_segment(0xE1, orientation_exif(orientation))))
        assert Image.open(path).getexif().get(0x0112) == orientation
    [sequence] = open_dataset(tmp_path).sequences
    frame = sequence.read(2)
    assert frame.image.shape == (HEIGHT, WIDTH) and sequence.read_colour(2).shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(frame.image.astype(int), scene.images[2], atol=12)
    said = [problem for problem in sequence.problems if "EXIF" in problem.message]
    assert [problem.severity for problem in said] == [Severity.WARNING] * (orientation > 1)
    assert all(f"orientation {orientation}" in problem.message for problem in said)


@pytest.mark.parametrize("suffix", [".HEIC", ".avif", ".gif", ".dng"])
def test_a_folder_of_pictures_that_are_not_read_says_which(tmp_path: Path, suffix: str) -> None:
    (tmp_path / "images").mkdir()
    for i in range(3):
        (tmp_path / "images" / f"{i}{suffix}").write_bytes(b"x")
    (tmp_path / "camera.yaml").write_text(own_camera())
    with pytest.raises(FrontendError, match=r"images holds 3 files, each a picture in .* which is not read; convert"):
        open_dataset(tmp_path)
