"""Recordings of teams as public data sets lay them out: topics, folders, calibrations and ground truth of each robot.

S3E (Feng et al., 2022), Kimera-Multi (Tian et al., 2023), and the bags of Swarm-SLAM's experiments (Lajoie and
Beltrame, 2024), by their read-me files and scripts."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from dataset_makers import BASELINE_M, COUNT, CX, CY, FX, FY, HEIGHT, WIDTH, quaternion_wxyz, seconds, tum_rows
from recording_makers import Channel, write_ros1, write_ros2
from test_bags import CAMERA, P_RIGHT, SCENE, STAMPS, info, messages, packed, png, raw

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.errors import FrontendError

T_RIGHT_LEFT = se3(so3_exp([0.005, -0.0005, 0.003]), [-BASELINE_M, -0.004, -0.001])


def compressed(topic: str, images: np.ndarray) -> Channel:
    return packed(topic, [png(image) for image in images], "png")


# ---- S3E: all robots in one bag without camera_info; settings of ORB-SLAM's kind with a transform in millimetres


def s3e_settings(bf: float = FX * BASELINE_M, T_right_left: np.ndarray = T_RIGHT_LEFT) -> str:
    R, t = T_right_left[:3, :3], T_right_left[:3, 3] * 1000.0
    K = f"[{FX}, 0.0, {CX}, 0.0, {FY}, {CY}, 0.0, 0.0, 1.0]"
    P = f"[{FX}, 0.0, {CX}, {t[0]}, 0.0, {FY}, {CY}, {t[1]}, 0.0, 0.0, 1.0, {t[2]}]"
    lines = ["#%YAML:1.0", 'Camera.type: "PinHole"']
    lines += [f"Camera.{key}: {value}" for key, value in zip(("fx", "fy", "cx", "cy"), (FX, FY, CX, CY), strict=True)]
    lines += ["Camera.k1: -0.05", "Camera.k2: 0.1", "Camera.p1: 0.0", "Camera.p2: 0.0"]
    lines += [f"Camera.width: {WIDTH}", f"Camera.height: {HEIGHT}", "Camera.fps: 20.0", f"Camera.bf: {bf}"]
    for side in ("LEFT", "RIGHT"):
        values = {
            "D": "[-0.05, 0.1, 0.0, 0.0, 0.0]",
            "K": K,
            "R": str((np.eye(3) if side == "LEFT" else R).ravel().tolist()),
            "P": f"[{FX}, 0.0, {CX}, 0.0, 0.0, {FY}, {CY}, 0.0, 0.0, 0.0, 1.0, 0.0]" if side == "LEFT" else P,
        }
        lines += [f"{side}.height: {HEIGHT}", f"{side}.width: {WIDTH}"]
        for key, value in values.items():
            lines += [f"{side}.{key}: #!!opencv-matrix", "   rows: 1", "   cols: 1", "   dt: d", f"   data: {value}"]
    return "\n".join(lines) + "\n"


def utm_rows(centres: np.ndarray) -> str:
    return "".join(
        f"{seconds(stamp)} {668000 + x:.4f} {2550000 + z:.4f} {y:.4f} 0 0 0 1\n"
        for stamp, (x, y, z) in zip(STAMPS, centres, strict=True)
    )


def write_s3e(root: Path, storage: str = "sqlite3") -> Path:
    """``Calibration/alpha.yaml`` beside ``S3E_Playground_1/``, where the bag and ``alpha_gt.txt`` are."""
    folder = root / "S3E_Playground_1"
    channels = []
    for robot in ("Alpha", "Bob", "Carol"):
        channels += [
            compressed(f"/{robot}/left_camera/compressed", SCENE.images),
            compressed(f"/{robot}/right_camera/compressed", SCENE.rights),
        ]
    if storage == "ros1":
        folder.mkdir(parents=True)
        write_ros1(folder / "S3E_Playground_1.bag", channels)
    else:
        root.mkdir(exist_ok=True)
        write_ros2(folder, channels, storage)
    (root / "Calibration").mkdir()
    for robot in ("alpha", "bob", "carol"):
        (root / f"Calibration/{robot}.yaml").write_text(s3e_settings())
        (folder / f"{robot}_gt.txt").write_text(utm_rows(SCENE.poses[:, :3, 3]))
    return folder


@pytest.mark.parametrize("storage", ["sqlite3", "mcap", "ros1"])
def test_s3e(tmp_path: Path, storage: str) -> None:
    sequences = open_dataset(write_s3e(tmp_path / "S3Ev1", storage)).sequences
    assert [(s.name, s.rig.kind) for s in sequences] == [(n, RigKind.STEREO) for n in ("Alpha", "Bob", "Carol")]
    for sequence in sequences:
        assert sequence.rig.baseline_m == pytest.approx(np.linalg.norm(T_RIGHT_LEFT[:3, 3]))
        assert sequence.groundtruth is not None and len(sequence.groundtruth.poses) == COUNT
        moved = sequence.groundtruth.centres - sequence.groundtruth.centres[0]
        x, y, z = (SCENE.poses[:, :3, 3] - SCENE.poses[0, :3, 3]).T
        np.testing.assert_allclose(moved, np.column_stack([x, z, y]), atol=1e-3)
        assert not sequence.problems


def test_the_pair_of_s3e_stands_as_opencv_says(tmp_path: Path) -> None:
    (tmp_path / "alpha.yaml").write_text(s3e_settings())
    rig = read_calibration(tmp_path / "alpha.yaml")
    assert rig.T_left_right is not None
    np.testing.assert_allclose(rig.T_left_right @ T_RIGHT_LEFT, np.eye(4), atol=1e-12)


def test_a_matrix_that_is_neither_form_is_refused(tmp_path: Path) -> None:
    """In its usual form the third row of RIGHT.P is 0 0 1 0: read as such, S3E's baseline would be 15 % short."""
    (tmp_path / "alpha.yaml").write_text(s3e_settings(bf=FX * 0.4))
    with pytest.raises(FrontendError, match=r"RIGHT.P: a projection matrix of rectified images, whose third row is"):
        read_calibration(tmp_path / "alpha.yaml")


@pytest.mark.parametrize("last", ["image_raw", "image_rect"])
def test_camera_info_with_such_matrices_states_no_baseline(tmp_path: Path, last: str) -> None:
    """As Swarm-SLAM's experiments publish S3E's calibration: read as usual, the baseline would be 15 % short."""
    P = np.array([[FX, 0, CX, -250.0], [0, FY, CY, -4.0], [0, 0, 1, -1.0]])
    channels = [
        raw(f"/left/{last}", SCENE.images, "mono8"),
        raw(f"/right/{last}", SCENE.rights, "mono8"),
        info("/left/camera_info"),
        info("/right/camera_info", P=P),
    ]
    write_ros1(tmp_path / "run.bag", channels)
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is RigKind.MONO and "no baseline of a pair" in messages(sequence)


def test_positions_without_turns_are_said(tmp_path: Path) -> None:
    folder = write_s3e(tmp_path / "S3Ev1")
    count = 20
    angle = np.linspace(0.0, np.pi, count)
    rows = "".join(
        f"{seconds(STAMPS[0] + i * 12_500_000)} {np.cos(a):.6f} {np.sin(a):.6f} 0 0 0 0 1\n"
        for i, a in enumerate(angle)
    )
    (folder / "bob_gt.txt").write_text(rows)
    alpha, bob, _ = open_dataset(folder).sequences
    assert "poses never turn, where their path does" in messages(bob) and not alpha.problems


# ---- Kimera-Multi: a bag for each robot, of colour, depth and an infrared pair; one calibration for all


def kimera_channels(robot: str, baseline: bool) -> list[Channel]:
    head = f"/{robot}/forward"
    right = {"P": P_RIGHT} if baseline else {}
    return [
        compressed(f"{head}/color/image_raw/compressed", SCENE.rights[::-1]),
        info(f"{head}/color/camera_info"),
        raw(f"{head}/depth/image_rect_raw", SCENE.depth_mm, "16UC1"),
        info(f"{head}/depth/camera_info"),
        compressed(f"{head}/infra1/image_rect_raw/compressed", SCENE.images),
        info(f"{head}/infra1/camera_info"),
        compressed(f"{head}/infra2/image_rect_raw/compressed", SCENE.rights),
        info(f"{head}/infra2/camera_info", **right),
    ]


def write_kimera(root: Path, robots: Sequence[str], baseline: bool = True) -> None:
    (root / "ground_truth/1014").mkdir(parents=True)
    (root / "ground_truth/1207").mkdir()
    for robot in robots:
        write_ros1(root / f"10_14_{robot}.bag", kimera_channels(robot, baseline), "lz4")
        for day, offset in (("1014", 0.0), ("1207", 5.0)):
            rows = ["#timestamp_kf,x,y,z,qw,qx,qy,qz"]
            for stamp, pose in zip(STAMPS, SCENE.poses, strict=True):
                place = pose[:3, 3] + [offset, 0.0, 0.0]
                rows.append(",".join(map(str, [stamp, *place, *quaternion_wxyz(pose[:3, :3])])))
            (root / f"ground_truth/{day}/{robot}_gt_odom.csv").write_text("\n".join(rows) + "\n")


def kimera_parameters(side: str, x: float) -> str:
    pose = se3(np.eye(3), [x, 0.0, 0.0]).ravel().tolist()
    return (
        f"%YAML:1.0\ncamera_id: {side}_cam\nT_BS:\n  cols: 4\n  rows: 4\n  data: {pose}\nrate_hz: 30\n"
        f"resolution: [{WIDTH}, {HEIGHT}]\ncamera_model: pinhole\nintrinsics: [{FX}, {FY}, {CX}, {CY}]\n"
        "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n"
    )


def check_kimera(sequences: Sequence[ImageSequence]) -> None:
    assert [s.name for s in sequences] == ["10_14_acl_jackal", "10_14_acl_jackal2", "10_14_thoth"]
    for sequence in sequences:
        assert sequence.rig.kind is RigKind.STEREO and sequence.rig.baseline_m == pytest.approx(BASELINE_M)
        np.testing.assert_array_equal(sequence.read_image(1), SCENE.images[1])
        assert "/forward/color/image_raw/compressed (CompressedImage, 6)" in sequence.origin.partition("not read")[2]
        assert sequence.groundtruth is not None
        np.testing.assert_allclose(sequence.groundtruth.centres, SCENE.poses[:, :3, 3], atol=1e-9)
        assert sequence.groundtruth.stamps_ns.tolist() == STAMPS
        robot = sequence.name.removeprefix("10_14_")
        assert any(note.endswith(f"ground_truth/1014/{robot}_gt_odom.csv") for note in sequence.notes)


ROBOTS = ("acl_jackal", "acl_jackal2", "thoth")


def test_kimera_multi(tmp_path: Path) -> None:
    write_kimera(tmp_path, ROBOTS)
    check_kimera(open_dataset(tmp_path).sequences)


@pytest.mark.parametrize("folder", [".", "params"])
def test_kimera_multi_by_the_calibration_of_kimera_vio(tmp_path: Path, folder: str) -> None:
    """Where camera_info lacks the baseline, the one calibration for all robots has it."""
    write_kimera(tmp_path, ROBOTS, baseline=False)
    (tmp_path / folder).mkdir(exist_ok=True)
    (tmp_path / folder / "LeftCameraParams.yaml").write_text(kimera_parameters("left", 0.0))
    (tmp_path / folder / "RightCameraParams.yaml").write_text(kimera_parameters("right", BASELINE_M))
    sequences = open_dataset(tmp_path).sequences
    check_kimera(sequences)
    assert all("LeftCameraParams.yaml" in s.understood[0].sentence() for s in sequences)


def test_truth_of_two_days_is_not_mixed_up(tmp_path: Path) -> None:
    write_kimera(tmp_path, ROBOTS[:1])
    (tmp_path / "10_14_acl_jackal.bag").rename(tmp_path / "acl_jackal.bag")
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.groundtruth is None
    assert "which of 1014/acl_jackal_gt_odom.csv, 1207/acl_jackal_gt_odom.csv is of acl_jackal?" in messages(sequence)


# ---- Swarm-SLAM's experiments: a ROS 2 bag for each robot, of KITTI or GrAco


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("/kitti/camera_color/left/image_rect_color", "/kitti/camera_color/right/image_rect_color"),
        ("/r{}/stereo_camera/left/image_rect_color", "/r{}/stereo_camera/right/image_rect_color"),
        ("/camera_left/image_raw", "/camera_right/image_raw"),
    ],
)
def test_bags_of_swarm_slam(tmp_path: Path, left: str, right: str) -> None:
    for robot in (0, 1):
        topics = [topic.format(robot) for topic in (left, right)]
        heads = [topic.rpartition("/")[0] for topic in topics]
        channels = [
            raw(topics[0], SCENE.images, "mono8"),
            raw(topics[1], SCENE.rights, "mono8"),
            info(f"{heads[0]}/camera_info"),
            info(f"{heads[1]}/camera_info", P=P_RIGHT),
        ]
        write_ros2(tmp_path / f"kitti_00-{robot}", channels)
        (tmp_path / f"kitti_00-{robot}.txt").write_text(tum_rows(SCENE.stamps_ns, SCENE.poses))
    sequences = open_dataset(tmp_path).sequences
    assert [s.name for s in sequences] == ["kitti_00-0", "kitti_00-1"]
    for sequence in sequences:
        assert sequence.rig.kind is RigKind.STEREO and sequence.rig.baseline_m == pytest.approx(BASELINE_M)
        assert sequence.groundtruth is not None and not sequence.problems
        np.testing.assert_allclose(sequence.groundtruth.centres, SCENE.poses[:, :3, 3], atol=1e-9)


def test_truth_that_cannot_be_read_is_said(tmp_path: Path) -> None:
    write_ros1(tmp_path / "alice.bag", [raw("/image_raw", SCENE.images, "mono8"), info("/camera_info")])
    for text, said in (("1 2 3\n", "positions without rotations"), ("0 0 0 0 0 0 1\n" * 6, "poses without times")):
        (tmp_path / "alice_groundtruth.txt").write_text(text)
        [sequence] = open_dataset(tmp_path / "alice.bag").sequences
        assert (
            sequence.groundtruth is None
            and said in messages(sequence)
            and "errors cannot be known" in messages(sequence)
        )


def test_a_text_of_the_recording_s_name_is_no_ground_truth(tmp_path: Path) -> None:
    write_ros1(tmp_path / "alice.bag", [raw("/image_raw", SCENE.images, "mono8"), info("/camera_info")])
    (tmp_path / "alice.txt").write_text("Driven on Monday, windy.\n")
    [sequence] = open_dataset(tmp_path / "alice.bag").sequences
    assert sequence.groundtruth is None and not sequence.problems


def test_other_settings_of_the_recording_s_name_are_no_calibration(tmp_path: Path) -> None:
    write_ros1(tmp_path / "10_alice.bag", [raw("/image_raw", SCENE.images, "mono8"), info("/camera_info")])
    (tmp_path / "10_alice.json").write_text('{"driver": "Ann"}')
    (tmp_path / "alice.yaml").write_text("colour: red\n")
    [sequence] = open_dataset(tmp_path / "10_alice.bag").sequences
    assert sequence.rig.camera.fx == FX and not sequence.problems
    (tmp_path / "alice.yaml").write_text(CAMERA.replace("fx: ", "fx: -"))
    with pytest.raises(FrontendError, match=r"alice.yaml: focal lengths"):
        open_dataset(tmp_path / "10_alice.bag")
    (tmp_path / "10_alice.yaml").write_text("colour: red\n")
    with pytest.raises(FrontendError, match=r"10_alice.yaml: no camera in this file"):
        open_dataset(tmp_path / "10_alice.bag")
