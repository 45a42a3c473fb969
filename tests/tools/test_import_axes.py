"""Poses in axes that are no camera's are refused with the option that puts them right, which does."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from maslam.backend.geometry import product, quat_wxyz_from_rotation, se3, se3_inverse, so3_exp
from maslam.frontend.files.trajectory import read_kitti_poses, read_tum
from maslam.frontend.mapping.body_axes import fitting_axes
from maslam.frontend.mapping.pose_agreement import MatchedRays
from maslam.tools import cli

LIDAR = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""The camera's axes on a body that looks along x, with z up."""
MOUNTS = {
    "x points ahead, y left, z up": LIDAR,
    "x points ahead, y right, z down": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
    "x points right, y ahead, z up": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
    "x points right, y up, z behind": np.diag([1.0, -1.0, -1.0]),
    "x points left, y ahead, z down": np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]),
}


def seen(R_B_C: np.ndarray, straight: bool = False, wrong: float = 0.1) -> list[MatchedRays]:
    """Points of a room as a camera sees them on a winding path, with the body's poses: ``wrong`` of the matches are."""
    rng = np.random.default_rng(4)
    points = rng.uniform([-8, -4, 4], [8, 4, 30], (300, 3))
    found = []
    for k in range(10):
        poses = [
            se3(so3_exp([0.02 * j, 0.0 if straight else 0.15 * j, 0.01 * j]) if not straight else np.eye(3), [0, 0, j])
            for j in (0.3 * k, 0.3 * k + 1.0)
        ]
        rays = [(points - T[:3, 3]) @ T[:3, :3] for T in poses]
        ahead = (rays[0][:, 2] > 1) & (rays[1][:, 2] > 1)
        a, b = (r[ahead] / r[ahead, 2:] for r in rays)
        false = rng.random(len(b)) < wrong
        b[false, :2] = rng.uniform(-0.7, 0.7, (int(false.sum()), 2))
        bodies = [se3_inverse(product(T, se3_inverse(se3(R_B_C, np.zeros(3))))) for T in poses]
        found.append(MatchedRays(a, b, (bodies[0], bodies[1]), np.full(len(a), np.nan)))
    return found


@pytest.mark.parametrize("words", MOUNTS)
def test_each_way_of_standing_on_a_body_is_found(words: str) -> None:
    found = fitting_axes(seen(MOUNTS[words]), fx=300.0, width=400)
    assert found is not None and not found.inverted and found.share > 0.85
    assert words in found.words()
    np.testing.assert_allclose(found.R_B_C, MOUNTS[words], atol=1e-12)


def test_of_a_straight_path_the_usual_axes_come_first() -> None:
    found = fitting_axes(seen(LIDAR, straight=True), fx=300.0, width=400)
    assert found is not None and "x points ahead, y left, z up" in found.words()


def test_inverted_poses_are_told_from_turned_ones() -> None:
    inverse = [replace(one, poses=(se3_inverse(one.poses[0]), se3_inverse(one.poses[1]))) for one in seen(np.eye(3))]
    found = fitting_axes(inverse, fx=300.0, width=400)
    assert found is not None and found.inverted and found.share > 0.85 and "inverted" in found.words()


def test_a_rectified_camera_is_turned_on_its_body_likewise() -> None:
    """Poses of the rectified camera, made as if the body were the camera: ``T_W_B`` times the turn back."""
    R = so3_exp([0.05, -0.3, 0.1])
    turn = se3(R, np.zeros(3))
    turned = [
        replace(one, poses=(product(turn, one.poses[0]), product(turn, one.poses[1]))) for one in seen(LIDAR @ R.T)
    ]
    found = fitting_axes(turned, 300.0, 400, R)
    assert found is not None and found.share > 0.85
    np.testing.assert_allclose(found.R_B_C, LIDAR, atol=1e-12)


def tum(path: Path, times: np.ndarray, poses: np.ndarray) -> None:
    q = quat_wxyz_from_rotation(poses[:, :3, :3])
    np.savetxt(path, np.column_stack([times, poses[:, :3, 3], q[:, 1:], q[:, 0]]), "%.9f")


@pytest.mark.slow
def test_the_option_that_is_named_imports_what_was_refused(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = town_stereo / "agent_00"
    T, times = read_kitti_poses(source / "poses.txt")[1], np.loadtxt(source / "times.txt")
    tum(tmp_path / "lidar.txt", times, product(T, se3_inverse(se3(LIDAR, np.array([0.2, 0.0, 0.3])))))
    words = ["import", str(tmp_path / "lidar.txt"), str(source)]
    assert cli.main([*words, str(tmp_path / "refused"), "--quiet", "--rig", "mono"]) == 1
    said = capsys.readouterr().err
    assert "as poses of a body whose x points ahead, y left, z up" in said
    option = re.search(r"--T-body-camera=\S+?(?=, or)", said)
    assert option is not None
    assert cli.main([*words, str(tmp_path / "seqs"), "--quiet", "--rig", "mono", option[0]]) == 0
    [found] = (read_tum(path).poses for path in (tmp_path / "seqs").rglob("trajectory.tum"))
    relative = product(se3_inverse(T[0]), T)[-1]
    np.testing.assert_allclose(found[-1, :3, :3], relative[:3, :3], atol=1e-6)
    assert np.linalg.norm(found[-1, :3, 3] - relative[:3, 3]) < 0.4  # the place on the body is not known
