"""Input that cannot be used, through the command line: one line that names file and reason, exit code 1, nothing
half-made.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import make_scene, write_kitti, write_rendered

from maslam.tools import cli


def empty_folder(folder: Path) -> None:
    folder.mkdir()


def no_folder(folder: Path) -> None:
    del folder


def time_goes_back(folder: Path) -> None:
    write_kitti(folder, make_scene())
    times = (folder / "times.txt").read_text().splitlines()
    (folder / "times.txt").write_text("\n".join([*times[:3], times[1], *times[4:]]) + "\n")


def calibration_of_another_size(folder: Path) -> None:
    write_rendered(folder, make_scene(), "stereo")
    camera = folder / "camera.yaml"
    camera.write_text(camera.read_text().replace("width: 96", "width: 192").replace("height: 64", "height: 128"))


def missing_right_image(folder: Path) -> None:
    write_kitti(folder, make_scene())
    (folder / "image_1" / "000003.png").unlink()


def images_of_two_sizes(folder: Path) -> None:
    write_kitti(folder, make_scene())
    for i in range(2, 6):
        cv2.imwrite(str(folder / "image_0" / f"{i:06d}.png"), np.zeros((20, 30), np.uint8))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (no_folder, ["data", "no such folder"]),
        (empty_folder, ["data", "no images"]),
        (time_goes_back, ["times.txt", "back"]),
        (calibration_of_another_size, ["camera.yaml", "192x128", "96x64"]),
        (missing_right_image, ["000003.png", "right image"]),
        (images_of_two_sizes, ["000003.png", "30x20"]),
    ],
)
def test_bad_input_is_one_line(
    spoil: Callable[[Path], None], said: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spoil(tmp_path / "data")
    assert cli.main(["preprocess", str(tmp_path / "data"), str(tmp_path / "seqs"), "--quiet"]) == 1
    line = capsys.readouterr().err.strip().splitlines()[-1]
    assert line.startswith("maslam: ") and all(word in line for word in said), line
    assert not (tmp_path / "seqs" / "manifest.json").exists()
