"""``maslam bench vo``: figures of known trajectories in closed form, and the whole command on rendered images."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from room import BASELINE_M, CAMERA, Room, relative_to_first, walk

from maslam.backend.geometry import Sim3, se3, so3_exp
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.trajectory import Trajectory, write_kitti_poses, write_tum
from maslam.tools.bench.memory import MemoryReport, Sample, circuit
from maslam.tools.bench.vo.accuracy import accuracy, half_frame_ns
from maslam.tools.bench.vo.other_systems import assign, read_other
from maslam.tools.cli import main
from maslam.tools.common.errors import ToolError, UsageError

NS = 1_000_000_000
FRAMES = 24


def straight(n: int, rate_hz: float = 10.0) -> Trajectory:
    """A metre a frame straight on, ``n`` frames."""
    stamps = np.rint(np.arange(n) * NS / rate_hz).astype(np.int64)
    return Trajectory(stamps, se3(np.eye(3), np.stack([np.zeros(n), np.zeros(n), np.arange(n)], axis=1)))


def moved(trajectory: Trajectory, scale: float) -> Trajectory:
    """The same way in another frame, and ``scale`` times as long."""
    T = Sim3(so3_exp([0.3, -0.2, 0.5]), np.array([4.0, 5, 6]), scale)
    return Trajectory(trajectory.stamps_ns, T.transform_poses(trajectory.poses))


def test_one_percent_of_scale_is_one_percent_of_drift() -> None:
    truth = straight(151)
    found = accuracy([moved(truth, 1.01)], truth, truth.stamps_ns, with_scale=False)
    assert found is not None and found.posed == 151 and found.path_m == pytest.approx(150.0)
    assert found.rpe_percent == pytest.approx((1.0, 1.0)) and found.step_m == pytest.approx(0.01)
    assert found.scale == pytest.approx(1 / 1.01)
    # Aligned at the middle of the way, a pose is off by 1 % of its distance from there.
    assert found.ate_m == pytest.approx(0.01 * np.std(np.arange(151)))
    assert found.ate_max_m == pytest.approx(0.75)
    np.testing.assert_allclose(found.tracks[0].along_m, np.arange(151), atol=1e-6)
    free = accuracy([moved(truth, 0.05)], truth, truth.stamps_ns, with_scale=True)
    assert free is not None and free.ate_m < 1e-9 and max(free.rpe_percent) < 1e-7
    assert free.scale == pytest.approx(20.0)


def test_tracks_are_aligned_each_by_itself() -> None:
    truth = straight(60)
    parts = [slice(0, 20), slice(25, 60)]
    tracks = [
        moved(Trajectory(truth.stamps_ns[part], truth.poses[part]), scale)
        for part, scale in zip(parts, (2.0, 3.0), strict=True)
    ]
    found = accuracy(tracks, truth, truth.stamps_ns, with_scale=True)
    assert found is not None and found.posed == 55 and found.ate_m < 1e-9 and found.step_m < 1e-9
    assert found.path_m == pytest.approx(19 + 34) and found.scale == pytest.approx(1 / 3)
    assert found.rpe_percent[0] < 1e-7 and np.isnan(found.rpe_percent[1])
    np.testing.assert_allclose(found.tracks[1].along_m, np.arange(25, 60), atol=1e-6)
    # RPE is the mean over all sub-paths: 10 of the first track without error, 25 of the second with 1 %.
    mixed = [Trajectory(truth.stamps_ns[:20], truth.poses[:20]), moved(tracks[1], 1.01 / 3.0)]
    both = accuracy(mixed, truth, truth.stamps_ns, with_scale=False)
    assert both is not None and both.rpe_percent[0] == pytest.approx(25 / 35)


def test_poses_are_paired_by_time_within_half_a_frame() -> None:
    truth = straight(40)
    assert half_frame_ns(truth.stamps_ns) == 50_000_000
    # Times written with an error of up to 20 ms, every second frame left out, and one between two frames.
    jitter = np.random.default_rng(0).integers(-20_000_000, 20_000_000, 20)
    late = Trajectory(truth.stamps_ns[::2] + jitter, truth.poses[::2])
    found = accuracy([late], truth, truth.stamps_ns, with_scale=False)
    assert found is not None and found.posed == 20 and found.ate_m < 1e-9 and np.isnan(found.step_m)
    assert accuracy([Trajectory(truth.stamps_ns + NS * 100, truth.poses)], truth, truth.stamps_ns, False) is None
    assert accuracy([], truth, truth.stamps_ns, False) is None
    # A denser truth: the pose nearest to each frame.
    dense = Trajectory(np.arange(0, 391) * 10_000_000, straight(391).poses)
    found = accuracy([Trajectory(truth.stamps_ns, dense.poses[::10])], dense, truth.stamps_ns, False)
    assert found is not None and found.posed == 40 and found.ate_m < 1e-9 and found.path_m == pytest.approx(390.0)


def test_trajectories_of_other_systems_are_read(tmp_path: Path) -> None:
    truth = straight(30)
    write_tum(tmp_path / "a.tum", Trajectory(truth.stamps_ns[3:], truth.poses[3:]))
    write_kitti_poses(tmp_path / "b.txt", truth.poses)
    rows = np.concatenate([truth.stamps_ns[:, None] / NS, truth.poses[:, :3].reshape(-1, 12)], axis=1)
    np.savetxt(tmp_path / "c.txt", rows[5:])
    lengths = []
    for name in ("a.tum", "b.txt", "c.txt"):
        other, note = read_other(tmp_path / name, truth.stamps_ns)
        found = accuracy([other], truth, truth.stamps_ns, with_scale=False)
        assert found is not None and found.ate_m < 1e-7 and note == ""
        lengths.append(found.posed)
    assert lengths == [27, 30, 25]
    longer, note = read_other(tmp_path / "b.txt", truth.stamps_ns[:20])
    assert len(longer) == 20 and "30 poses for 20 frames" in note


def test_trajectories_in_nanoseconds_and_with_a_time_twice(tmp_path: Path) -> None:
    """As ORB-SLAM3 writes EuRoC's: nanoseconds, with six decimals."""
    start, file = 1_403_636_579 * NS, tmp_path / "f.txt"
    stamps = start + straight(30).stamps_ns
    lines = [f"{stamp}.000000 {i} 0 0 0 0 0 1\n" for i, stamp in enumerate(stamps.tolist())]
    file.write_text("".join(lines))
    other, note = read_other(file, stamps)
    np.testing.assert_array_equal(other.stamps_ns, stamps)
    assert note == ""
    file.write_text("".join([*lines[:9], lines[8].replace(" 8 ", " 80 "), *lines[9:]]))
    other, note = read_other(file, stamps)
    assert len(other) == 30 and other.centres[8, 0] == 8.0
    assert note == f"{file}: 1 of 31 poses have the time of another; the first is kept"


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("1 2 3\n", "x.txt:1: 3 columns: positions without rotations"),
        ("", "no poses"),
        ("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3, "3 poses for 30 frames"),
        ("900 0 0 0 0 0 0 1\n901 0 0 0 0 0 0 1\n", "its times are 900.000 to 901.000 s, the images' 0.000 to 2.900 s"),
        ("0 0 0 0 0 0 0 5\n", "quaternion"),
        ("1 2 0 0 0 1 0 0 0 0 1 0\n" * 30, "not a rotation"),
        ("a b c d e f g h\n", "no poses"),
    ],
)
def test_wrong_trajectories_are_said_in_a_line(tmp_path: Path, content: str, said: str) -> None:
    path = tmp_path / "x.txt"
    path.write_text(content)
    with pytest.raises((ToolError, FrontendError)) as caught:
        read_other(path, straight(30).stamps_ns)
    path.write_text("".join(f"{k:06d}.png {k} 0 0 0 0 0 1\n" for k in range(30)))
    with pytest.raises(ToolError, match=r"poses by names of images \(000000\.png"):
        read_other(path, straight(30).stamps_ns)
    assert said in str(caught.value) and "\n" not in str(caught.value) and str(path) in str(caught.value)


def test_files_are_given_to_sequences_by_name() -> None:
    assert assign(["x.txt", "b=y=1.txt"], ["a"]) == {"a": [Path("x.txt"), Path("b=y=1.txt")]}
    assert assign(["b=x.txt", "a=y.txt", "a=z.txt"], ["a", "b"]) == {
        "a": [Path("y.txt"), Path("z.txt")],
        "b": [Path("x.txt")],
    }
    with pytest.raises(UsageError, match=r"--compare x.txt: of which sequence\? .* a, b"):
        assign(["x.txt"], ["a", "b"])


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two agents of a rendered room; nobody knows the poses of the second."""
    root = tmp_path_factory.mktemp("rooms")
    poses = walk(FRAMES)
    for name, seed in (("agent_00", 3), ("agent_01", 4)):
        room = Room(seed)
        folder = root / name
        for side in ("image_0", "image_1"):
            (folder / side).mkdir(parents=True)
        for k, pose in enumerate(poses):
            frame = room.frame(k, pose, RigKind.STEREO)
            assert frame.right is not None
            cv2.imwrite(str(folder / "image_0" / f"{k:06d}.png"), frame.image)
            cv2.imwrite(str(folder / "image_1" / f"{k:06d}.png"), frame.right)
        numbers = {name: getattr(CAMERA, name) for name in ("width", "height", "fx", "fy", "cx", "cy")}
        numbers |= {"baseline_m": BASELINE_M, "rate_hz": 10.0}
        (folder / "camera.yaml").write_text("".join(f"{key}: {value}\n" for key, value in numbers.items()))
        (folder / "times.txt").write_text("".join(f"{k / 10:.6f}\n" for k in range(FRAMES)))
    write_kitti_poses(root / "agent_00/poses.txt", relative_to_first(poses))
    return root


@pytest.mark.slow
def test_the_command(town: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = f"{town.name}/agent_00"
    write_kitti_poses(tmp_path / "perfect.txt", walk(FRAMES))
    words = ["bench", "vo", str(town), "--runs", "2", "--files", "--json", "--quiet", "--out", str(tmp_path / "out")]
    assert main([*words, "--compare", f"{name}={tmp_path / 'perfect.txt'}", "--odometry.features.tracks=300"]) == 0
    printed = capsys.readouterr()
    records: list[dict[str, Any]] = json.loads(printed.out)
    assert json.loads((tmp_path / "out/bench.json").read_text()) == records
    first, second = records
    assert first["sequence"] == name and (first["frames"], first["tracked"], first["tracks"]) == (FRAMES, FRAMES, 1)
    assert first["ate_m"] < 0.02 and first["alignment"] == "se3" and first["scale"] == pytest.approx(1.0, abs=0.02)
    assert first["measured_on"] == FRAMES and second["measured_on"] is None
    assert first["rpe_10m_percent"] is None and first["rpe_frame_m"] < 0.02
    assert first["compared"][0]["name"] == "perfect.txt" and first["compared"][0]["ate_m"] < 1e-6
    assert second["ate_m"] is None and second["tracked"] == FRAMES and second["compared"] == []
    for one in records:
        assert one["same_each_run"] and one["runs"] == 2 and one["files"] and one["unreadable"] == []
        assert sum(one["stages_ms"].values()) == pytest.approx(one["cpu_ms"], rel=0.01)
        assert {"decode", "track", "stereo", "adjust", "export", "write"} <= set(one["stages_ms"])
        assert one["unit_cpu"] == pytest.approx(one["cpu_ms"] / one["unit_ms"], rel=0.01)
        assert one["unit_wall"] == pytest.approx(one["wall_ms"] / one["unit_ms"], rel=0.01)
        assert 20 < one["baseline_mb"] < one["peak_mb"] < 2000
    folder = tmp_path / "out" / name.replace("/", "_")
    assert (folder / "poses_0.txt").is_file() and (folder / "trajectory_0.tum").is_file()
    picture = cv2.imread(str(tmp_path / "out/bench.png"))
    assert picture is not None and picture.std() > 5
    # What was kept, compared with itself in a text table: the same error twice.
    words = ["bench", "vo", str(town / "agent_00"), "--runs", "1", "--plot", str(tmp_path / "p.svg")]
    assert main([*words, "--odometry.features.tracks=300", "--compare", str(folder / "trajectory_0.tum")]) == 0
    lines = capsys.readouterr().out.splitlines()
    ours, other = (line.split() for line in lines if f"{FRAMES}/{FRAMES}" in line)
    assert ours[0] == "agent_00" and ours[3:] == other[2:]
    assert (tmp_path / "p.svg").read_text().startswith("<?xml")


def test_wrong_use_is_said(town: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "wrong.yaml").write_text("odometry: {features: {track: 3}}\n")
    (tmp_path / "other.yaml").write_text("nothing: 1\n")
    for code, said, words in (
        (1, "no such folder", ["nowhere"]),
        (1, "given twice", [str(town), str(town)]),
        (1, "cannot be read as rgbd", [str(town), "--rig", "rgbd"]),
        (1, "x.tum: cannot be read", [str(town / "agent_00"), "--compare", "x.tum"]),
        (2, "of which sequence", [str(town), "--compare", "x.tum"]),
        (2, "--runs 0", [str(town), "--runs", "0"]),
        (2, "must end in .png", [str(town), "--plot", "picture.doc"]),
        (2, "unknown setting 'odometry.features.track'", [str(town), "--config", str(tmp_path / "wrong.yaml")]),
        (2, "unknown setting 'nothing'", [str(town), "--config", str(tmp_path / "other.yaml")]),
        (2, "FOLDER", []),
    ):
        assert main(["bench", "vo", "--quiet", *words]) == code
        printed = capsys.readouterr()
        assert said in printed.err and printed.out == "", printed.err


def test_the_slope_is_that_of_what_grows_with_frames() -> None:
    frames = np.linspace(250, 10_000, 40).astype(int)
    samples = tuple(
        Sample(
            frame=int(n),
            # 120 bytes a frame, maps that grow by jumps, and a library loaded once, on the way.
            resident_mb=300.0 + 120e-6 * n + 20 * (n // 3000) + 15.0 * (n > 4000),
            map_mb=20.0 * (n // 3000),
            keyframes=1,
            culled=0,
            points=9,
            numbers=9,
            observations=9,
            cpu_ms=5.0 + 1e-4 * n,
            lost=0,
        )
        for n in frames
    )
    report = MemoryReport(samples, 1)
    assert report.bytes_per_frame == pytest.approx(120.0) and report.resident_bytes_per_frame > 500
    assert report.ms_growth == pytest.approx((5.0 + 0.8875) / (5.0 + 0.3875), rel=0.01)
    assert "120 bytes" in report.text() and json.loads(report.json())["tracks"] == 1


def test_a_circuit_closes() -> None:
    poses = circuit(200)
    steps = np.linalg.norm(np.diff(np.concatenate([poses, poses[:1]])[:, :3, 3], axis=0), axis=1)
    assert steps.min() > 0.99 * steps.max()
    ahead = np.roll(poses[:, :3, 3], -1, axis=0) - poses[:, :3, 3]
    assert ((ahead / steps[:, None] * poses[:, :3, 2]).sum(axis=1) > 0.999).all()


@pytest.mark.slow
def test_a_long_drive_keeps_no_frames(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["bench", "memory", "--frames", "80", "--lap", "400", "--quiet"]
    plot = tmp_path / "memory.png"
    assert main([*words, "--images", str(tmp_path / "lap"), "--json", "--plot", str(plot)]) == 0
    found = json.loads(capsys.readouterr().out)
    last = found["samples"][-1]
    assert last["frame"] == 80 and len(found["samples"]) == 40 and last["lost"] == 0
    assert last["keyframes"] > 10 and last["points"] > 300 and 0.0 < last["map_mb"] < 30.0
    assert cv2.imread(str(plot)) is not None and (tmp_path / "lap/images/world.json").is_file()


def test_wrong_drives_are_said(capsys: pytest.CaptureFixture[str]) -> None:
    for code, said, words in (
        (2, "--size 12", ["--size", "12"]),
        (1, "3 frames: at least", ["--frames", "3"]),
        (2, "--lap 4", ["--lap", "4"]),
        (2, "must end in", ["--plot", "x.doc"]),
    ):
        assert main(["bench", "memory", "--quiet", *words]) == code
        assert said in capsys.readouterr().err
