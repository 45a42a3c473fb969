"""Truths with angles, with the quaternion in front, in archives and in JSON of positions and orientations: the same
trajectory where something tells the form, else refused with what the columns look like."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from dataset_makers import COUNT, make_scene, numbered, own_camera, quaternion_wxyz, seconds, write_images
from scipy.spatial.transform import Rotation
from test_pose_conventions import PATHS, drive

from maslam.backend.geometry import Array
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.pose_table import read_poses

SCENE = make_scene()
WXYZ = np.array([quaternion_wxyz(pose[:3, :3]) for pose in SCENE.poses])
XYZW = WXYZ[:, [1, 2, 3, 0]]
CENTRES = SCENE.poses[:, :3, 3]
SECONDS = SCENE.stamps_ns / 1e9


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    write_images(tmp_path, numbered(), SCENE.images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    (tmp_path / "times.txt").write_text("".join(f"{seconds(t)}\n" for t in SCENE.stamps_ns.tolist()))
    return tmp_path


def opened(folder: Path) -> tuple[ImageSequence, str]:
    [sequence] = open_dataset(folder, strict=False).sequences
    return sequence, "\n".join(problem.message for problem in sequence.problems)


def assert_true(sequence: ImageSequence) -> None:
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=1e-7)
    np.testing.assert_allclose(sequence.groundtruth.stamps_ns, SCENE.stamps_ns, atol=1000)


def rows(*columns: Array, head: str = "") -> str:
    lines = np.column_stack(columns).tolist()
    return head + "".join(" ".join(f"{v:.9f}" for v in line) + "\n" for line in lines)


# ---- archives

ARCHIVES: dict[str, tuple[dict[str, Any], str]] = {
    "poses": ({"poses": SCENE.poses}, ""),
    "T with times": ({"T": SCENE.poses, "timestamps": SECONDS}, ""),
    "c2w with nanoseconds, in another order": (
        {"c2w": SCENE.poses[::-1], "timestamps": SCENE.stamps_ns[::-1]}, "sorted by time"),
    "cam2world with the images' numbers": ({"cam2world": SCENE.poses[::-1], "ids": np.arange(COUNT)[::-1]}, ""),
    "with names": ({"poses": SCENE.poses[:, :3], "names": np.array(numbered())}, ""),
    "without a usual name": ({"arr_0": SCENE.poses, "K": np.eye(3)}, "'arr_0' is taken as the poses"),
    "rows": ({"trajectory": np.column_stack([SECONDS, CENTRES, XYZW])}, ""),
    "parts": ({"R": SCENE.poses[:, :3, :3], "t": CENTRES[:, :, None]}, ""),
    "w2c": ({"w2c": np.linalg.inv(SCENE.poses)}, "w2c map the world to the camera, and are inverted"),
}  # fmt: skip


@pytest.mark.parametrize("form", ARCHIVES)
def test_poses_in_an_archive_are_the_truth(folder: Path, form: str) -> None:
    arrays, said = ARCHIVES[form]
    np.savez(folder / "poses.npz", **arrays)
    sequence, messages = opened(folder)
    assert_true(sequence)
    assert said in messages and bool(said) == bool(messages)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"a": SCENE.poses, "b": SCENE.poses}, "which of its arrays are the poses? a (6, 4, 4), b (6, 4, 4)"),
        (
            {"extrinsics": SCENE.poses},
            "no poses among its arrays: extrinsics (6, 4, 4); one called poses or c2w (T_W_C), or",
        ),
        ({"depth": np.zeros((4, 5))}, "no poses among its arrays: depth (4, 5)"),
        ({"poses": np.array([{}], dtype=object)}, "damaged, or not such a file"),
    ],
)
def test_an_archive_without_poses_is_named(folder: Path, arrays: dict[str, Any], said: str) -> None:
    np.savez(folder / "poses.npz", **arrays)
    sequence, messages = opened(folder)
    assert sequence.groundtruth is None and f"poses.npz: {said}" in messages


def test_times_in_an_archive_are_the_images(folder: Path) -> None:
    (folder / "times.txt").unlink()
    np.savez(folder / "timestamps.npz", other=np.zeros((2, 2)), stamps=SCENE.stamps_ns)
    np.testing.assert_array_equal(opened(folder)[0].stamps_ns, SCENE.stamps_ns)


# ---- JSON


def entries(**values: Any) -> list[dict[str, Any]]:
    return [{key: np.asarray(value[i]).tolist() for key, value in values.items()} for i in range(COUNT)]


def named(array: Array, names: str) -> list[dict[str, float]]:
    return [dict(zip(names, row, strict=True)) for row in array.tolist()]


def ros() -> list[dict[str, Any]]:
    stamps = [{"secs": t // 10**9, "nsecs": t % 10**9} for t in SCENE.stamps_ns.tolist()]
    poses = [{"position": p, "orientation": q} for p, q in zip(named(CENTRES, "xyz"), named(XYZW, "xyzw"), strict=True)]
    return [{"header": {"stamp": s}, "pose": {"pose": p}} for s, p in zip(stamps, poses, strict=True)]


FLAT = np.hstack([CENTRES, XYZW]).tolist()
UNNAMED = "of four numbers is taken as x, y, z, w"
JSON: dict[str, tuple[Any, str]] = {
    "by numbers": ({str(i): SCENE.poses[i].tolist() for i in reversed(range(COUNT))}, ""),
    "by numbers from 1": ({str(i + 1): {"pose": SCENE.poses[i].tolist()} for i in range(COUNT)}, ""),
    "by times": ({seconds(t): p for t, p in zip(SCENE.stamps_ns.tolist(), FLAT, strict=True)}, ""),
    "flat": (FLAT, ""),
    "flat with times": ([[t, *row] for t, row in zip(SECONDS.tolist(), FLAT, strict=True)], ""),
    "position and orientation": (entries(timestamp=SECONDS, position=CENTRES, orientation=XYZW), UNNAMED),
    "t and q by name": (dict(zip(numbered(), entries(t=CENTRES, q=XYZW), strict=True)), UNNAMED),
    "translation and rotation": ({"frames": entries(translation=CENTRES, rotation=SCENE.poses[:, :3, :3])}, ""),
    "qw in front by name": (entries(t=CENTRES, q_wxyz=WXYZ), ""),
    "qvec and tvec": (entries(id=np.arange(COUNT), tvec=CENTRES, qvec=WXYZ), ""),
    "ros": (ros(), ""),
    "keys": ([dict(zip(("tx", "ty", "tz", "qx", "qy", "qz", "qw"), row, strict=True)) for row in FLAT], ""),
    "side by side": ({"timestamps": SECONDS.tolist(), "positions": CENTRES.tolist(), "quaternions": XYZW.tolist()},
                     "quaternions are taken as x, y, z, w"),
    "matrices side by side": ({"ids": list(range(COUNT))[::-1], "poses": SCENE.poses[::-1].tolist()}, ""),
    "w2c": (entries(w2c=np.linalg.inv(SCENE.poses)), "w2c map the world to the camera"),
}  # fmt: skip


@pytest.mark.parametrize("form", JSON)
def test_positions_and_orientations_in_json_are_the_truth(folder: Path, form: str) -> None:
    content, said = JSON[form]
    (folder / "poses.json").write_text(json.dumps(content))
    sequence, messages = opened(folder)
    assert_true(sequence)
    assert said in messages and bool(said) == bool(messages)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (entries(t=CENTRES, rotation=CENTRES), "pose 1: rotation has 3 numbers: angles, or a rotation vector?"),
        (entries(extrinsic=SCENE.poses), "pose 1: in a form that is not read (its keys: extrinsic)"),
        (entries(a=CENTRES, b=XYZW), "pose 1: in a form that is not read (its keys: a, b)"),
        (
            [{"position": [1, 2, 3], "orientation": {"roll": 1, "yaw": 2}}],
            "pose 1: a rotation of roll, yaw, where x, y, z, w",
        ),
        ([*FLAT[:2], SCENE.poses[2].tolist()], "poses in several forms"),
        ({"7": FLAT[0], "9": FLAT[1]}, "names no image here (first: '7')"),
    ],
)
def test_json_of_another_form_is_named(folder: Path, content: Any, said: str) -> None:
    (folder / "poses.json").write_text(json.dumps(content))
    sequence, messages = opened(folder)
    assert sequence.groundtruth is None and f"poses.json: {said}" in messages


# ---- quaternions in front


@pytest.mark.parametrize("timed", [True, False])
@pytest.mark.parametrize("last", [True, False])
def test_a_quaternion_in_front_of_the_position_is_read_and_said(folder: Path, timed: bool, last: bool) -> None:
    columns = (XYZW if last else WXYZ, CENTRES)
    (folder / "groundtruth.txt").write_text(rows(*((SECONDS, *columns) if timed else columns)))
    sequence, messages = opened(folder)
    assert_true(sequence)  # its first pose is the identity
    assert "stand in front of the positions" in messages
    assert ("qx qy qz qw" if last else "qw qx qy qz") in messages.partition("are taken as")[2]


def test_a_heading_says_that_it_stands_in_front(folder: Path) -> None:
    (folder / "groundtruth.txt").write_text(rows(WXYZ, CENTRES, head="# qw qx qy qz tx ty tz\n"))
    sequence, messages = opened(folder)
    assert_true(sequence)
    assert not messages


def test_a_path_tells_which_end_of_it_is_real(tmp_path: Path) -> None:
    poses = PATHS["ahead"]  # no identity in it
    q = Rotation.from_matrix(poses[:, :3, :3]).as_quat()
    (tmp_path / "gt.txt").write_text(rows(q, poses[:, :3, 3]))
    found = read_poses(tmp_path / "gt.txt")
    np.testing.assert_allclose(found.poses, poses, atol=1e-7)
    assert "rotations follow the path as qx qy qz qw" in found.notes[-1]


# ---- angles


def angles(poses: Array, degrees: bool) -> Array:
    """Roll, pitch, yaw by another library: turns about fixed x, y, z."""
    return Rotation.from_matrix(poses[:, :3, :3]).as_euler("xyz", degrees=degrees)


@pytest.mark.parametrize(
    ("head", "degrees", "why"),
    [
        ("# time x y z roll_deg pitch_deg yaw_deg\n", True, "degrees,"),
        ("time,tx,ty,tz,roll(rad),pitch(rad),yaw(rad)\n", False, "radians,"),
        ("# time x y z roll pitch yaw\n", True, "degrees by their size"),
        ("# time x y z roll pitch yaw\n", False, "radians by the path"),
    ],
)
def test_roll_pitch_and_yaw_are_read_in_the_unit_that_something_tells(
    tmp_path: Path, head: str, degrees: bool, why: str
) -> None:
    poses = drive()
    text = rows(100 + np.arange(80) / 10, poses[:, :3, 3], angles(poses, degrees))
    (tmp_path / "gt.csv").write_text(head + (text.replace(" ", ",") if "," in head else text))
    found = read_poses(tmp_path / "gt.csv")
    np.testing.assert_allclose(found.poses, poses, atol=1e-7)
    assert found.notes[-1].startswith(f"roll, pitch and yaw are taken in {why}")


def test_poses_in_a_plane_are_refused_with_what_to_write(tmp_path: Path) -> None:
    (tmp_path / "gt.csv").write_text("time,x,y,theta\n0,1,2,0.1\n1,2,2,0.2\n")
    with pytest.raises(FrontendError, match=r"gt.csv:2: x, y and an angle, of a plane, .* roll_deg pitch_deg yaw_deg"):
        read_poses(tmp_path / "gt.csv")


def test_small_degrees_are_seen_by_the_path(tmp_path: Path) -> None:
    """A body that turns by a few degrees at a time, and whose angles were wrapped to less than 2 pi in degrees."""
    turn = np.deg2rad(6.0) * np.sin(np.arange(80) / 5.0)
    steps = np.column_stack([np.cos(10 * turn), np.sin(10 * turn), 0 * turn])
    centres = np.cumsum(steps, axis=0) - steps
    small = np.column_stack([0 * turn, 0 * turn, np.rad2deg(turn)])
    (tmp_path / "gt.txt").write_text(rows(centres, small, head="# x y z roll pitch yaw\n"))
    with pytest.raises(FrontendError, match=r"in degrees or in radians.*roll_deg"):
        read_poses(tmp_path / "gt.txt")  # neither fits: the path bends ten times as much


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        ((SECONDS, CENTRES, 30 * CENTRES + 5), "7 columns, .*: a time, a position and three angles"),
        ((CENTRES, CENTRES + 5), "6 columns: a position and three angles"),
        ((CENTRES[::-1], 2 * XYZW), "7 columns, of which neither .* a quaternion .*length is 2"),
        ((SECONDS, CENTRES, 2 * XYZW), "8 columns, of which neither"),
    ],
)  # fmt: skip
def test_columns_that_nothing_tells_are_refused_by_what_they_look_like(
    tmp_path: Path, columns: tuple[Array, ...], said: str
) -> None:
    (tmp_path / "gt.txt").write_text(rows(*columns))
    with pytest.raises(FrontendError, match=said):
        read_poses(tmp_path / "gt.txt")


@pytest.mark.parametrize(
    ("units", "factor"),
    [(" [mm]", 1e3), ("_cm", 1e2), (" (km)", 1e-3), ("_m", 1.0), (" [ft]", 1 / 0.3048)],
)
def test_headings_say_the_unit_of_positions(folder: Path, units: str, factor: float) -> None:
    head = f"time [s],x{units},y{units},z{units},qx,qy,qz,qw\n"
    text = rows(SECONDS, CENTRES * factor, XYZW).replace(" ", ",")
    (folder / "groundtruth.csv").write_text(head + text)
    sequence, said = opened(folder)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=2e-6)
    assert ("as the headings say" in said) == (factor != 1.0)


@pytest.mark.parametrize("heads", ["header.stamp.sec header.stamp.nanosec", "secs nsecs", "%field.sec field.nsec"])
def test_seconds_and_nanoseconds_in_two_columns_are_one_time(folder: Path, heads: str) -> None:
    stamps = SCENE.stamps_ns
    head = f"{heads} x y z qx qy qz qw\n"
    lines = zip(stamps.tolist(), np.column_stack([CENTRES, XYZW]).tolist(), strict=True)
    text = "".join(f"{t // 10**9} {t % 10**9} {' '.join(map(repr, line))}\n" for t, line in lines)
    (folder / "groundtruth.txt").write_text(head + text)
    sequence, said = opened(folder)
    assert_true(sequence)
    assert sequence.groundtruth is not None and sequence.groundtruth.stamps_ns.tolist() == stamps.tolist()
    assert "groundtruth" not in said
