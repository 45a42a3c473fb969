"""Ground truth in every common form is the same trajectory; what is wrong with it is said and stops nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from dataset_makers import (
    COUNT,
    Scene,
    make_scene,
    own_camera,
    quaternion_wxyz,
    seconds,
    tum_rows,
    write_euroc,
    write_images,
    write_kitti,
    write_rendered,
    write_seven_scenes,
    write_tum,
)

from maslam.frontend.datasets import ImageSequence, Severity, open_dataset

Lines = Callable[[Scene], str]


def opened(folder: Path) -> ImageSequence:
    [sequence] = open_dataset(folder).sequences
    assert all(problem.severity is Severity.WARNING for problem in sequence.problems)
    return sequence


def write_named(folder: Path, scene: Scene) -> None:
    write_images(folder, [f"{stamp}.png" for stamp in scene.stamps_ns], scene.images)
    (folder / "camera.yaml").write_text(own_camera())


def table(scene: Scene, time: Callable[[int], str], mark: str, wxyz: bool = False) -> str:
    rows = []
    for stamp, pose in zip(scene.stamps_ns.tolist(), scene.poses, strict=True):
        w, x, y, z = quaternion_wxyz(pose[:3, :3])
        quaternion = (w, x, y, z) if wxyz else (x, y, z, w)
        rows.append(mark.join([time(stamp), *(f"{v:.12f}" for v in (*pose[:3, 3], *quaternion))]) + "\n")
    return "".join(rows)


def matrices(scene: Scene, rows: int, timed: bool = False) -> str:
    lines = []
    for stamp, pose in zip(scene.stamps_ns.tolist(), scene.poses, strict=True):
        numbers = " ".join(f"{v:.12e}" for v in pose[:rows].ravel())
        lines.append(f"{seconds(stamp)} {numbers}\n" if timed else f"{numbers}\n")
    return "".join(lines)


def blocks(scene: Scene) -> str:
    return "".join("\n".join(" ".join(f"{v:.12e}" for v in row) for row in pose) + "\n\n" for pose in scene.poses)


EUROC_HEAD = (
    "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z [], "
    "v_RS_R_x [m s^-1]\n"
)
FORMS: dict[str, tuple[str, Lines]] = {
    "tum": ("groundtruth.txt", lambda s: tum_rows(s.stamps_ns, s.poses)),
    "tum with commas and a heading": (
        "groundtruth.csv", lambda s: "timestamp,tx,ty,tz,qx,qy,qz,qw\n" + table(s, seconds, ",")),
    "nanoseconds": ("groundtruth.txt", lambda s: "# timestamp tx ty tz qx qy qz qw\n" + table(s, str, " ")),
    "microseconds": ("gt.txt", lambda s: table(s, lambda t: f"{t // 1000}.{t % 1000:03d}", " ")),
    "quaternion first by the heading": (
        "ground_truth.csv", lambda s: "time;x;y;z;qw;qx;qy;qz\n" + table(s, seconds, ";", wxyz=True)),
    "euroc's columns": (
        "groundtruth.csv",
        lambda s: EUROC_HEAD + "".join(line + ",0.5\n" for line in table(s, str, ",", wxyz=True).splitlines())),
    "ros topics": (
        "groundtruth.csv",
        lambda s: "%time,field.pose.position.x,field.pose.position.y,field.pose.position.z,field.pose.orientation.x,"
        "field.pose.orientation.y,field.pose.orientation.z,field.pose.orientation.w\n" + table(s, str, ",")),
    "kitti": ("poses.txt", lambda s: matrices(s, 3)),
    "kitti with times": ("poses.txt", lambda s: matrices(s, 3, True)),
    "4x4": ("traj.txt", lambda s: matrices(s, 4)),
    "4x4 with times": ("poses.txt", lambda s: matrices(s, 4, True)),
    "4x4 in blocks": ("poses.txt", blocks),
    "positions and quaternions": ("poses.txt", lambda s: table(s, lambda _: "", " ").replace("\n ", "\n").lstrip()),
    "bom and crlf": ("groundtruth.txt", lambda s: "\ufeff" + tum_rows(s.stamps_ns, s.poses).replace("\n", "\r\n")),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_every_form_is_the_same_trajectory(tmp_path: Path, form: str) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    name, lines = FORMS[form]
    (tmp_path / name).write_bytes(lines(scene).encode())
    sequence = opened(tmp_path)
    assert sequence.problems == () and sequence.groundtruth is not None
    np.testing.assert_array_equal(sequence.groundtruth.stamps_ns, scene.stamps_ns)
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses, atol=1e-9)


@pytest.mark.parametrize("rows", [3, 4])
def test_a_matrix_file_for_each_image(tmp_path: Path, rows: int) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    (tmp_path / "pose").mkdir()
    for i, (stamp, pose) in enumerate(zip(scene.stamps_ns, scene.poses, strict=True)):
        if i == 3:
            pose = np.full((4, 4), -np.inf)  # as ScanNet writes what it does not know
        np.savetxt(tmp_path / "pose" / f"{stamp}.txt", pose[:rows])
    sequence = opened(tmp_path)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, np.delete(scene.poses, 3, axis=0), atol=1e-9)
    assert f"a true pose within 20 ms for 5 of {COUNT} frames" in sequence.problems[-1].message


def test_another_clock_is_said_with_both_spans(tmp_path: Path) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    (tmp_path / "groundtruth.txt").write_text(tum_rows(scene.stamps_ns - scene.stamps_ns[0], scene.poses))
    [problem] = opened(tmp_path).problems
    assert (
        "its times are 0.000 to 0.250 s, the images' 1403715274.312 to 1403715274.562 s: on another clock?"
        in problem.message
    )


def test_partial_cover_is_counted(tmp_path: Path) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    (tmp_path / "groundtruth.txt").write_text(tum_rows(scene.stamps_ns[2:], scene.poses[2:]))
    [problem] = opened(tmp_path).problems
    assert "groundtruth.txt: a true pose within 20 ms for 4 of 6 frames" in problem.message


def test_times_twice_out_of_order_and_lost_are_counted(tmp_path: Path) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    lines = tum_rows(scene.stamps_ns, scene.poses).splitlines()
    other = " ".join([lines[1].split()[0], "9 9 9 0 0 0 1"])
    lost = " ".join([lines[5].split()[0], "nan nan nan 0 0 0 1"])
    (tmp_path / "groundtruth.txt").write_text(
        "\n".join([lines[0], lines[1], other, lines[3], lines[2], lines[4], lost])
    )
    sequence = opened(tmp_path)
    truth = sequence.groundtruth
    assert truth is not None
    np.testing.assert_array_equal(truth.stamps_ns, scene.stamps_ns[:5])
    np.testing.assert_allclose(truth.poses, scene.poses[:5], atol=1e-9)
    text = " | ".join(problem.message for problem in sequence.problems)
    for words in (
        "1 of 7 rows hold no pose",
        "time goes back 1 times",
        "1 of 6 poses have the time of another",
        "5 of 6 frames",
    ):
        assert words in text


DAMAGE: dict[str, tuple[Callable[[Path, Scene], None], str, str]] = {
    "a word": (write_tum, "groundtruth.txt", "1 2 x"),
    "a row cut off": (write_kitti, "poses.txt", "1 0 0 0 0 1"),
    "no rotation": (write_kitti, "poses.txt", "1 0 0 0 0 5 0 0 0 0 1 0"),
    "two rows": (lambda f, s: write_rendered(f, s, "stereo"), "poses.txt", ""),
    "of euroc": (write_euroc, "mav0/state_groundtruth_estimate0/data.csv", "5,1,2"),
    "of one frame": (write_seven_scenes, "frame-000001.pose.txt", "1 2 3 4"),
}


@pytest.mark.parametrize("which", DAMAGE)
def test_damaged_truth_is_a_warning_that_names_the_file(tmp_path: Path, which: str) -> None:
    write, name, line = DAMAGE[which]
    write(tmp_path, make_scene())
    lines = (tmp_path / name).read_text().splitlines()
    (tmp_path / name).write_text("\n".join([*lines[:2], line]) + "\n")
    sequence = opened(tmp_path)
    assert len(sequence) == COUNT and name in sequence.problems[0].message
    if which == "of one frame":
        assert sequence.groundtruth is not None and len(sequence.groundtruth) == COUNT - 1
    else:
        assert sequence.groundtruth is None and "errors cannot be known" in sequence.problems[0].message


def test_positions_alone_are_not_read_and_said(tmp_path: Path) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    (tmp_path / "groundtruth.txt").write_text("".join(f"{seconds(t)} 1 2 3\n" for t in scene.stamps_ns.tolist()))
    sequence = opened(tmp_path)
    assert sequence.groundtruth is None and "positions without rotations" in sequence.problems[0].message


def test_a_second_file_of_truth_is_named(tmp_path: Path) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    (tmp_path / "groundtruth.txt").write_text(tum_rows(scene.stamps_ns, scene.poses))
    (tmp_path / "my_ground-truth.csv").write_text("?")
    [problem] = opened(tmp_path).problems
    assert "groundtruth.txt: taken as the ground truth; my_ground-truth.csv beside it is not used" in problem.message


@pytest.mark.parametrize(("axis", "body"), [(0, True), (2, False)])
def test_axes_of_a_body_are_said(tmp_path: Path, axis: int, body: bool) -> None:
    """Twenty poses that turn and always move along their own ``axis``."""
    scene, T = make_scene(), np.eye(4)
    write_named(tmp_path, scene)
    poses = []
    for _ in range(20):
        poses.append(T)
        step = np.eye(4)
        step[:3, :3] = [[np.cos(0.1), 0, np.sin(0.1)], [0, 1, 0], [-np.sin(0.1), 0, np.cos(0.1)]]
        step[axis, 3] = 0.5
        T = T @ step
    (tmp_path / "groundtruth.txt").write_text(
        tum_rows(scene.stamps_ns[0] + 50_000_000 * np.arange(20), np.array(poses))
    )
    messages = [problem.message for problem in opened(tmp_path).problems]
    assert any("along their own x axis (100 % of the path)" in message for message in messages) == body


@pytest.mark.parametrize(("factor", "said"), [(1.0, False), (1000.0, True)])
def test_positions_faster_than_anything_are_doubted(tmp_path: Path, factor: float, said: bool) -> None:
    scene = make_scene()
    write_named(tmp_path, scene)
    poses = np.tile(np.eye(4), (20, 1, 1))
    poses[:, 2, 3] = 0.1 * factor * np.arange(20)  # 2 m/s in metres
    (tmp_path / "groundtruth.txt").write_text(tum_rows(scene.stamps_ns[0] + 50_000_000 * np.arange(20), poses))
    messages = [problem.message for problem in opened(tmp_path).problems]
    assert any("positions move at 2000 m/s (median)" in message for message in messages) == said
