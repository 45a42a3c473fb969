"""Recordings in several files: parts that go on after each other, files compressed as a whole, bags without images."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dataset_makers import COUNT, HEIGHT, WIDTH
from recording_makers import write_ros1
from test_bags import CAMERA, SCENE, STAMPS, info, messages, only, pair_of, raw

from maslam.frontend.datasets import open_dataset
from maslam.frontend.datasets.stored_image import name_in
from maslam.frontend.errors import FrontendError


def written(tmp_path: Path, names: Sequence[str], apart_ns: int = 0) -> None:
    """Bags that go on after each other; the first one alone has camera_info, as a latched topic has."""
    for part, name in enumerate(names):
        later = [stamp + part * (COUNT * 50_000_000 + apart_ns) for stamp in STAMPS]
        pixels = SCENE.images if part % 2 == 0 else SCENE.rights
        channels = [replace(raw("/image_raw", pixels, "mono8", later), received_ns=later)]
        write_ros1(tmp_path / name, [*channels, *([info("/camera_info")] if part == 0 else [])])


@pytest.mark.parametrize(
    ("names", "name"),
    [
        (["run_8.bag", "run_9.bag", "run_10.bag"], "run"),
        (["2024-01-01-12-00-00_0.bag", "2024-01-01-12-05-00_1.bag"], "2024-01-01-12-00-00"),
    ],
)
def test_parts_of_one_recording_are_one(tmp_path: Path, names: list[str], name: str) -> None:
    written(tmp_path, names)
    (sequence,) = open_dataset(tmp_path).sequences
    assert sequence.name == name and not sequence.problems
    assert sequence.stamps_ns.tolist() == [STAMPS[0] + 50_000_000 * i for i in range(len(names) * COUNT)]
    np.testing.assert_array_equal(sequence.read_image(COUNT + 1), SCENE.rights[1])
    assert name_in(sequence.left[COUNT], tmp_path).startswith(f"{names[1]}/image_raw/")
    assert f"{len(names)} bags are read as one recording" in sequence.notes[0]


def test_bags_of_other_times_are_robots(tmp_path: Path) -> None:
    """As GrAco's, which were driven one after another."""
    written(tmp_path, ["ground-01.bag", "ground-02.bag"], apart_ns=60 * 10**9)
    (tmp_path / "ground-02.yaml").write_text(CAMERA)
    assert [s.name for s in open_dataset(tmp_path).sequences] == ["ground-01", "ground-02"]


def test_a_bag_of_another_name_that_goes_on_is_said(tmp_path: Path) -> None:
    written(tmp_path, ["drive.bag", "later.bag"])
    (tmp_path / "later.yaml").write_text(CAMERA)
    first, second = open_dataset(tmp_path).sequences
    assert not first.problems and "later.bag: begins where the bag before it ends" in messages(second)


def test_bags_of_the_same_time_are_robots_whatever_their_numbers(tmp_path: Path) -> None:
    for i in (0, 1):
        write_ros1(tmp_path / f"robot_{i}.bag", pair_of())
    assert [s.name for s in open_dataset(tmp_path).sequences] == ["robot_0", "robot_1"]


def test_a_bag_without_images_is_passed_over_beside_others(tmp_path: Path) -> None:
    write_ros1(tmp_path / "alice.bag", pair_of())
    write_ros1(tmp_path / "imu.bag", [info("/camera_info")])
    (sequence,) = open_dataset(tmp_path).sequences
    assert sequence.name == "alice" and sequence.notes == ("bags without images, not read: imu.bag",)
    with pytest.raises(FrontendError, match=r"imu\.bag: no image topic with messages; it holds /camera_info"):
        open_dataset(tmp_path / "imu.bag")


def test_a_copy_of_a_file_compressed_as_a_whole_is_said_and_goes_with_the_program(tmp_path: Path) -> None:
    sequence = only(tmp_path / "mcap_file", pair_of())
    assert "1 files compressed as a whole are unpacked to a temporary folder: 0." in sequence.notes[0]
    program = (
        "import sys, tempfile; from pathlib import Path; from maslam.frontend.datasets import open_dataset\n"
        "print(open_dataset(Path(sys.argv[1])).sequences[0].read(0).image.shape, end=' ')\n"
        "print(len(list(Path(sys.argv[2]).iterdir())))"
    )
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    run = [sys.executable, "-c", program, str(tmp_path / "mcap_file"), str(temporary)]
    done = subprocess.run(run, env={**os.environ, "TMPDIR": str(temporary)}, capture_output=True, text=True, check=True)
    assert done.stdout.strip() == f"({HEIGHT}, {WIDTH}) 1" and not list(temporary.iterdir())


def test_a_damaged_file_compressed_as_a_whole_is_named(tmp_path: Path) -> None:
    only(tmp_path / "mcap_file", pair_of())
    [file] = (tmp_path / "mcap_file").glob("*.zstd")
    file.write_bytes(file.read_bytes()[:1000])
    with pytest.raises(FrontendError, match=r"mcap\.zstd: not a whole file that zstd compressed"):
        open_dataset(tmp_path / "mcap_file")
    file.write_bytes(b"no such thing")
    with pytest.raises(FrontendError, match=r"mcap\.zstd: not a whole file that zstd compressed"):
        open_dataset(tmp_path / "mcap_file")
