"""A user's own posed sequence as a place-recognition set, judged against what is known of the way it was driven."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.files.trajectory import write_kitti_poses
from maslam.tools.common.errors import ToolError
from maslam.tools.place_benchmarks.public_sets import read_colour
from maslam.tools.place_benchmarks.revisits import RevisitSettings, posed_benchmark
from tests.descriptors.conftest import textured_image

LAP = 20  # frames, 2 m apart, one a second


def _drive(folder: Path, laps: int, heading_deg: float = 0.0) -> None:
    """A straight street driven from its begin ``laps`` times, turned by ``heading_deg`` the second time, in KITTI's
    layout."""
    (folder / "image_0").mkdir(parents=True)
    poses = []
    for k in range(laps * LAP):
        turned = so3_exp([0.0, np.radians(heading_deg if k >= LAP else 0.0), 0.0])
        poses.append(se3(turned, [0.0, 0.0, 2.0 * (k % LAP)]))
        cv2.imwrite(str(folder / "image_0" / f"{k:06d}.png"), textured_image(k % LAP, 48, 64))
    write_kitti_poses(folder / "poses.txt", np.stack(poses))
    (folder / "times.txt").write_text("".join(f"{k}.0\n" for k in range(laps * LAP)))
    (folder / "calib.txt").write_text("P0: 60 0 31.5 0 0 60 23.5 0 0 0 1 0\n")


def test_the_second_lap_finds_the_first(tmp_path: Path) -> None:
    _drive(tmp_path / "street", 2)
    made = posed_benchmark(tmp_path / "street", RevisitSettings(radius_m=3.0, apart_s=10.0))
    assert made.name == "street"
    assert made.barred is not None and made.ignore is not None and made.poses is not None
    assert len(made.references) == 2 * LAP
    # A query is asked only about what lies 10 s and more behind it, so the first ten frames are no queries.
    assert len(made.queries) == 2 * LAP - 10
    second = made.truth[-LAP:]
    expected = np.abs(np.arange(LAP)[:, None] - np.arange(LAP)[None]) <= 1  # 2 m on either side, but not 4
    expected &= np.arange(LAP)[:, None] + LAP - np.arange(LAP)[None] >= 10
    np.testing.assert_array_equal(second[:, :LAP], expected)
    assert not second[:, LAP:].any() and not made.truth[:-LAP].any()
    assert made.barred[-1, -11:].all() is np.bool_(False)  # ten seconds before it: allowed again
    assert made.barred[-1, -10:].all()
    assert not (made.truth & made.barred).any() and not (made.truth & made.ignore).any()
    np.testing.assert_array_equal(made.poses[0][-1], made.poses[1][-1])


def test_the_other_way_round_is_another_place(tmp_path: Path) -> None:
    _drive(tmp_path / "street", 2, heading_deg=40.0)
    with pytest.raises(ToolError, match=r"no place is visited again within 5 m and 30 degrees, 10 s or more apart"):
        posed_benchmark(tmp_path / "street", RevisitSettings(apart_s=10.0))
    made = posed_benchmark(tmp_path / "street", RevisitSettings(apart_s=10.0, angle_deg=45.0))
    assert made.truth.any(axis=1)[-LAP:].all()


def test_agents_are_asked_about_each_other(tmp_path: Path) -> None:
    for agent in ("agent_00", "agent_01"):
        _drive(tmp_path / "two" / agent, 1)
    made = posed_benchmark(tmp_path / "two", RevisitSettings(radius_m=1.0, apart_s=100.0))
    assert len(made.queries) == LAP  # those of the second agent
    np.testing.assert_array_equal(made.truth, np.eye(LAP, 2 * LAP, dtype=bool))


def test_frames_are_spread_along_the_way(tmp_path: Path) -> None:
    _drive(tmp_path / "street", 2)
    made = posed_benchmark(tmp_path / "street", RevisitSettings(apart_s=10.0, spacing_m=3.9))
    assert len(made.references) == LAP


def test_what_cannot_be_judged_is_said(tmp_path: Path) -> None:
    _drive(tmp_path / "street", 1)
    (tmp_path / "street" / "poses.txt").unlink()
    with pytest.raises(ToolError, match="no ground truth"):
        posed_benchmark(tmp_path / "street", RevisitSettings())
    with pytest.raises(ToolError, match="must be positive"):
        RevisitSettings(radius_m=0.0)


def test_colour_is_read_where_it_is_wanted(tmp_path: Path) -> None:
    bgr = np.zeros((20, 30, 3), dtype=np.uint8)
    bgr[..., 2] = 200
    cv2.imwrite(str(tmp_path / "red.png"), bgr)
    np.testing.assert_array_equal(read_colour(tmp_path / "red.png"), bgr)
