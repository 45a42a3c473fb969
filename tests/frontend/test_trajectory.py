"""Trajectories, their TUM and KITTI files and the time stamps in them."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from maslam.backend.geometry import se3_exp
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.timestamps import decimal_ns, read_stamps, seconds_text
from maslam.frontend.files.trajectory import Trajectory, read_kitti_poses, read_tum, write_kitti_poses, write_tum


def make_trajectory(count: int = 50, seed: int = 0) -> Trajectory:
    rng = np.random.default_rng(seed)
    stamps = 1403715274312143087 + np.cumsum(rng.integers(1, 10**8, count))
    return Trajectory(stamps, se3_exp(rng.normal(size=(count, 6)) * [100, 100, 100, 2, 2, 2]))


def test_tum_round_trip(tmp_path: Path) -> None:
    trajectory = make_trajectory()
    write_tum(tmp_path / "t.tum", trajectory)
    read = read_tum(tmp_path / "t.tum")
    np.testing.assert_array_equal(read.stamps_ns, trajectory.stamps_ns)
    np.testing.assert_allclose(read.poses, trajectory.poses, atol=3e-9)
    empty = Trajectory(np.zeros(0, np.int64), np.zeros((0, 4, 4)))
    write_tum(tmp_path / "e.tum", empty)
    assert len(read_tum(tmp_path / "e.tum")) == 0


def test_a_tum_line_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    # A quarter turn about z takes x to y.
    path.write_text("# time tx ty tz qx qy qz qw\n1403715274.312143087 1 2 3 0 0 0.70710678 0.70710678\n")
    trajectory = read_tum(path)
    assert trajectory.stamps_ns.tolist() == [1403715274312143087]
    np.testing.assert_allclose(trajectory.poses[0] @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-7)
    write_tum(path, trajectory)
    assert (
        path.read_text()
        == "1403715274.312143087 1.000000000 2.000000000 3.000000000 0.000000000 0.000000000 0.707106781 0.707106781\n"
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 2 3\n", r"t.tum:1: a TUM line .* has 8 numbers, found 3"),
        (
            "0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n",
            r"t.tum:2: time does not go on, but from 0.000000000 s to 0.000000000 s",
        ),
        ("# x\n5 0 0 0 0 0 0 1\n4 0 0 0 0 0 0 1\n", r"t.tum:3: time does not go on"),
        ("0 0 0 0 1 1 1 1\n", r"t.tum:1: the quaternion's length is 2.000, expected 1"),
        ("0 0 0 0 0 0 0 x\n", r"t.tum:1: not a number: 'x'"),
    ],
)
def test_broken_tum_files(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "t.tum").write_text(text)
    with pytest.raises(FrontendError, match=message):
        read_tum(tmp_path / "t.tum")


def test_kitti_round_trip_and_leading_time(tmp_path: Path) -> None:
    trajectory = make_trajectory()
    write_kitti_poses(tmp_path / "p.txt", trajectory.poses)
    times, poses = read_kitti_poses(tmp_path / "p.txt")
    assert times is None
    np.testing.assert_allclose(poses, trajectory.poses, atol=1e-9)
    timed = "".join(f"{0.1 * i} {line}\n" for i, line in enumerate((tmp_path / "p.txt").read_text().splitlines()))
    (tmp_path / "timed.txt").write_text(timed)
    times, poses = read_kitti_poses(tmp_path / "timed.txt")
    np.testing.assert_allclose(times, 0.1 * np.arange(50))
    np.testing.assert_allclose(poses, trajectory.poses, atol=1e-9)


def test_kitti_rotations_of_few_digits_become_exact(tmp_path: Path) -> None:
    trajectory = make_trajectory()
    np.savetxt(tmp_path / "p.txt", trajectory.poses[:, :3].reshape(-1, 12), fmt="%.5f")
    _, poses = read_kitti_poses(tmp_path / "p.txt")
    gram = poses[:, :3, :3] @ np.swapaxes(poses[:, :3, :3], 1, 2)
    np.testing.assert_allclose(gram, np.tile(np.eye(3), (50, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(poses, trajectory.poses, atol=2e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"p.txt: no poses"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 0 0 1 0 0 0 0 1\n", r"p.txt:2: a KITTI pose .* has 12 numbers, found 11"),
        ("1 0 0 0 0 1 0 0 0 0 -1 0\n", r"p.txt:1: the 3x3 part of the pose is not a rotation"),
        ("\n2 0 0 0 0 1 0 0 0 0 1 0\n", r"p.txt:2: the 3x3 part of the pose is not a rotation"),
    ],
)
def test_broken_kitti_files(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "p.txt").write_text(text)
    with pytest.raises(FrontendError, match=message):
        read_kitti_poses(tmp_path / "p.txt")


def brute_nearest(stamps: list[int], wanted: int, tolerance: int) -> int:
    gaps = [abs(stamp - wanted) for stamp in stamps]
    return gaps.index(min(gaps)) if gaps and min(gaps) <= tolerance else -1


@settings(max_examples=200, deadline=None)
@given(st.sets(st.integers(-50, 50), max_size=12), st.lists(st.integers(-60, 60), max_size=8), st.integers(0, 30))
def test_nearest_is_the_nearest(stamps: set[int], wanted: list[int], tolerance: int) -> None:
    ordered = sorted(stamps)
    trajectory = Trajectory(np.array(ordered, np.int64), np.tile(np.eye(4), (len(ordered), 1, 1)))
    found = trajectory.nearest(np.array(wanted, np.int64), tolerance)
    assert found.tolist() == [brute_nearest(ordered, w, tolerance) for w in wanted]


def test_a_trajectory_that_contradicts_itself_cannot_be_made() -> None:
    with pytest.raises(ValueError, match="2 time stamps but poses"):
        Trajectory(np.array([0, 1]), np.zeros((1, 4, 4)))
    with pytest.raises(ValueError, match="ascending"):
        Trajectory(np.array([1, 1]), np.tile(np.eye(4), (2, 1, 1)))


# ---- time stamps


@settings(max_examples=300, deadline=None)
@given(st.integers(1 - 2**63, 2**63 - 1))
def test_every_nanosecond_survives_text(stamp_ns: int) -> None:
    assert decimal_ns(seconds_text(stamp_ns)) == stamp_ns


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("0", 0),
        ("1.", 10**9),
        ("-0.5", -500_000_000),
        ("1.0000000019", 1_000_000_001),
        ("1.000000e-01", 100_000_000),
        ("+2e0", 2 * 10**9),
        (".25", 250_000_000),
    ],
)
def test_seconds_as_written(text: str, stamp_ns: int) -> None:
    assert decimal_ns(text) == stamp_ns


@pytest.mark.parametrize("text", ["nan", "inf", "1,5", "one", "1_0", "", "9" * 11, "1e30", "1e308"])
def test_no_times(text: str) -> None:
    with pytest.raises(ValueError, match=r"finite|years"):
        decimal_ns(text)


def test_stamps_of_a_file(tmp_path: Path) -> None:
    path = tmp_path / "times.txt"
    path.write_text("# seconds\n0.1\n\n1403715274.312143104 left.png\n")
    assert read_stamps(path).tolist() == [100_000_000, 1403715274312143104]
    path.write_text("1403715274312143104,a.png\n")
    assert read_stamps(path, nanoseconds=True).tolist() == [1403715274312143104]
    with pytest.raises(FrontendError, match="cannot be read"):
        read_stamps(tmp_path / "none")


def test_evo_reads_our_tum_files(tmp_path: Path) -> None:
    pytest.importorskip("evo", reason="the extra `evo` is not installed")
    from evo.tools import file_interface

    trajectory = make_trajectory()
    write_tum(tmp_path / "t.tum", trajectory)
    theirs = file_interface.read_tum_trajectory_file(tmp_path / "t.tum")
    np.testing.assert_allclose(np.array(theirs.poses_se3), trajectory.poses, atol=1e-8)


def test_importing_costs_no_image_library() -> None:
    """Agents read trajectories and VO files without decoding anything."""
    heavy = "{'cv2', 'numba', 'torch'}"
    code = (
        "import sys, maslam.frontend.files.trajectory, maslam.frontend.files.vo_files;"
        f"sys.exit(bool({heavy} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
