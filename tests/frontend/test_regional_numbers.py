"""Numbers, dates and times of day as spreadsheets of several countries write them are the same numbers and times."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from dataset_makers import COUNT, make_scene, numbered, own_camera, quaternion_wxyz, write_images

from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.files.pose_table import read_poses
from maslam.frontend.files.time_units import NotATime, parse_times

SCENE = make_scene(step_ns=100_000_000)


def opened(folder: Path, name: str, text: str) -> ImageSequence:
    write_images(folder, numbered(), SCENE.images)
    (folder / "camera.yaml").write_text(own_camera())
    (folder / name).write_text(text)
    return open_dataset(folder).sequences[0]


@pytest.mark.parametrize("mark", [";", "\t", " "], ids=["semicolon", "tab", "blank"])
@pytest.mark.parametrize("head", [True, False], ids=["headed", "bare"])
def test_decimal_commas_where_other_marks_separate(tmp_path: Path, mark: str, head: bool) -> None:
    rows = []
    for k, pose in enumerate(SCENE.poses):
        w, x, y, z = quaternion_wxyz(pose[:3, :3])
        rows.append(mark.join(f"{v:.9f}".replace(".", ",") for v in (k / 10, *pose[:3, 3], x, y, z, w)))
    names = mark.join(("time", "x", "y", "z", "qx", "qy", "qz", "qw"))
    (tmp_path / "gt.csv").write_text("\n".join([names, *rows] if head else rows) + "\n")
    found = read_poses(tmp_path / "gt.csv")
    np.testing.assert_allclose(found.poses, SCENE.poses, atol=1e-8)
    assert found.stamps_ns is not None and found.stamps_ns.tolist() == [k * 100_000_000 for k in range(COUNT)]


def test_commas_still_separate_where_nothing_else_does(tmp_path: Path) -> None:
    rows = "".join(f"{k},0,{k},0,0,0,0,1\n" for k in range(COUNT))
    (tmp_path / "gt.csv").write_text(rows)
    assert read_poses(tmp_path / "gt.csv").poses[:, 1, 3].tolist() == list(range(COUNT))


@pytest.mark.parametrize("form", ["%d.%m.%Y %H:%M:%S", "%Y/%m/%d %H:%M:%S", "%Y-%m-%dT%H:%M:%S"])
@pytest.mark.parametrize("mark", [";", "\t"], ids=["semicolon", "tab"])
def test_dates_in_other_orders_are_the_same_times(tmp_path: Path, form: str, mark: str) -> None:
    day = datetime(2011, 9, 26, 23, 59, 59, tzinfo=UTC)
    rows = [f"{day.strftime(form)}.{k}{mark}{name}\n" for k, name in enumerate(numbered())]
    sequence = opened(tmp_path, "times.csv", f"time{mark}file\n" + "".join(rows))
    start = round(day.timestamp()) * 10**9
    assert sequence.stamps_ns.tolist() == [start + k * 100_000_000 for k in range(COUNT)]
    assert sequence.problems == ()


def test_times_of_day_go_on_over_midnight_and_are_said(tmp_path: Path) -> None:
    rows = [f"23:59:59.{5 + 2 * k}\n" if k < 3 else f"0:00:00.{2 * k - 5}\n" for k in range(COUNT)]
    sequence = opened(tmp_path, "times.txt", "".join(rows))
    start = 86399_500_000_000
    assert sequence.stamps_ns.tolist() == [start + k * 200_000_000 for k in range(COUNT)]
    [problem] = sequence.problems
    assert "times of day without a date" in problem.message


@pytest.mark.parametrize("text", ["24:00:00", "12:60:00", "12:00", "noon"])
def test_no_time_of_day_is_none(text: str) -> None:
    with pytest.raises(NotATime):
        parse_times(["12:00:00", text])


@pytest.mark.parametrize(
    "title", ["ground truth of run 7", "Exported by a program, version 2.1"], ids=["words", "commas"]
)
@pytest.mark.parametrize("mark", [" ", ",", ";"], ids=["blank", "comma", "semicolon"])
def test_a_title_is_no_row_of_the_table(tmp_path: Path, title: str, mark: str) -> None:
    rows = "".join(mark.join(f"{v}" for v in (k / 10, k, 0, 0, 0, 0, 0, 1)) + "\n" for k in range(COUNT))
    (tmp_path / "gt.txt").write_text(f"{title}\n{rows}")
    found = read_poses(tmp_path / "gt.txt")
    assert found.poses[:, 0, 3].tolist() == list(range(COUNT))
    assert found.stamps_ns is not None and found.stamps_ns[1] == 100_000_000


def test_a_heading_may_be_separated_otherwise_than_its_columns(tmp_path: Path) -> None:
    rows = "".join(f"{k / 10},0,0,0,1,{k},0,0\n" for k in range(COUNT))
    (tmp_path / "gt.csv").write_text("time qx qy qz qw x y z\n" + rows)
    assert read_poses(tmp_path / "gt.csv").poses[:, 0, 3].tolist() == list(range(COUNT))


@pytest.mark.parametrize(
    ("head", "unit_ns"), [("timestamp [us]", 1_000), ("time in ns", 1), ("recorded on monday", 10**9)]
)
def test_a_heading_of_several_words_over_one_column_is_whole(tmp_path: Path, head: str, unit_ns: int) -> None:
    rows = "".join(f"{100_000_000 * (k + 7) / unit_ns:.9g}\n" for k in range(COUNT))
    sequence = opened(tmp_path, "times.txt", f"{head}\n{rows}")
    assert sequence.stamps_ns.tolist() == [(k + 7) * 100_000_000 for k in range(COUNT)]
    assert sequence.problems == ()


def test_more_words_than_columns_are_no_error_of_the_program(tmp_path: Path) -> None:
    rows = "".join(f"min_keyframes: {k / 10}\n" for k in range(COUNT))
    sequence = opened(tmp_path, "times.txt", "odometry:\n" + rows)
    assert sequence.stamps_ns.tolist() == [k * 100_000_000 for k in range(COUNT)]
