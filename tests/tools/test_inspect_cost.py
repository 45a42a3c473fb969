"""What ``maslam inspect`` costs: it opens a sample of the images, however many there are, and brings no compiler."""

from __future__ import annotations

import os
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import cv2
import numpy as np
import pytest

from maslam.frontend.datasets.images import list_images, not_there
from maslam.frontend.datasets.orb_points import find_points, match_points
from maslam.tools.inspection.command import inspect_dataset

RNG = np.random.default_rng(4)
MANY, FEW = 1000, 200
KINDS = ("images", "kitti", "tum")


class _Heard:
    """What Python opens and lists below ``folder``, by event, while there is one; an audit hook cannot be removed."""

    folder: str = ""
    counts: ClassVar[Counter[str]] = Counter()

    @classmethod
    def hear(cls, event: str, arguments: tuple[Any, ...]) -> None:
        if cls.folder and event in ("open", "os.scandir", "os.listdir") and str(arguments[0]).startswith(cls.folder):
            cls.counts[event] += 1


sys.addaudithook(_Heard.hear)


@contextmanager
def heard(folder: Path) -> Iterator[Counter[str]]:
    _Heard.folder, _Heard.counts = str(folder), Counter()
    try:
        yield _Heard.counts
    finally:
        _Heard.folder = ""


def linked(folder: Path, names: list[str]) -> None:
    """Images of 8 different contents, by hard links: as many files as wished for in no time. Neighbours differ."""
    folder.mkdir(parents=True)
    for i, name in enumerate(names):
        if i < 8:
            cv2.imwrite(str(folder / name), RNG.integers(0, 255, (64, 96)).astype(np.uint8))
        else:
            os.link(folder / names[i % 8], folder / name)


def write(kind: str, folder: Path, count: int) -> None:
    plain = [f"{i:06d}.png" for i in range(count)]
    stamps = [f"{1_300_000_000 + i / 30:.6f}" for i in range(count)]
    camera = "fx: 80\nfy: 80\ncx: 48\ncy: 32\nwidth: 96\nheight: 64\n"
    if kind == "images":
        linked(folder / "images", plain)
        (folder / "camera.yaml").write_text(camera + "rate_hz: 10\n")
    elif kind == "kitti":
        linked(folder / "image_0", plain)
        linked(folder / "image_1", plain)
        (folder / "calib.txt").write_text("P0: 80 0 48 0 0 80 32 0 0 0 1 0\nP1: 80 0 48 -20 0 80 32 0 0 0 1 0\n")
        (folder / "times.txt").write_text("".join(f"{i / 10}\n" for i in range(count)))
    else:
        for what in ("rgb", "depth"):
            linked(folder / what, [f"{stamp}.png" for stamp in stamps])
            (folder / f"{what}.txt").write_text("".join(f"{stamp} {what}/{stamp}.png\n" for stamp in stamps))
        (folder / "camera.yaml").write_text(camera)


@pytest.mark.parametrize("kind", KINDS)
def test_more_images_are_no_more_files_opened_and_no_more_folders_listed(kind: str, tmp_path: Path) -> None:
    opened = {}
    for count in (FEW, MANY):
        write(kind, tmp_path / str(count), count)
        with heard(tmp_path / str(count)) as counts:
            report = inspect_dataset(tmp_path / str(count))
        assert [sequence.frames for sequence in report.sequences] == [count] and counts["open"] > 0
        opened[count] = Counter(counts)
    assert opened[MANY]["open"] <= opened[FEW]["open"] + 2  # a sample may fall upon links to one file more or less
    assert opened[MANY]["os.listdir"] + opened[MANY]["os.scandir"] <= 60 and opened[MANY] == opened[FEW]


def test_a_folder_of_images_needs_no_compiler(tmp_path: Path) -> None:
    write("images", tmp_path / "drive", 20)
    code = f"from maslam.tools.cli import main; import sys; main(['inspect', {str(tmp_path / 'drive')!r}]); "
    code += "print([name for name in ('numba', 'onnxruntime', 'scipy', 'pycolmap') if name in sys.modules])"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.splitlines()[-1] == "[]"


def test_missing_files_are_found_among_many(tmp_path: Path) -> None:
    names = [f"{i}.png" for i in range(30)]
    linked(tmp_path / "a", names)
    (tmp_path / "a" / "7.png").unlink()
    (tmp_path / "a" / "9.png").unlink()
    (tmp_path / "a" / "9.png").mkdir()
    (tmp_path / "a" / "11.png").unlink()
    (tmp_path / "a" / "11.png").symlink_to("nowhere.png")
    (tmp_path / "a" / "12.png").unlink()
    (tmp_path / "a" / "12.png").symlink_to("13.png")
    gone = [tmp_path / "b" / "0.png", *(tmp_path / "a" / f"{i}.png" for i in (7, 9, 11))]
    wanted = [gone[0], *(tmp_path / "a" / name for name in names), tmp_path / "a" / "sub" / ".." / "3.png"]
    assert [path for path in wanted if not path.is_file()] == not_there(wanted)
    assert not_there(wanted)[:4] == gone and [p.name for p in list_images(tmp_path / "a")][7:10] == [
        "8.png",
        "10.png",
        "12.png",
    ]


@pytest.mark.parametrize("repeated", [False, True], ids=["texture", "the same patch over and over"])
def test_matches_are_those_of_opencvs_matcher(repeated: bool) -> None:
    scene = cv2.GaussianBlur(RNG.integers(0, 255, (240, 400)).astype(np.uint8), (0, 0), 2)
    scene = np.asarray(cv2.normalize(scene, None, 0, 255, cv2.NORM_MINMAX))
    if repeated:
        scene = np.tile(scene[:60, :50], (4, 8))
    images = (scene[:, :320].copy(), scene[:, 9:329].copy())
    orb = cv2.ORB.create(nfeatures=500)
    (left, a), (right, b) = (orb.detectAndCompute(image, None) for image in images)
    wanted = [m for m in cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(a, b) if m.distance <= 40]
    found = match_points(find_points(images[0], 500), find_points(images[1], 500), 40)
    assert len(wanted) > 20 and found.features == len(left)
    assert found.left_uv.tolist() == [list(left[m.queryIdx].pt) for m in wanted]
    assert found.right_uv.tolist() == [list(right[m.trainIdx].pt) for m in wanted]
