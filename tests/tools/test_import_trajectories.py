"""``maslam import``: trajectories in every form, with images of a known world, become agents with the truth in them."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from maslam.backend.geometry import product, quat_wxyz_from_rotation, se3, se3_inverse, so3_exp, transform_points
from maslam.frontend.datasets.poses_of_images import GivenPoses
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.extrinsic import read_extrinsic
from maslam.frontend.files.timestamps import seconds_text
from maslam.frontend.files.trajectory import read_kitti_poses, read_tum
from maslam.frontend.files.vo_files import read_tracks
from maslam.mas.sequence import load_sequences
from maslam.mas.state.keyframe import keyframes_of
from maslam.tools import cli
from maslam.tools.common.errors import ToolError
from maslam.tools.interchange.given_files import read_given
from maslam.tools.interchange.placed_images import PlacingRules, place_images

START_NS = 1_700_000_000_123_456_789
T_B_C = se3(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), [0.4, -0.1, 0.7])
"""A camera on a LiDAR whose axes are forward, left, up."""


def moments(count: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """Times, nanoseconds, and poses of a camera on a curve."""
    poses = [se3(so3_exp([0.01 * k, -0.05 * k, 0.002 * k]), [0.3 * k, 0.01 * k**2, k]) for k in range(count)]
    return START_NS + 100_000_001 * np.arange(count), np.array(poses)


def read_other_trajectory(path: Path, times: Path | None = None) -> GivenPoses:
    """As of the images of :func:`moments`."""
    stamps = moments()[0]
    images: Any = SimpleNamespace(left=tuple(f"{k:06d}.png" for k in range(len(stamps))), stamps_ns=stamps)
    return read_given(path, images, times, None)


def rows_of(stamps: np.ndarray, poses: np.ndarray, scalar_first: bool = False) -> list[list[str]]:
    q = quat_wxyz_from_rotation(poses[:, :3, :3])
    q = q if scalar_first else q[:, [1, 2, 3, 0]]
    return [[repr(float(v)) for v in (*T[:3, 3], *w)] for T, w in zip(poses, q, strict=True)]


def write(path: Path, form: str) -> None:
    """The same trajectory in one of the forms that other programs write."""
    stamps, poses = moments()
    tum, matrices = rows_of(stamps, poses), poses[:, :3].reshape(-1, 12)
    lines = {
        "tum": [" ".join([seconds_text(t), *row]) for t, row in zip(stamps, tum, strict=True)],
        "tum in nanoseconds": [" ".join([f"{t}.000000", *row]) for t, row in zip(stamps, tum, strict=True)],
        "tum with header": ["timestamp,x,y,z,qx,qy,qz,qw"]
        + [",".join([seconds_text(t), *row]) for t, row in zip(stamps, tum, strict=True)],
        "euroc": [
            "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],v,v,v"
        ]
        + [
            ",".join([str(t), *row, "0", "0", "0"]) for t, row in zip(stamps, rows_of(stamps, poses, True), strict=True)
        ],
        "kitti with times": [
            " ".join([seconds_text(t), *(repr(float(v)) for v in row)]) for t, row in zip(stamps, matrices, strict=True)
        ],
        "kitti": [" ".join(repr(float(v)) for v in row) for row in matrices],
    }[form]
    path.write_bytes(b"\xef\xbb\xbf" + "\r\n".join(lines).encode() + b"\r\n")


@pytest.mark.parametrize("form", ["tum", "tum in nanoseconds", "tum with header", "euroc", "kitti with times"])
def test_the_same_trajectory_in_every_form_is_the_same(form: str, tmp_path: Path) -> None:
    write(tmp_path / "poses.txt", form)
    read = read_other_trajectory(tmp_path / "poses.txt")
    stamps, poses = moments()
    assert read.timed
    np.testing.assert_array_equal(read.trajectory.stamps_ns, stamps)
    np.testing.assert_allclose(read.trajectory.poses, poses, atol=1e-9)


def test_poses_without_times_take_those_of_a_file(tmp_path: Path) -> None:
    write(tmp_path / "poses.txt", "kitti")
    stamps, poses = moments()
    alone = read_other_trajectory(tmp_path / "poses.txt")
    assert not alone.timed
    assert len(alone.trajectory) == len(poses)
    (tmp_path / "times.txt").write_text("".join(f"{seconds_text(t)}\n" for t in stamps))
    read = read_other_trajectory(tmp_path / "poses.txt", tmp_path / "times.txt")
    np.testing.assert_array_equal(read.trajectory.stamps_ns, stamps)
    np.save(tmp_path / "poses.npy", poses)
    np.testing.assert_allclose(read_other_trajectory(tmp_path / "poses.npy").trajectory.poses, poses, atol=1e-12)


def angles_of(R: np.ndarray) -> list[float]:
    """Roll, pitch, yaw in degrees of ``Rz Ry Rx``."""
    x, y, z = np.arctan2(R[2, 1], R[2, 2]), -np.arcsin(R[2, 0]), np.arctan2(R[1, 0], R[0, 0])
    return np.degrees([x, y, z]).tolist()


@pytest.mark.parametrize(
    "form", ["npz", "json by names", "json inverted", "angles", "quaternion in front", "by number"]
)
def test_what_ground_truth_may_be_a_trajectory_may_be(form: str, tmp_path: Path) -> None:
    """The same reader; the forms themselves are tested with it."""
    stamps, poses = moments()
    names = [f"{k:06d}.png" for k in range(len(stamps))]
    q = quat_wxyz_from_rotation(poses[:, :3, :3])
    path = tmp_path / f"poses.{form[:4].strip() if form[0] in 'nj' else 'txt'}"
    if form == "npz":
        np.savez(path, c2w=poses, timestamps=stamps)
    elif form[0] == "j":
        key, T = ("w2c", se3_inverse(poses)) if "inverted" in form else ("c2w", poses)
        path.write_text(json.dumps([{"name": n, key: one.tolist()} for n, one in zip(names, T, strict=True)]))
    elif form == "angles":
        rows = [" ".join(map(repr, [float(v) for v in (*T[:3, 3], *angles_of(T[:3, :3]))])) for T in poses]
        text = "".join(f"{t} {row}\n" for t, row in zip(stamps, rows, strict=True))
        path.write_text("# time x y z roll_deg pitch_deg yaw_deg\n" + text)
    else:
        front = "number" not in form
        cells = np.hstack([q, poses[:, :3, 3]]) if front else np.hstack([poses[:, :3, 3], q[:, [1, 2, 3, 0]]])
        first = [seconds_text(t) for t in stamps] if front else [str(k) for k in range(len(stamps))]
        path.write_text(
            "".join(f"{t} {' '.join(map(repr, row))}\n" for t, row in zip(first, cells.tolist(), strict=True))
        )
    read = read_other_trajectory(path)
    np.testing.assert_array_equal(read.trajectory.stamps_ns, stamps)
    np.testing.assert_allclose(read.trajectory.poses, poses, atol=1e-9)
    assert bool(read.notes) == (form not in ("npz", "json by names"))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 2\n", ":2: the quaternion's length is 2.000"),
        ("1 0 0 0 0 0 0 1\nnan 0 0 0 0 0 0 1\n", ":2: not a time: 'nan'"),
        ("1 0 0 nan 0 0 0 1\n2 0 0 0 0 0 0 0\n", "no poses"),
        ("1 0 0 0 0 0 0 1\n2 0 0 x 0 0 0 1\n", ":2: not a number: 'x'"),
        ("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 1\n", r":2: 7 numbers, but the rows before \(TUM\) have 8"),
        ("1 2 3\n", ":1: 3 columns: positions without rotations"),
        ("# nothing\n", "no poses"),
        ("1 0 0 0 1 0 0 0 2 0 0 0\n", ":1: the 3x3 part"),
    ],
)
def test_what_is_no_trajectory_is_refused_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    (tmp_path / "poses.txt").write_text(text)
    with pytest.raises(FrontendError, match=said):
        read_other_trajectory(tmp_path / "poses.txt")


@pytest.mark.parametrize("unit_ns", [1, 1_000, 1_000_000, 1_000_000_000])
def test_times_from_zero_tell_their_unit_by_their_rate(unit_ns: int, tmp_path: Path) -> None:
    """Ten poses a second; as those of ground truth, and what is taken is said."""
    times = [f"{k * 100_000_000 / unit_ns:.1f}" for k in range(6)]
    (tmp_path / "p.txt").write_text("".join(f"{time} {k} 0 0 0 0 0 1\n" for k, time in enumerate(times)))
    read = read_other_trajectory(tmp_path / "p.txt")
    assert read.trajectory.stamps_ns.tolist() == [k * 100_000_000 for k in range(6)]
    assert all("10 images per second" in note for note in read.notes) and len(read.notes) == int(unit_ns < 1e9)


@pytest.mark.parametrize("row", ["nan nan nan 0 0 0 1", "2 0 0 nan nan nan nan", "0 0 0 0 0 0 0", "inf 0 0 0 0 0 1"])
def test_a_row_without_a_pose_is_a_moment_without_one(row: str, tmp_path: Path) -> None:
    rows = ["0 0 0 0 0 0 1", "1 0 0 0 0 0 1", row, "3 0 0 0 0 0 1"]
    (tmp_path / "p.txt").write_text("".join(f"{k}.5 {one}\n" for k, one in enumerate(rows)))
    read = read_other_trajectory(tmp_path / "p.txt")
    assert read.notes[0].startswith("1 of 4 rows hold no pose")
    assert read.trajectory.centres[:, 0].tolist() == [0.0, 1.0, 3.0]
    assert read.trajectory.stamps_ns.tolist() == [500_000_000, 1_500_000_000, 3_500_000_000]


def test_rows_without_times_stay_with_their_images_where_one_has_no_pose(tmp_path: Path) -> None:
    rows = [f"1 0 0 {k if k != 1 else 'nan'} 0 1 0 0 0 0 1 0\n" for k in range(6)]
    (tmp_path / "p.txt").write_text("".join(rows))
    read = read_other_trajectory(tmp_path / "p.txt")
    images = place_images("drive", read, moments()[0], PlacingRules(offset_ns=5).of(read))
    assert "1 of 6 rows hold no pose" in read.notes[0] and images.rows.tolist() == [0, 2, 3, 4, 5]
    assert images.poses[:, 0, 3].tolist() == [0.0, 2.0, 3.0, 4.0, 5.0]


def test_poses_out_of_order_are_sorted_and_said(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text("1.5 1 0 0 0 0 0 1\n3.5 3 0 0 0 0 0 1\n2.5 2 0 0 0 0 0 1\n")
    read = read_other_trajectory(tmp_path / "p.txt")
    assert read.trajectory.centres[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert read.notes == ("time goes back 1 times; the poses are sorted by time",)


def test_a_time_given_twice_counts_once(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text("1.5 0 0 0 0 0 0 1\n1.5 5 0 0 0 0 0 1\n2.5 9 0 0 0 0 0 1\n")
    read = read_other_trajectory(tmp_path / "p.txt")
    assert read.notes == ("1 of 3 poses have the time of another; the first is kept",)
    assert read.trajectory.centres[:, 0].tolist() == [0.0, 9.0]


def test_an_extrinsic_in_every_form_is_the_same(tmp_path: Path) -> None:
    q = quat_wxyz_from_rotation(T_B_C[:3, :3])
    forward = " ".join(map(repr, T_B_C.ravel().tolist()))
    back = se3_inverse(T_B_C)
    texts = {
        "numbers.txt": forward,
        "euroc.yaml": f"T_BS:\n  cols: 4\n  rows: 4\n  data: {T_B_C.ravel().tolist()}\n",
        "calib.txt": "Tr: " + " ".join(map(repr, back[:3].ravel().tolist())),
    }
    texts["kalibr.yaml"] = "cam0:\n  T_cam_imu:\n" + "".join(f"  - {row}\n" for row in back.tolist())
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
        np.testing.assert_allclose(read_extrinsic(str(tmp_path / name)), T_B_C, atol=1e-9, err_msg=name)
    seven = [*T_B_C[:3, 3].tolist(), *q[1:].tolist(), float(q[0])]
    np.testing.assert_allclose(read_extrinsic(",".join(map(repr, seven))), T_B_C, atol=1e-9)
    for wrong in ("1,2,3", "nowhere.yaml", "1 0 0 0 0 2 0 0 0 0 1 0"):
        with pytest.raises(FrontendError):
            read_extrinsic(wrong)


def placed(times_s: list[float], images_s: list[float], x: list[float] | None = None, **rules: int):  # type: ignore[no-untyped-def]
    from maslam.frontend.files.trajectory import Trajectory

    ns = (1e9 * np.array(times_s)).astype(np.int64)
    poses = np.tile(np.eye(4), (len(ns), 1, 1))
    poses[:, 0, 3] = times_s if x is None else x
    poses[:, :3, :3] = so3_exp(np.outer(poses[:, 0, 3], [0.0, 0.1, 0.0]))
    given = GivenPoses(Trajectory(ns, poses), "TUM", True)
    return place_images("drive", given, (1e9 * np.array(images_s)).astype(np.int64), PlacingRules(**rules))


def test_images_take_poses_of_their_time_or_between_two() -> None:
    found = placed([0, 0.1, 0.2, 0.3, 2.0, 2.1], [-1.0, 0.0, 0.125, 0.2, 1.0, 2.05, 3.0])
    assert found.rows.tolist() == [1, 2, 3, 5]
    assert (found.own, found.between, found.images) == (2, 2, 7)
    np.testing.assert_allclose(found.poses[:, 0, 3], [0.0, 0.125, 0.2, 2.05], atol=1e-9)
    np.testing.assert_allclose(found.poses[1, :3, :3], so3_exp([0.0, 0.0125, 0.0]), atol=1e-9)
    assert "3 without a pose" in found.text()


def test_a_clock_offset_is_added_to_the_poses_and_its_lack_is_named() -> None:
    assert placed([0, 0.1, 0.2], [100.0, 100.1], offset_ns=100_000_000_000).rows.tolist() == [0, 1]
    with pytest.raises(ToolError, match=r"images 100\.000 to 100\.100 s, poses 0\.000 to 0\.200 s.*--clock-offset"):
        placed([0, 0.1, 0.2], [100.0, 100.1])


def test_a_jump_and_a_long_gap_begin_a_new_track_and_speed_does_not() -> None:
    times = [k / 10 for k in range(20)]
    assert placed(times, times).track.max() == 0
    jumped = placed(times, times, [k / 10 + 50 * (k >= 12) for k in range(20)])
    assert jumped.track.tolist() == [0] * 12 + [1] * 8
    assert "jumps by 50" in jumped.jumps[0]
    later = [t + 30 * (t >= 1.2) for t in times]
    assert placed(later, later).track.tolist() == [0] * 12 + [1] * 8
    faster = np.cumsum([0.0] * 15 + [1.0] * 5).tolist()  # stands for long, then drives
    assert placed(times, times, faster).track.max() == 0


def truth_of(folder: Path) -> np.ndarray:
    return read_kitti_poses(folder / "poses.txt")[1]


@pytest.fixture(scope="module")
def trajectories(town_stereo: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The true paths of the town's two agents: of a LiDAR, between the images' times (agent_00), and of the camera as
    ORB-SLAM writes key-frames (agent_01)."""
    folder = tmp_path_factory.mktemp("given")
    for name in ("agent_00", "agent_01"):
        times = np.loadtxt(town_stereo / name / "times.txt")
        T = truth_of(town_stereo / name)
        rows = np.array(rows_of(times, T), dtype=float)
        np.savetxt(folder / f"{name}.txt", np.column_stack([times, rows]), "%.9f")
    return folder


def imported(words: list[str]) -> None:
    assert cli.main(["import", *words, "--quiet"]) == 0


@pytest.fixture(scope="module")
def stereo(town_stereo: Path, trajectories: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("imported") / "seqs"
    imported([str(trajectories), str(town_stereo), str(out)])
    return out


def test_poses_stay_as_they_were_given(stereo: Path, town_stereo: Path) -> None:
    for name in ("agent_00", "agent_01"):
        T = truth_of(town_stereo / name)
        every = read_tum(stereo / name / "trajectory.tum")
        np.testing.assert_allclose(every.poses, product(se3_inverse(T[0]), T), atol=1e-6)
        track = read_tracks(stereo / name)[0]
        assert len(track) >= 5
        nearest = np.rint(track.stamps_s * 10).astype(int)
        np.testing.assert_allclose(track.poses, product(se3_inverse(T[0]), T)[nearest], atol=1e-6)


def off_px(seqs: Path, name: str) -> np.ndarray:
    """Pixels between where points are seen and where they should be, of every view."""
    track = read_tracks(seqs / name)[0]
    views = np.load(seqs / name / "views_0.npz")
    entry = json.loads((seqs / "manifest.json").read_text())["agents"][int(name[-2:])]["camera"]
    errors = []
    for k in range(len(track)):
        rows = views["observations"][:, 0] == k
        p = transform_points(se3_inverse(track.poses[k]), track.points[views["observations"][rows, 1]])
        uv = p[:, :2] / p[:, 2:] * [entry["fx"], entry["fy"]] + [entry["cx"], entry["cy"]]
        errors.append(np.linalg.norm(uv - views["uv"][rows], axis=1))
    return np.concatenate(errors)


def test_points_are_where_stereo_and_all_views_see_them(stereo: Path) -> None:
    assert np.median(off_px(stereo, "agent_00")) < 1.0
    assert len(read_tracks(stereo / "agent_00")[0].points) > 500


def test_one_camera_gets_metric_points_from_metric_poses(town_stereo: Path, trajectories: Path, tmp_path: Path) -> None:
    imported([str(trajectories), str(town_stereo), str(tmp_path / "seqs"), "--rig", "mono"])
    manifest, sequences = load_sequences(tmp_path / "seqs")
    assert manifest.scale == "metric"
    assert all(one.metric for one in sequences)
    assert [entry.camera.kind for entry in manifest.agents] == ["mono", "mono"]
    stereo_like = read_tracks(tmp_path / "seqs" / "agent_00")[0]
    assert len(stereo_like.points) > 60
    assert np.median(off_px(tmp_path / "seqs", "agent_00")) < 1.0
    # Each of the points was seen by three key-frames at least: two rays always meet nearly.
    assert np.bincount(stereo_like.observations[:, 1]).min() >= 3


def test_arbitrary_scale_is_kept_as_such(town_stereo: Path, trajectories: Path, tmp_path: Path) -> None:
    words = [str(trajectories), str(town_stereo), str(tmp_path / "seqs"), "--rig", "mono", "--scale", "arbitrary"]
    imported(words)
    manifest, sequences = load_sequences(tmp_path / "seqs")
    assert manifest.scale == "arbitrary"
    assert not any(one.metric for one in sequences)


def test_lidar_poses_enter_by_the_cameras_place_on_it(
    town_stereo: Path, trajectories: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "poses").mkdir()
    for name in ("agent_00", "agent_01"):
        times = np.loadtxt(town_stereo / name / "times.txt")
        lidar = product(truth_of(town_stereo / name), se3_inverse(T_B_C))
        rows = np.array(rows_of(times, lidar), dtype=float)
        np.savetxt(tmp_path / "poses" / f"{name}.txt", np.column_stack([times, rows]), "%.9f")
    numbers = ",".join(map(repr, T_B_C.ravel().tolist()))
    words = [str(tmp_path / "poses"), str(town_stereo)]
    imported([*words, str(tmp_path / "seqs"), f"--T-body-camera={numbers}"])
    T = truth_of(town_stereo / "agent_00")
    found = read_tum(tmp_path / "seqs" / "agent_00" / "trajectory.tum").poses
    np.testing.assert_allclose(found, product(se3_inverse(T[0]), T), atol=1e-6)
    capsys.readouterr()
    assert cli.main(["import", *words, str(tmp_path / "wrong"), "--quiet"]) == 1
    said = capsys.readouterr().err
    assert "images and poses contradict each other" in said
    assert "--T-body-camera" in said
    assert not (tmp_path / "wrong").exists()


def test_poses_the_wrong_way_round_are_refused(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "poses").mkdir()
    for name in ("agent_00", "agent_01"):
        T = truth_of(town_stereo / name)
        T = product(se3_inverse(T), T[0])  # the inverse of poses in the frame of the first
        np.savetxt(tmp_path / "poses" / f"{name}.txt", T[:, :3].reshape(-1, 12))
    for rig in ("stereo", "mono"):
        words = [str(tmp_path / "poses"), str(town_stereo), str(tmp_path / "s"), "--quiet", "--rig", rig]
        assert cli.main(["import", *words]) == 1
        assert "contradict" in capsys.readouterr().err


def test_a_unit_that_is_not_the_depths_is_refused(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "poses").mkdir()
    for name in ("agent_00", "agent_01"):
        T = truth_of(town_stereo / name).copy()
        T[:, :3, 3] *= 3.0
        np.savetxt(tmp_path / "poses" / f"{name}.txt", T[:, :3].reshape(-1, 12))
    assert cli.main(["import", str(tmp_path / "poses"), str(town_stereo), str(tmp_path / "s"), "--quiet"]) == 1
    assert "not in metres" in capsys.readouterr().err


def test_images_without_a_pose_are_counted_with_the_reason(
    town_stereo: Path, trajectories: Path, tmp_path: Path
) -> None:
    (tmp_path / "poses").mkdir()
    for name in ("agent_00", "agent_01"):
        lines = (trajectories / f"{name}.txt").read_text().splitlines()
        (tmp_path / "poses" / f"{name}.txt").write_text("\n".join(lines[4:]) + "\n")
    imported([str(tmp_path / "poses"), str(town_stereo), str(tmp_path / "seqs")])
    manifest, _ = load_sequences(tmp_path / "seqs")
    lost = manifest.agents[0].lost[0]
    assert (lost.first_frame, lost.last_frame) == (0, 3)
    assert lost.reason == "no pose is given at its time"


def test_one_import_after_the_other_makes_a_team(
    town_stereo: Path, trajectories: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "seqs")
    for k in (0, 1):
        file, images = trajectories / f"agent_0{k}.txt", town_stereo / f"agent_0{k}"
        imported([str(file), str(images), out, "--add"])
    manifest, _ = load_sequences(tmp_path / "seqs")
    assert [entry.name for entry in manifest.agents] == ["agent_00", "agent_01"]
    assert len({entry.sequence for entry in manifest.agents}) == 2
    assert cli.main(["import", str(trajectories / "agent_00.txt"), str(town_stereo / "agent_00"), out, "--add"]) == 1
    assert "already" in capsys.readouterr().err


def test_a_trajectory_that_is_missing_is_named(
    town_stereo: Path, trajectories: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["import", str(trajectories / "agent_00.txt"), str(town_stereo), str(tmp_path / "s")]) == 1
    assert "one trajectory for 2 sequences" in capsys.readouterr().err
    (tmp_path / "poses").mkdir()
    (tmp_path / "poses" / "agent_00.txt").write_text((trajectories / "agent_00.txt").read_text())
    (tmp_path / "poses" / "agent_10.txt").write_text("")
    assert cli.main(["import", str(tmp_path / "poses"), str(town_stereo), str(tmp_path / "s")]) == 1
    assert "no trajectory for agent_01" in capsys.readouterr().err


KINDS = ("Odometry", "PoseStamped", "PoseWithCovarianceStamped", "TransformStamped", "Path")


def write_bag(path: Path, kind: str, ros1: bool) -> Path:
    """The moments as messages of a kind on /pose, with a path's last message holding all of them."""
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    types, extra = store.types, {"seq": 0} if ros1 else {}
    stamps, poses = moments()

    def header(t: int) -> Any:
        time = types["builtin_interfaces/msg/Time"](sec=t // 10**9, nanosec=t % 10**9)
        return types["std_msgs/msg/Header"](stamp=time, frame_id="map", **extra)

    def pose(T: np.ndarray) -> Any:
        w, x, y, z = quat_wxyz_from_rotation(T[None, :3, :3])[0].tolist()
        turn = types["geometry_msgs/msg/Quaternion"](x, y, z, w)
        return types["geometry_msgs/msg/Pose"](types["geometry_msgs/msg/Point"](*T[:3, 3].tolist()), turn)

    def message(k: int) -> Any:
        named, at, zero = types[name], header(int(stamps[k])), np.zeros(36)
        one = pose(poses[k])
        if kind == "PoseStamped":
            return named(at, one)
        if kind == "Path":
            stamped = types["geometry_msgs/msg/PoseStamped"]
            return named(at, [stamped(header(int(stamps[j])), pose(poses[j])) for j in range(k + 1)])
        if kind == "TransformStamped":
            vector = types["geometry_msgs/msg/Vector3"](*poses[k, :3, 3].tolist())
            return named(at, "body", types["geometry_msgs/msg/Transform"](vector, one.orientation))
        uncertain = types["geometry_msgs/msg/PoseWithCovariance"](one, zero)
        if kind == "PoseWithCovarianceStamped":
            return named(at, uncertain)
        vector = types["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        twist = types["geometry_msgs/msg/Twist"](vector, vector)
        return named(at, "body", uncertain, types["geometry_msgs/msg/TwistWithCovariance"](twist, zero))

    name = f"{'nav_msgs' if kind in ('Odometry', 'Path') else 'geometry_msgs'}/msg/{kind}"
    out = path.with_suffix(".bag") if ros1 else path
    with Writer1(out) if ros1 else Writer2(out, version=9) as writer:
        connection = writer.add_connection("/pose", name, typestore=store)
        for k in range(len(poses)):
            pack = store.serialize_ros1 if ros1 else store.serialize_cdr
            writer.write(connection, int(stamps[k]) + 5_000_000, pack(message(k), name))  # written later
    return out


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_each_kind_of_pose_in_a_bag_is_read(kind: str, ros1: bool, tmp_path: Path) -> None:
    """Those that evo takes for trajectories, and paths."""
    pytest.importorskip("rosbags")
    from maslam.tools.interchange.given_bag import read_given_bag
    from maslam.tools.interchange.given_files import trajectory_files

    out = write_bag(tmp_path / "agent_00", kind, ros1)
    read = read_given_bag(out, None)
    stamps, poses = moments()
    np.testing.assert_array_equal(read.trajectory.stamps_ns, stamps)
    np.testing.assert_allclose(read.trajectory.poses, poses, atol=1e-9)
    with pytest.raises(ToolError, match=r"topics with poses: /pose; --topic"):
        read_given_bag(out, "/other")
    # Also as one of a folder of trajectories: a ROS 2 bag is a folder itself.
    write(tmp_path / "agent_01.txt", "tum")
    found = trajectory_files(tmp_path, ["agent_00", "agent_01"])
    assert found == {"agent_00": out, "agent_01": tmp_path / "agent_01.txt"}


def test_positions_go_with_the_sequences_they_belong_to(
    town_stereo: Path, trajectories: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of one agent, in metres on another clock; they lie where the antenna was, in a frame of their own."""
    T_E_W = se3(so3_exp([0.0, 0.0, 0.7]) @ so3_exp([np.pi / 2, 0.0, 0.0]), [300.0, 20.0, 5.0])
    antenna = np.array([[0.2, -0.5, 0.1]])
    times = np.loadtxt(town_stereo / "agent_00" / "times.txt")
    true = truth_of(town_stereo / "agent_00")
    (tmp_path / "gps").mkdir()
    file = tmp_path / "gps" / "agent_00.csv"
    rows = [(t - 3.0, *transform_points(T_E_W @ T, antenna)[0]) for t, T in zip(times, true, strict=True)]
    file.write_text("time,east,north,up\n" + "".join(",".join(map(repr, map(float, row))) + "\n" for row in rows))
    words = ["--gps", str(tmp_path / "gps"), "--gps-antenna", "0.2,-0.5,0.1", "--gps-sigma", "0.1"]
    made = [str(trajectories), str(town_stereo), str(tmp_path / "seqs")]
    imported([*made, *words, "--gps-offset", "3"])
    _, sequences = load_sequences(tmp_path / "seqs")
    assert sequences[1].positions is None
    positions = sequences[0].positions
    assert positions is not None and len(positions) == len(times)
    keyframes = keyframes_of(sequences[0])
    fixes = [(k, fix) for k in keyframes for fix in k.fixes]
    assert len(fixes) >= len(times) - 5
    # Seen from its key-frame, a fix lies where the antenna was: one rigid transform lays all on the positions.
    seen = np.array([transform_points(k.T_T_C, fix.lever[None])[0] for k, fix in fixes])
    wanted = transform_points(T_E_W @ true[0], seen)
    np.testing.assert_allclose(wanted, np.array([fix.enu for _, fix in fixes]), atol=1e-4)
    capsys.readouterr()
    assert cli.main(["import", *made[:2], str(tmp_path / "other"), *words, "--gps-offset", "1000"]) == 1
    assert "--gps-offset" in capsys.readouterr().err
