"""Numbered names with holes: what is missing is named, and takes its time; numbers that are a choice have no holes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_makers import HEIGHT, WIDTH, own_camera, write_images

from maslam.frontend.datasets import Severity, open_dataset
from maslam.frontend.datasets.base import ImageSequence
from maslam.frontend.datasets.numbering import missing_images


def folder_of(folder: Path, names: list[str], camera: str = "rate_hz: 4\n") -> ImageSequence:
    write_images(folder, names, np.zeros((len(names), HEIGHT, WIDTH), np.uint8))
    (folder / "camera.yaml").write_text(own_camera(camera))
    [sequence] = open_dataset(folder).sequences
    return sequence


def test_a_missing_image_is_named_and_takes_its_time(tmp_path: Path) -> None:
    numbers = [k for k in range(12) if k not in (5, 8, 9)]
    sequence = folder_of(tmp_path, [f"{k:06d}.png" for k in numbers])
    np.testing.assert_array_equal(sequence.stamps_ns, np.array(numbers) * 250_000_000)
    (problem,) = sequence.problems
    assert problem.severity is Severity.WARNING and "\n" not in problem.message
    assert "3 images missing by the numbers in the file names: 000005, 000008 to 000009" in problem.message
    assert [(m.after, m.first, m.last, m.count) for m in sequence.missing] == [
        (4, "000005", "000005", 1),
        (6, "000008", "000009", 2),
    ]


@pytest.mark.parametrize("names", [
    [f"{k:06d}" for k in range(100, 120, 2)],
    [f"{k}" for k in range(7, 30)],
    [f"left_{k:04d}_rect" for k in range(3, 60, 5)],
    ["a", "b", "c", "d"],
    ["3", "17", "18", "40", "95"],
    ["2", "5", "7", "9", "11"],
    ["1403715274250", "1403715274300", "1403715274450", "1403715274500"],
])  # fmt: skip
def test_steps_of_any_size_from_anywhere_and_chosen_images_miss_nothing(tmp_path: Path, names: list[str]) -> None:
    """Every second image, an excerpt, names without numbers, a choice, steps that do not fit each other, times."""
    sequence = folder_of(tmp_path, [f"{name}.png" for name in names])
    assert sequence.missing == () and sequence.problems == ()
    if len(names[0]) < 13:
        np.testing.assert_array_equal(sequence.stamps_ns, np.arange(len(names)) * 250_000_000)


def test_holes_of_every_second_image_and_of_names_with_text(tmp_path: Path) -> None:
    every_second = folder_of(tmp_path / "second", [f"{k}.png" for k in (8, 10, 12, 18, 20, 22)])
    np.testing.assert_array_equal(every_second.stamps_ns, np.array([0, 1, 2, 5, 6, 7]) * 250_000_000)
    assert [str(m) for m in every_second.missing] == ["14 to 16"]
    found = missing_images(["cam0_08_rect", "cam0_09_rect", "cam0_11_rect", "cam0_12_rect"])
    assert [str(m) for m in found] == ["cam0_10_rect"]


def test_times_that_are_listed_say_what_there_was(tmp_path: Path) -> None:
    write_images(tmp_path, ["0.png", "1.png", "2.png", "4.png"], np.zeros((4, HEIGHT, WIDTH), np.uint8))
    (tmp_path / "camera.yaml").write_text(own_camera(""))
    (tmp_path / "times.txt").write_text("0\n0.1\n0.2\n0.3\n")
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_array_equal(sequence.stamps_ns, np.arange(4) * 100_000_000)
    assert sequence.missing == () and sequence.problems == ()
