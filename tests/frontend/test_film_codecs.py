"""Films with pictures out of order, of a variable rate and of newer kinds: every frame at its time, or the cure."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from film_samples import write_sample
from recording_makers import write_film

from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.datasets.recordings.film import Film, index_film
from maslam.frontend.errors import FrontendError

LEVELS = 20.0 + 18.0 * np.arange(12)
CAMERA = "width: 48\nheight: 32\nfx: 40\nfy: 40\ncx: 23.5\ncy: 15.5\n"
NEAR = 6.0
TIMES_MS = {
    "b_frames.avi": 40.0 * np.arange(12),
    "b_frames.mp4": 40.0 * np.arange(12),
    "variable.mkv": 40.0 * (np.arange(12) + 3 * (np.arange(12) // 4)),
}


def opened(folder: Path, name: str) -> ImageSequence:
    (folder / "camera.yaml").write_text(CAMERA)
    return open_dataset(write_sample(folder, name)).sequences[0]


@pytest.mark.parametrize("name", TIMES_MS)
def test_every_frame_has_its_own_time(tmp_path: Path, name: str) -> None:
    sequence = opened(tmp_path, name)
    assert sequence.problems == (), "a variable rate is no film that is cut off"
    np.testing.assert_allclose(sequence.stamps_ns / 1e6, TIMES_MS[name], atol=1.0)
    found = [float(frame.image.mean()) for frame in sequence.frames()]
    np.testing.assert_allclose(found, LEVELS, atol=NEAR)


@pytest.mark.parametrize("name", TIMES_MS)
def test_in_any_order_too(tmp_path: Path, name: str) -> None:
    path = write_sample(tmp_path, name)
    film = Film(path, index_film(path), True)
    for k in (11, 3, 4, 0, 10, 9, 5, 6, 11, 2):
        assert abs(float(film.read(k).mean()) - LEVELS[k]) < NEAR, k


@pytest.mark.parametrize("suffix", ["webm", "mp4"])
def test_vp9_is_read(tmp_path: Path, suffix: str) -> None:
    pictures = [np.full((32, 48), level, dtype=np.uint8) for level in LEVELS]
    write_film(tmp_path / f"a.{suffix}", pictures, 25.0, "VP90" if suffix == "webm" else "vp09")
    (tmp_path / "camera.yaml").write_text(CAMERA)
    [sequence] = open_dataset(tmp_path / f"a.{suffix}").sequences
    np.testing.assert_allclose([float(f.image.mean()) for f in sequence.frames()], LEVELS, atol=NEAR)
    np.testing.assert_allclose(sequence.stamps_ns / 1e6, 40.0 * np.arange(12), atol=1.0)


def test_av1_is_read_or_named_with_the_cure(tmp_path: Path) -> None:
    path = write_sample(tmp_path, "av1.mp4")
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    if capture.grab():
        assert abs(float(Film(path, index_film(path), True).read(5).mean()) - LEVELS[5]) < NEAR
        return
    with pytest.raises(FrontendError, match=r"the video is AV01, which this OpenCV has no decoder for; `ffmpeg -i "):
        open_dataset(path)
