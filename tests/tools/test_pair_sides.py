"""Left and right images that change places along a sequence, named with their frames: against what was exchanged."""

from __future__ import annotations

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.tools.cli import main
from maslam.tools.inspection.command import inspect_dataset


def messages(folder: Path) -> list[str]:
    return [f"{p.severity} {p.message}" for s in inspect_dataset(folder).sequences for p in s.problems]


def files(folder: Path, side: str) -> list[Path]:
    return sorted((folder / side).iterdir())


@pytest.fixture
def pair(town_stereo: Path, tmp_path: Path) -> Path:
    return shutil.copytree(town_stereo / "agent_00", tmp_path / "pair")


def exchange(folder: Path, frames: range) -> None:
    left, right = files(folder, "image_0"), files(folder, "image_1")
    for i in frames:
        a, b = left[i].read_bytes(), right[i].read_bytes()
        left[i].write_bytes(b)
        right[i].write_bytes(a)


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (range(13, 20), "frames 13 to 19 (000013.png to 000019.png) of 20"),
        (range(7), "frames 0 to 6 (000000.png to 000006.png) of 20"),
        (range(7, 13), "frames 7 to 12 (000007.png to 000012.png) of 20"),
        (range(19, 20), "frame 19 (000019.png) of 20"),
    ],
)
def test_the_frames_in_which_left_and_right_are_exchanged_are_named(pair: Path, frames: range, words: str) -> None:
    exchange(pair, frames)
    [found] = messages(pair)
    assert found.startswith(f"error {pair / 'image_1'}: left and right images are swapped in {words}")
    assert "exchange the files of these frames" in found


def test_preprocess_refuses_them(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    exchange(pair, range(12, 20))
    assert main(["preprocess", str(pair), str(tmp_path / "seqs"), "--quiet"]) == 1
    error = capsys.readouterr().err
    assert "swapped in frames 12 to 19" in error and "unexpected" not in error


def test_before_a_run_more_frames_are_looked_at(town_stereo: Path, tmp_path: Path) -> None:
    """An exchange in 16 of 112 frames lies between two of the eight that inspect decodes (one in 16)."""
    from maslam.frontend.datasets import open_dataset
    from maslam.tools.checks.findings import look_at_sample

    folder = tmp_path / "long"
    shutil.copytree(town_stereo / "agent_00", folder)
    for side in ("image_0", "image_1"):
        paths = files(folder, side)
        for i in range(20, 400):
            (folder / side / f"{i:06d}.png").symlink_to(paths[i % 20])
    for name in ("times.txt", "poses.txt"):
        (folder / name).unlink()
    for i in range(63, 113):  # inspect decodes frames 57 and 114
        a, b = (folder / side / f"{i:06d}.png" for side in ("image_0", "image_1"))
        a_from, b_from = a.readlink(), b.readlink()
        a.unlink()
        b.unlink()
        a.symlink_to(b_from)
        b.symlink_to(a_from)
    [sequence] = open_dataset(folder).sequences
    found = [p.message for p in look_at_sample(sequence).problems if "swapped" in p.message]
    assert len(found) == 1 and "in frames 63 to 112 (" in found[0]


def test_fog_is_seen_through_and_flat_pictures_say_nothing(pair: Path) -> None:
    rng = np.random.default_rng(0)
    for side in ("image_0", "image_1"):
        for path in files(pair, side):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(np.float64)
            fog = np.clip(180 + 0.2 * (image - 128) + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8)
            assert cv2.imwrite(str(path), fog)
    assert not [message for message in messages(pair) if "swapped" in message]
    exchange(pair, range(13, 20))
    assert any("swapped in frames 13 to 19" in message for message in messages(pair))
    for side in ("image_0", "image_1"):
        for path in files(pair, side):
            flat = np.clip(128 + rng.normal(0, 3, (180, 320)), 0, 255).astype(np.uint8)
            assert cv2.imwrite(str(path), flat)
    assert not [message for message in messages(pair) if "swapped" in message]


def test_disparities_that_pass_through_zero_are_no_exchange(pair: Path) -> None:
    """A right camera turned outwards: points lie left of their place near a wall and right of it far from one."""
    for k, path in enumerate(files(pair, "image_1")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert cv2.imwrite(str(path), np.roll(image, 2 * k, axis=1))
    found = [message for message in messages(pair) if "swapped in frames" in message]
    assert all(message.startswith("warning") and "turned against its calibration?" in message for message in found)
