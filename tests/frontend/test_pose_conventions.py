"""Quaternions with either end real, and degrees in the place of metres, are told by what a path can be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_makers import COUNT, Scene, make_scene, own_camera, seconds, write_images

from maslam.backend.geometry import Array, quat_wxyz_from_rotation, se3, so3_exp
from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.pose_table import read_poses

STEP_S = 0.1
BODY_CAMERA = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])


def drive(count: int = 80) -> Array:
    """A camera that looks ahead on a winding road of the plane, ``T_W_C`` ``(count, 4, 4)`` in metres."""
    angles = np.cos(np.arange(count) / 12.0)
    steps = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    centres = np.cumsum(steps, axis=0) - steps / 2
    return np.array([se3(so3_exp([0, 0, a]) @ BODY_CAMERA, c) for a, c in zip(angles, centres, strict=True)])


def in_axes_of_the_first(poses: Array) -> Array:
    return np.linalg.inv(poses[0]) @ poses


def sideways(poses: Array) -> Array:
    """A camera on the vehicle's left."""
    return poses @ se3(so3_exp([0.0, -np.pi / 2, 0.0]), [0.0, 0.0, 0.0])


def by_hand(count: int = 80) -> Array:
    """Turns and steps that have nothing to do with each other."""
    rng = np.random.default_rng(3)
    turns, steps = np.cumsum(rng.normal(0, 0.2, (count, 3)), axis=0), np.cumsum(rng.normal(0, 0.1, (count, 3)), axis=0)
    return np.array([se3(so3_exp(w), c) for w, c in zip(turns, steps, strict=True)])


def write(path: Path, poses: Array, wxyz: bool, mark: str = " ", head: str = "", start_s: int = 100) -> Path:
    q = quat_wxyz_from_rotation(poses[:, :3, :3])
    q = q if wxyz else q[:, [1, 2, 3, 0]]
    rows = np.column_stack([start_s + STEP_S * np.arange(len(poses)), poses[:, :3, 3], q])
    path.write_text(head + "".join(mark.join(f"{v:.9f}" for v in row) + "\n" for row in rows))
    return path


PATHS = {"ahead": drive(), "first": in_axes_of_the_first(drive()), "left": sideways(drive()), "by hand": by_hand()}


@pytest.mark.parametrize("kind", ["ahead", "first", "left"])
def test_qw_in_front_is_seen_by_the_path(tmp_path: Path, kind: str) -> None:
    poses = PATHS[kind]
    found = read_poses(write(tmp_path / "gt.txt", poses, wxyz=True))
    np.testing.assert_allclose(found.poses, poses, atol=1e-6)
    [note] = found.notes
    assert "follow the path as qw qx qy qz" in note and "# time tx ty tz qw qx qy qz" in note


def test_qw_at_the_end_is_seen_where_it_stands_in_front_as_a_rule(tmp_path: Path) -> None:
    path = write(tmp_path / "poses.csv", PATHS["left"], wxyz=False, mark=",")
    for expected in (True, False):
        found = read_poses(path, wxyz=expected)
        np.testing.assert_allclose(found.poses, PATHS["left"], atol=1e-6)
        assert len(found.notes) == expected and all("follow the path as qx qy qz qw" in note for note in found.notes)


def turned_at_first(degrees: float) -> Array:
    """A straight path of a camera that wavers, from a pose turned so far about an axis of no meaning."""
    axis = np.radians(degrees) * np.array([0.48, 0.6, 0.64])
    wavers = [so3_exp([0.02 * np.sin(k), 0.03 * np.sin(0.7 * k), 0.0]) for k in range(40)]
    return np.array([se3(so3_exp(axis) @ R, [0.0, 0.0, 0.5 * k]) for k, R in enumerate(wavers)])


@pytest.mark.parametrize("wxyz", [True, False])
@pytest.mark.parametrize("rows", ["hand", "straight"])
def test_a_start_at_the_identity_says_which_end_is_real_where_the_path_does_not(
    tmp_path: Path, rows: str, wxyz: bool
) -> None:
    poses = in_axes_of_the_first(by_hand()) if rows == "hand" else turned_at_first(0.0)
    path = write(tmp_path / "gt.txt", poses, wxyz)
    for expected in (True, False):
        found = read_poses(path, wxyz=expected)
        np.testing.assert_allclose(found.poses, poses, atol=1e-6)
        order = "qw qx qy qz" if wxyz else "qx qy qz qw"
        assert len(found.notes) == (wxyz != expected)
        assert all(f"0 degrees from the identity as {order}, 180 as" in note for note in found.notes)


def test_a_start_near_the_identity_in_the_other_order_is_a_doubt(tmp_path: Path) -> None:
    poses = turned_at_first(20.0)
    found = read_poses(write(tmp_path / "gt.txt", poses, wxyz=True))
    assert not np.allclose(found.poses, poses, atol=0.1)
    [note] = found.notes
    assert "20 degrees from the identity as qw qx qy qz, 167 as qx qy qz qw, as which it is taken" in note
    assert "'# time tx ty tz qw qx qy qz' says otherwise" in note
    for sound in (turned_at_first(90.0), poses):
        assert read_poses(write(tmp_path / "gt.txt", sound, wxyz=False)).notes == ()


def test_a_start_half_a_turn_from_the_identity_counts_less_than_the_path(tmp_path: Path) -> None:
    """Of a world whose y points up and z back; its first quaternion is ``1 0 0 0`` with qw at the end."""
    flipped = se3(np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ in_axes_of_the_first(PATHS["ahead"])
    found = read_poses(write(tmp_path / "gt.txt", flipped, wxyz=False))
    np.testing.assert_allclose(found.poses, flipped, atol=1e-6)
    assert found.notes == ()


def bending_little(count: int = 40) -> Array:
    """A camera that looks ahead on a path which bends by 4 degrees to the right, from the identity on."""
    angles = np.linspace(0.0, np.radians(4.0), count)
    steps = np.column_stack([np.sin(angles), 0 * angles, np.cos(angles)])
    centres = np.cumsum(steps, axis=0) - steps[0]
    return np.array([se3(so3_exp([0, a, 0]), c) for a, c in zip(angles, centres, strict=True)])


@pytest.mark.parametrize("begun_deg", [0.0, 6.0])
@pytest.mark.parametrize("wxyz", [True, False])
def test_near_the_identity_a_little_bend_is_enough(tmp_path: Path, begun_deg: float, wxyz: bool) -> None:
    """Half a turn about x, as OpenGL's axes have it, reads as near the identity in the other order; turns are then
    mirrored."""
    poses = se3(so3_exp([0.0, np.radians(begun_deg), 0.0]), np.zeros(3)) @ bending_little()
    poses = poses if wxyz else poses @ np.diag([1.0, -1.0, -1.0, 1.0])
    found = read_poses(write(tmp_path / "gt.txt", poses, wxyz))
    np.testing.assert_allclose(found.poses, poses, atol=1e-6)
    [note] = found.notes
    assert ("follow the path as qw qx qy qz" if wxyz else "180 as qx qy qz qw, as which it is taken") in note


def test_a_straight_way_ahead_from_half_a_turn_about_x_is_not_one_backwards_from_the_identity(tmp_path: Path) -> None:
    """A world whose y points up and z back, as of many simulators, and a camera that looks along -z and goes there."""
    ahead = np.array([se3(np.eye(3), [0.0, 0.0, 0.5 * k]) for k in range(40)])
    poses = se3(np.diag([1.0, -1.0, -1.0]), np.zeros(3)) @ ahead
    found = read_poses(write(tmp_path / "gt.txt", poses, wxyz=False))
    np.testing.assert_allclose(found.poses, poses, atol=1e-6)
    [note] = found.notes
    assert "as which it is taken" in note


@pytest.mark.parametrize("kind", PATHS)
@pytest.mark.parametrize("head", ["", "# time tx ty tz qx qy qz qw\n"])
def test_sound_files_are_read_as_they_are(tmp_path: Path, kind: str, head: str) -> None:
    path = write(tmp_path / "gt.txt", PATHS[kind], wxyz=False, head=head)
    found = read_poses(path)
    np.testing.assert_allclose(found.poses, PATHS[kind], atol=1e-6)
    assert found.notes == ()


def test_a_straight_path_tells_nothing(tmp_path: Path) -> None:
    straight = np.array([se3(so3_exp([0.0, 0.01, 0.0]), [0.0, 0.0, 0.5 * k]) for k in range(40)])
    straight = straight @ se3(so3_exp([0.0, np.pi / 2, 0.0]), np.zeros(3))
    assert read_poses(write(tmp_path / "gt.txt", straight, wxyz=True)).notes == ()


def test_a_heading_is_believed_and_doubted(tmp_path: Path) -> None:
    path = write(tmp_path / "gt.txt", PATHS["ahead"], wxyz=True, head="# time tx ty tz qx qy qz qw\n")
    assert not np.allclose(read_poses(path).poses, PATHS["ahead"], atol=0.1)
    assert "is the heading right?" in read_poses(path).notes[0]


def degrees(poses: Array, lat: float = 49.01, lon: float = 8.43) -> Array:
    """The same path as latitude, longitude and altitude in the place of x, y, z."""
    out = poses.copy()
    x, y, z = poses[:, :3, 3].T
    out[:, :3, 3] = np.column_stack([lat + y / 111195.0, lon + x / 111195.0 / np.cos(np.radians(lat)), 115.0 + z])
    return out


@pytest.mark.parametrize("swapped", [False, True])
def test_degrees_are_no_metres(tmp_path: Path, swapped: bool) -> None:
    poses = degrees(drive(), lat=49.01, lon=-122.3)
    poses[:, :2, 3] = poses[:, [1, 0], 3] if swapped else poses[:, :2, 3]
    path = write(tmp_path / "gt.txt", poses, wxyz=False)
    with pytest.raises(FrontendError, match=r"gt\.txt: x and y look like degrees of latitude and longitude.*gps"):
        read_poses(path)


def test_what_stands_or_creeps_is_in_metres(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    standing = np.tile(se3(np.eye(3), [49.01, 8.43, 1.0]), (80, 1, 1))
    standing[:, :3, 3] += rng.normal(0.0, 1e-5, (80, 3))
    slow = np.array([se3(np.eye(3), [12.0 + 0.001 * k, 3.0, 0.0]) for k in range(80)])  # a centimetre a second
    for poses in (standing, slow, drive()):
        assert len(read_poses(write(tmp_path / "gt.txt", poses, wxyz=False)).poses) == 80


def test_the_truth_of_a_folder_is_left_out_or_put_right_with_a_warning(tmp_path: Path) -> None:
    scene = timed_scene()
    write_images(tmp_path, [f"{stamp}.png" for stamp in scene.stamps_ns], scene.images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    write(tmp_path / "groundtruth.txt", drive(), wxyz=True, start_s=1_700_000_000)
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, drive(), atol=1e-5)
    assert "groundtruth.txt: rotations follow the path as qw" in sequence.problems[0].message
    write(tmp_path / "groundtruth.txt", degrees(drive()), wxyz=False, start_s=1_700_000_000)
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.groundtruth is None
    [problem] = sequence.problems
    assert "degrees of latitude" in problem.message and "ground truth left out" in problem.message


def timed_scene() -> Scene:
    scene = make_scene(start_ns=1_700_000_000_000_000_000, step_ns=100_000_000)
    assert len(scene.images) == COUNT and seconds(int(scene.stamps_ns[1])).endswith(".100000000")
    return scene


@pytest.mark.parametrize("mark", [",", " "], ids=["comma", "blank"])
def test_euroc_columns_without_a_heading_are_no_matrices(tmp_path: Path, mark: str) -> None:
    """Time, position, ``qw qx qy qz``, velocity and two biases: 17 numbers, as a time and a 4x4 matrix have."""
    poses = PATHS["by hand"]
    rest = np.random.default_rng(2).normal(size=(len(poses), 9))
    q = quat_wxyz_from_rotation(poses[:, :3, :3])
    rows = np.column_stack([100 + STEP_S * np.arange(len(poses)), poses[:, :3, 3], q, rest])
    path = tmp_path / "data.csv"
    path.write_text("".join(mark.join(f"{v:.9f}" for v in row) + "\n" for row in rows))
    found = read_poses(path)
    np.testing.assert_allclose(found.poses, poses, atol=1e-6)
    assert "qw qx qy qz" in found.notes[0]
