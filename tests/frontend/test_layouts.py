"""Layouts of public data sets: the contract of every kind, and what is particular to each."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import (
    BASELINE_M,
    COUNT,
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    Scene,
    make_scene,
    own_camera,
    tum_rows,
    write_images,
)
from layout_makers import (
    DRIVE,
    listed,
    write_associations,
    write_kitti_raw,
    write_replica,
    write_scannet,
    write_tartanair,
    write_tum_vi,
)
from test_datasets import Contract

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import Severity, open_dataset
from maslam.frontend.errors import FrontendError

T_CAMERA_IMU = se3(so3_exp([0.3, -0.2, 1.4]), [0.05, -0.02, 0.01])


class TestReplica(Contract):
    kind, rigs, left = "replica", (RigKind.RGBD, RigKind.MONO), "results/frame*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_replica(folder, scene)

    def expected_stamps(self, scene: Scene) -> np.ndarray:
        return np.rint(np.arange(COUNT) * 1e9 / 30).astype(np.int64)


class TestScanNet(Contract):
    kind, rigs, left = "scannet", (RigKind.RGBD, RigKind.MONO), "color/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_scannet(folder, scene)

    def expected_stamps(self, scene: Scene) -> np.ndarray:
        return np.arange(COUNT) * 10**9 // 30

    @pytest.fixture
    def scene(self) -> Scene:
        """A wall that faces the camera, nearer each time: registering it changes nothing."""
        depth_mm = np.broadcast_to((2000 - 150 * np.arange(COUNT))[:, None, None], (COUNT, HEIGHT, WIDTH))
        return replace(make_scene(), depth_mm=depth_mm.astype(np.uint16))


class TestTartanAir(Contract):
    kind, rigs, left = "tartanair", (RigKind.STEREO, RigKind.RGBD, RigKind.MONO), "image_left/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_tartanair(folder, scene)

    def expected_stamps(self, scene: Scene) -> np.ndarray:
        return np.arange(COUNT) * 10**8


class TestKittiRaw(Contract):
    kind, rigs, left = "kitti-raw", (RigKind.STEREO, RigKind.MONO), "image_00/data/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        day = write_kitti_raw(folder.parent / "raw", scene)
        folder.rmdir()
        day.rename(folder)
        (day.parent / "calib_cam_to_cam.txt").rename(folder.parent / "calib_cam_to_cam.txt")

    def test_ground_truth(self, folder: Path, scene: Scene) -> None:
        assert self.open(folder).groundtruth is None, "a drive without GPS has none"


class TestTumVi(Contract):
    kind, rigs, left = "tum-vi", (RigKind.STEREO, RigKind.MONO), "mav0/cam0/data/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_tum_vi(folder, scene, T_CAMERA_IMU)


class TestAssociations(Contract):
    kind, rigs, left = "associations", (RigKind.RGBD, RigKind.MONO), "rgb/*.png"

    def write(self, folder: Path, scene: Scene) -> None:
        write_associations(folder, scene)


# ---- Replica, and colour and depth in one folder


def test_replica_named_by_its_inner_folder(tmp_path: Path) -> None:
    scene = make_scene()
    write_replica(tmp_path / "office0", scene)
    [sequence] = open_dataset(tmp_path / "office0/results").sequences
    assert sequence.name == "office0" and sequence.rig.kind is RigKind.RGBD and len(sequence) == COUNT
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses, atol=1e-8)


def test_colour_and_depth_in_one_folder_with_a_calibration_of_ours(tmp_path: Path) -> None:
    """Case 18: depth is never tracked as images."""
    scene = make_scene()
    write_replica(tmp_path / "here", scene)
    (tmp_path / "cam_params.json").unlink()
    (tmp_path / "here/results/camera.yaml").write_text(own_camera("depth_unit_m: 0.002\nrate_hz: 5\n"))
    for folder in (tmp_path / "here", tmp_path / "here/results"):
        [sequence] = open_dataset(folder).sequences
        assert sequence.rig.kind is RigKind.RGBD and sequence.stamps_ns[1] == 200_000_000
        np.testing.assert_allclose(sequence.read(1).depth_m, scene.depth_mm[1] * 0.002, atol=1e-5)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('"fx": 80.0', '"fx": -80.0', "cannot be"),
        ('"fx": 80.0', '"fx": "wide"', "a camera with w, h, fx, fy, cx, cy expected"),
        ('"w"', '"v"', "a camera with w, h, fx, fy, cx, cy expected"),
        ("{", "[", "a camera with w, h, fx, fy, cx, cy expected"),
        ('"scale": 1000.0', '"scale": 0', "scale 0.0 cannot be"),
        (f'"w": {WIDTH}', '"w": 1200', "a calibration for 1200x64 pixels"),
    ],
)
def test_wrong_parameters_of_replica(tmp_path: Path, old: str, new: str, said: str) -> None:
    write_replica(tmp_path / "office0", make_scene())
    path = tmp_path / "cam_params.json"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FrontendError, match=rf"cam_params.json: .*{said}"):
        open_dataset(tmp_path / "office0")


# ---- ScanNet


def test_scannet_depth_of_another_size_lies_on_the_image(tmp_path: Path) -> None:
    """A step in depth is where the same step is in the image, though depth has half as many pixels."""
    depth = np.full((COUNT, HEIGHT, WIDTH), 2000, np.uint16)
    depth[:, :, WIDTH // 2 :] = 3000
    write_scannet(tmp_path, replace(make_scene(), depth_mm=depth), depth_scale=0.5)
    assert cv2.imread(str(tmp_path / "depth/0.png"), cv2.IMREAD_UNCHANGED).shape == (HEIGHT // 2, WIDTH // 2)
    [sequence] = open_dataset(tmp_path).sequences
    found = sequence.read(0).depth_m
    assert found is not None and found.shape == (HEIGHT, WIDTH)
    np.testing.assert_allclose(found[4:-4, 4 : WIDTH // 2 - 3], 2.0, atol=1e-3)
    np.testing.assert_allclose(found[4:-4, WIDTH // 2 + 3 : -4], 3.0, atol=1e-3)


def test_scannet_frames_without_a_pose(tmp_path: Path) -> None:
    scene = make_scene()
    write_scannet(tmp_path, scene)
    (tmp_path / "pose/2.txt").write_text("-inf -inf -inf -inf\n" * 4)
    (tmp_path / "pose/4.txt").unlink()
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses[[0, 1, 3, 5]], atol=1e-8)
    [problem] = sequence.problems
    assert f"{tmp_path / 'pose'}: a true pose" in problem.message and "for 4 of 6 frames" in problem.message


# ---- TartanAir


def test_tartanair_without_a_calibration_has_the_published_camera(tmp_path: Path) -> None:
    """320 px at 640: a field of 90 degrees at any size."""
    write_tartanair(tmp_path, make_scene(), own=False)
    [sequence] = open_dataset(tmp_path).sequences
    camera = sequence.rig.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (WIDTH / 2, WIDTH / 2, WIDTH / 2, HEIGHT / 2)
    assert sequence.rig.baseline_m == pytest.approx(0.25)


def test_tartanair_of_the_second_version(tmp_path: Path) -> None:
    scene = make_scene()
    write_tartanair(tmp_path, scene)
    for old, new in (("left", "lcam_front"), ("right", "rcam_front")):
        for path in (tmp_path / f"image_{old}").iterdir():
            path.rename(path.with_name(path.name.replace(old, new)))
        (tmp_path / f"image_{old}").rename(tmp_path / f"image_{new}")
    (tmp_path / "pose_left.txt").rename(tmp_path / "pose_lcam_front.txt")
    (tmp_path / "depth_left").rename(tmp_path / "depth_lcam_front")
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.kind == "tartanair" and sequence.rig.kind is RigKind.STEREO and sequence.problems == ()
    np.testing.assert_allclose(sequence.read(1).right, scene.rights[1], atol=1)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses, atol=1e-8)
    for path in (tmp_path / "image_rcam_front").iterdir():
        path.unlink()
    (tmp_path / "image_rcam_front").rmdir()
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is RigKind.MONO and "depth packed into colours is not read" in sequence.problems[0].message


def test_tartanair_depth_arrays(tmp_path: Path) -> None:
    scene = make_scene()
    write_tartanair(tmp_path, scene)
    depth = (scene.depth_mm[2] / 1000.0).astype(np.float32)
    depth[10, 10:14] = [np.inf, np.nan, 1e6, -1.0]
    np.save(tmp_path / "depth_left/000002_left_depth.npy", depth)
    np.save(tmp_path / "depth_left/000003_left_depth.npy", scene.depth_mm[3].astype(np.int64))
    np.save(tmp_path / "depth_left/000004_left_depth.npy", np.array([object()]), allow_pickle=True)
    path = tmp_path / "depth_left/000005_left_depth.npy"
    path.write_bytes(path.read_bytes()[:-8])
    [sequence] = open_dataset(tmp_path, RigKind.RGBD).sequences
    read = sequence.read(2).depth_m
    assert read is not None and (read[10, 10:14] == 0).all()
    np.testing.assert_allclose(read[20:], depth[20:], atol=1e-6)
    for i, said in ((3, r"found 1 of 64 bits \(int64\)"), (4, "not a whole array"), (5, "not a whole array")):
        with pytest.raises(FrontendError, match=rf"00000{i}_left_depth.npy: .*{said}"):
            sequence.read(i)


# ---- KITTI raw


def oxts(folder: Path, degrees: float) -> None:
    """A drive to the east: 1 m a frame, at 49 degrees north, turned to the left by ``degrees`` a frame."""
    (folder / "oxts/data").mkdir(parents=True)
    for i in range(COUNT):
        lon = 8.4 + np.degrees(i / (6_378_137.0 * np.cos(np.radians(49.0))))
        values = [49.0, lon, 110.0 + 0.1 * i, 0.0, 0.0, np.radians(degrees * i), *([0.0] * 24)]
        (folder / f"oxts/data/{i:010d}.txt").write_text(" ".join(f"{v:.15f}" for v in values) + "\n")


def test_kitti_raw_ground_truth_by_gps(tmp_path: Path) -> None:
    drive = write_kitti_raw(tmp_path, make_scene())
    oxts(drive, 3.0)
    [sequence] = open_dataset(drive).sequences
    assert sequence.groundtruth is None and "calib_imu_to_velo.txt: missing" in sequence.problems[0].message
    # The camera looks along the IMU's x; 1 m before it, 0.5 m above.
    R = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0.0]])
    (drive.parent / "calib_imu_to_velo.txt").write_text(f"R: {listed(np.eye(3))}\nT: 0 0 -0.5\n")
    (drive.parent / "calib_velo_to_cam.txt").write_text(f"calib_time: today\nR: {listed(R)}\nT: 0 0 -1\n")
    [sequence] = open_dataset(drive).sequences
    truth = sequence.groundtruth
    assert truth is not None and sequence.problems == ()
    turns = np.radians(3.0 * np.arange(COUNT))
    centres = np.stack([np.arange(COUNT) + np.cos(turns), np.sin(turns), 0.1 * np.arange(COUNT) + 0.5], axis=1)
    np.testing.assert_allclose(truth.centres, centres, atol=1e-6)
    forward = np.stack([np.cos(turns), np.sin(turns), np.zeros(COUNT)], axis=1)
    np.testing.assert_allclose(truth.poses[:, :3, 2], forward, atol=1e-9)


def test_kitti_raw_from_the_folder_above(tmp_path: Path) -> None:
    """Case 49: the only drive is taken, and that is said."""
    write_kitti_raw(tmp_path, make_scene())
    dataset = open_dataset(tmp_path)
    assert dataset.kind == "kitti-raw" and f"{tmp_path / DRIVE} is the only sequence" in dataset.notes[0]


def test_kitti_raw_before_rectification(tmp_path: Path) -> None:
    """Images of the size before rectification take the lens and the pose of each camera."""
    drive = write_kitti_raw(tmp_path, make_scene())
    path = drive.parent / "calib_cam_to_cam.txt"
    path.write_text(
        path.read_text()
        .replace(f"{WIDTH:.6e} {HEIGHT:.6e}", "9.000000e+01 6.000000e+01")
        .replace(f"{WIDTH + 10:.6e} {HEIGHT + 10:.6e}", f"{WIDTH:.6e} {HEIGHT:.6e}")
        + "".join(
            f"K_{name}: {FX} 0 {CX} 0 {FY} {CY} 0 0 1\nD_{name}: -0.2 0.05 0 0 0\n"
            f"R_{name}: 1 0 0 0 1 0 0 0 1\nT_{name}: {x} 0 0\n"
            for name, x in (("00", 0.0), ("01", -BASELINE_M))
        )
    )
    [sequence] = open_dataset(drive).sequences
    assert sequence.rectifier is not None and sequence.rig.baseline_m == pytest.approx(BASELINE_M)


@pytest.mark.parametrize(
    ("file", "old", "new", "said"),
    [
        (
            "image_00/timestamps.txt",
            "2014-06-25",
            "someday",
            r"timestamps.txt:2: 1 columns, but the rows before have 2",
        ),
        ("../calib_cam_to_cam.txt", "P_rect_00: 8", "P_rect_00: -8", "P_rect_00: focal lengths -80.0"),
        ("../calib_cam_to_cam.txt", "P_rect_00", "P_00", "P_rect_00: 12 numbers expected, found 0"),
    ],
)
def test_wrong_files_of_kitti_raw(tmp_path: Path, file: str, old: str, new: str, said: str) -> None:
    drive = write_kitti_raw(tmp_path, make_scene())
    path = drive / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FrontendError, match=said):
        open_dataset(drive)


# ---- TUM-VI


def test_images_in_euroc_layout_without_any_calibration(tmp_path: Path) -> None:
    write_tum_vi(tmp_path, make_scene(), T_CAMERA_IMU)
    (tmp_path / "dso/camchain.yaml").unlink()
    with pytest.raises(FrontendError, match=r"mav0/cam0/data: images, but neither a sensor.yaml .*dso/camchain.yaml"):
        open_dataset(tmp_path)
    (tmp_path / "camera.yaml").write_text(own_camera(f"baseline_m: {BASELINE_M}\n"))
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is RigKind.STEREO and sequence.groundtruth is None
    assert "no T_cam_imu" in sequence.problems[0].message


# ---- lists of associations


@pytest.mark.parametrize("form", ["rgb depth", "depth rgb", "rgb depth gt", "rgb gt", "rgb gt depth"])
@pytest.mark.parametrize("name", ["associations.txt", "associate.txt", "fr1_desk_assoc.txt", "rgbd_assoc_poses.txt"])
def test_associations_in_any_order(tmp_path: Path, form: str, name: str) -> None:
    scene = make_scene()
    write_associations(tmp_path, scene, form, name)
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is (RigKind.RGBD if "depth" in form else RigKind.MONO)
    np.testing.assert_array_equal(sequence.stamps_ns, scene.stamps_ns)
    np.testing.assert_array_equal(sequence.read(3).image, scene.images[3])
    if "depth" in form:
        np.testing.assert_allclose(sequence.read(3).depth_m, scene.depth_mm[3] / 1000.0, atol=1e-6)
    assert (sequence.groundtruth is not None) == ("gt" in form)


def test_associations_with_ground_truth_beside(tmp_path: Path) -> None:
    scene = make_scene()
    write_associations(tmp_path, scene, "rgb depth")
    (tmp_path / "groundtruth.txt").write_text(tum_rows(scene.stamps_ns, scene.poses))
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, scene.poses, atol=1e-8)


def test_associations_by_frame_number(tmp_path: Path) -> None:
    write_images(tmp_path / "rgb", [f"{i}.png" for i in range(COUNT)], make_scene().images)
    (tmp_path / "camera.yaml").write_text(own_camera())
    (tmp_path / "associations.txt").write_text("".join(f"{i} rgb/{i}.png\n" for i in range(COUNT)))
    [sequence] = open_dataset(tmp_path).sequences
    np.testing.assert_allclose(np.diff(sequence.stamps_ns), 1e9 / 30, atol=1)
    assert [p.severity for p in sequence.problems] == [Severity.WARNING] and "frame numbers" in sequence.problems[
        0
    ].message


@pytest.mark.parametrize(
    "line", ["1.0 rgb/a.png depth/a.png", "rgb/a.png", "1 rgb/a.png 2", "x rgb/a.png 1 depth/b.png"]
)
def test_broken_lines_of_associations(tmp_path: Path, line: str) -> None:
    write_associations(tmp_path, make_scene(), "rgb depth")
    path = tmp_path / "associations.txt"
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(FrontendError, match=rf"associations.txt:{COUNT + 1}: time file time file"):
        open_dataset(tmp_path)
