"""Bags of every format and compression: images, times and cameras against what was written."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from contracts import ReaderContract
from dataset_makers import BASELINE_M, COUNT, CX, CY, FX, FY, HEIGHT, START_NS, WIDTH, make_scene
from recording_makers import (
    COMPRESSED,
    IMAGE,
    INFO,
    POSE,
    Channel,
    compressed_message,
    image_message,
    info_message,
    pose_message,
    write_ros1,
    write_ros2,
)

import maslam
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import Dataset, ImageSequence, open_dataset
from maslam.frontend.datasets.recordings.bags import BagReader
from maslam.frontend.datasets.stored_image import name_in
from maslam.frontend.errors import FrontendError
from maslam.frontend.recording_config import RecordingConfig

pytest.importorskip("rosbags", reason="the extra `bags` is not installed")

SCENE = make_scene()
STAMPS = SCENE.stamps_ns.tolist()
RECEIVED = [stamp + 7_000_000 for stamp in STAMPS]
K = np.array([[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]])
SIZE = (WIDTH, HEIGHT)
P_RIGHT = np.hstack([K, [[-FX * BASELINE_M], [0.0], [0.0]]])
FORMATS = {
    "run.bag": "", "lz4.bag": "lz4", "bz2.bag": "bz2", "sqlite3": "", "sqlite3_message": "message", "mcap": "",
    "mcap_storage": "storage", "mcap_message": "message", "sqlite3_file": "file", "mcap_file": "file",
}  # fmt: skip
CAMERA = f"width: {WIDTH}\nheight: {HEIGHT}\nfx: {FX}\nfy: {FY}\ncx: {CX}\ncy: {CY}\n"


def raw(topic: str, pixels: Sequence[Any], encoding: str, stamps: Sequence[int] = STAMPS) -> Channel:
    return Channel(topic, IMAGE, RECEIVED, lambda store, i: image_message(store, stamps[i], pixels[i], encoding))


def packed(topic: str, files: Sequence[bytes], form: str) -> Channel:
    return Channel(topic, COMPRESSED, RECEIVED, lambda store, i: compressed_message(store, STAMPS[i], files[i], form))


def info(topic: str, **values: Any) -> Channel:
    return Channel(topic, INFO, RECEIVED, lambda store, i: info_message(store, STAMPS[i], SIZE, K, **values))


def png(pixels: np.ndarray) -> bytes:
    return cv2.imencode(".png", pixels)[1].tobytes()


def pair_of(robot: str = "") -> list[Channel]:
    return [
        raw(f"{robot}/left/image_rect", SCENE.images, "mono8"),
        raw(f"{robot}/right/image_rect", SCENE.rights, "mono8"),
        info(f"{robot}/left/camera_info"),
        info(f"{robot}/right/camera_info", P=P_RIGHT),
    ]


def write(path: Path, channels: Sequence[Channel]) -> Path:
    """A bag in the format that its name says."""
    if path.suffix == ".bag":
        write_ros1(path, channels, FORMATS[path.name])
    else:
        write_ros2(path, channels, path.name.split("_")[0], FORMATS[path.name])
    return path


def opened(path: Path, channels: Sequence[Channel], **settings: Any) -> Dataset:
    return open_dataset(write(path, channels), recording=RecordingConfig(**settings))


def only(path: Path, channels: Sequence[Channel], **settings: Any) -> ImageSequence:
    (sequence,) = opened(path, channels, **settings).sequences
    return sequence


def messages(sequence: ImageSequence) -> str:
    return "\n".join(problem.message for problem in sequence.problems)


class TestBagReader(ReaderContract):
    def make(self) -> maslam.Reader:
        return BagReader()

    def write(self, folder: Path) -> None:
        write_ros1(folder / "run.bag", pair_of())


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_images_that_were_written(tmp_path: Path, name: str) -> None:
    sequence = only(tmp_path / name, pair_of("/car"))
    assert sequence.rig.kind is RigKind.STEREO and sequence.rig.baseline_m == pytest.approx(BASELINE_M)
    assert sequence.stamps_ns.tolist() == STAMPS and not sequence.problems
    camera = sequence.rig.camera
    assert (camera.width, camera.height, camera.fx, camera.cx, camera.cy) == (WIDTH, HEIGHT, FX, CX, CY)
    copy = pickle.loads(pickle.dumps(sequence))  # noqa: S301 - our own; as for a worker process
    for i in (5, 0, 3, 4, 1, 2):
        for one in (sequence, copy):
            frame = one.read(i)
            np.testing.assert_array_equal(frame.image, SCENE.images[i])
            np.testing.assert_array_equal(frame.right, SCENE.rights[i])


@pytest.mark.parametrize("name", ["sqlite3", "mcap"])
def test_the_one_file_of_a_ros2_bag_can_be_named(tmp_path: Path, name: str) -> None:
    folder = write(tmp_path / name, pair_of())
    (file,) = (path for path in folder.iterdir() if path.suffix in (".db3", ".mcap"))
    (sequence,) = open_dataset(file).sequences
    np.testing.assert_array_equal(sequence.read_image(2), SCENE.images[2])


def test_images_are_named_after_file_topic_and_time(tmp_path: Path) -> None:
    sequence = only(tmp_path / "run.bag", pair_of("/car"))
    assert name_in(sequence.left[0], tmp_path) == f"run.bag/car/left/image_rect/{START_NS}"
    assert str(sequence.left[0]).endswith(f"run.bag: /car/left/image_rect at {START_NS} ns")


class TestRobots:
    def test_each_is_a_sequence(self, tmp_path: Path) -> None:
        other = [raw("/bob/camera/image_raw", SCENE.rights, "mono8"), info("/bob/camera/camera_info")]
        dataset = opened(tmp_path / "sqlite3", [*pair_of("/alice"), *other])
        assert dataset.kind == "agents (bag)"
        assert [(s.name, s.rig.kind) for s in dataset.sequences] == [("alice", RigKind.STEREO), ("bob", RigKind.MONO)]
        np.testing.assert_array_equal(dataset.sequences[1].read_image(1), SCENE.rights[1])

    def test_a_topic_s_last_part_names_that_of_every_robot(self, tmp_path: Path) -> None:
        channels = [
            c
            for robot in ("/alice", "/bob")
            for c in [*pair_of(robot), raw(f"{robot}/front/image_raw", SCENE.rights, "mono8")]
        ]
        with pytest.raises(
            FrontendError, match=r"which images are to be read\? --recording.image-topic names the topic: /alice"
        ):
            opened(tmp_path / "run.bag", channels)
        config = RecordingConfig(image_topic="left/image_rect", right_topic="right/image_rect")
        dataset = open_dataset(tmp_path / "run.bag", recording=config)
        assert [(s.name, s.rig.kind) for s in dataset.sequences] == [("alice", RigKind.STEREO), ("bob", RigKind.STEREO)]

    def test_a_bag_for_each(self, tmp_path: Path) -> None:
        for robot in ("alice", "bob"):
            write_ros1(tmp_path / f"{robot}.bag", pair_of())
        assert [s.name for s in open_dataset(tmp_path).sequences] == ["alice", "bob"]

    def test_topics_that_are_not_read_are_listed(self, tmp_path: Path) -> None:
        debug = raw("/car/debug/image", SCENE.images, "mono8")
        assert "not read: /car/debug/image (Image, 6)" in only(tmp_path / "run.bag", [*pair_of("/car"), debug]).origin

    def test_the_error_lists_topics_with_types_and_counts(self, tmp_path: Path) -> None:
        channels = [raw(f"/{side}/image_raw", SCENE.images, "mono8") for side in ("front", "rear")]
        with pytest.raises(FrontendError, match=r"/front/image_raw \(Image, 6\), /rear/image_raw \(Image, 6\)"):
            opened(tmp_path / "run.bag", channels)


class TestTimes:
    def test_stamps_of_headers_sort_and_repeats_are_left_out(self, tmp_path: Path) -> None:
        stamps = [STAMPS[1], STAMPS[0], STAMPS[2], STAMPS[3], STAMPS[3], STAMPS[5]]
        channels = [raw("/image_raw", SCENE.images, "mono8", stamps), info("/camera_info")]
        sequence = only(tmp_path / "run.bag", channels)
        assert sequence.stamps_ns.tolist() == [STAMPS[i] for i in (0, 1, 2, 3, 5)]
        np.testing.assert_array_equal(sequence.read_image(0), SCENE.images[1])
        assert "1 times go back in the order of reception" in messages(sequence)
        assert "1 messages have the time stamp of another" in messages(sequence)

    def test_headers_without_times_take_those_of_reception(self, tmp_path: Path) -> None:
        sequence = only(
            tmp_path / "mcap", [raw("/image_raw", SCENE.images, "mono8", [0] * COUNT), info("/camera_info")]
        )
        assert sequence.stamps_ns.tolist() == RECEIVED
        assert "headers without time stamps: the times of reception are taken" in messages(sequence)

    def test_pairs_are_made_by_time(self, tmp_path: Path) -> None:
        channels = pair_of()
        channels[1] = Channel(
            "/right/image_rect", IMAGE, RECEIVED[:4],
            lambda store, i: image_message(store, STAMPS[i + 1] + 1000, SCENE.rights[i + 1], "mono8"),
        )  # fmt: skip
        sequence = only(tmp_path / "run.bag", channels)
        assert sequence.stamps_ns.tolist() == STAMPS[1:5]
        np.testing.assert_array_equal(sequence.read(0).right, SCENE.rights[1])
        assert "no partner for 2 of 6 frames" in messages(sequence)

    def test_cameras_that_are_not_synchronised_are_named(self, tmp_path: Path) -> None:
        late = [stamp + 20_000_000 for stamp in STAMPS]
        channels = pair_of()
        channels[1] = raw("/right/image_rect", SCENE.rights, "mono8", late)
        assert "not synchronised: 20.0 ms (median)" in messages(only(tmp_path / "run.bag", channels))


class TestCameras:
    def test_a_raw_image_has_its_lens(self, tmp_path: Path) -> None:
        D = (-0.2, 0.05, 0.001, -0.002, 0.0)
        sequence = only(
            tmp_path / "run.bag", [raw("/camera/image_raw", SCENE.images, "mono8"), info("/camera/camera_info", D=D)]
        )
        assert sequence.stored_camera is not None and sequence.stored_camera.coefficients == D

    def test_fisheye_of_ros2(self, tmp_path: Path) -> None:
        D = (-0.01, 0.02, -0.003, 0.0004)
        channels = [
            raw("/camera/image_raw", SCENE.images, "mono8"),
            info("/camera/camera_info", model="equidistant", D=D),
        ]
        stored = only(tmp_path / "sqlite3", channels).stored_camera
        assert stored is not None and stored.distortion == "equidistant" and stored.coefficients == D

    def test_a_rectified_image_has_the_projection_matrix(self, tmp_path: Path) -> None:
        P = np.hstack([K, np.zeros((3, 1))])
        P[0, 0] = 70.0
        channels = [
            raw("/camera/image_rect", SCENE.images, "mono8"),
            info("/camera/camera_info", D=(-0.2, 0.05, 0, 0, 0), P=P),
        ]
        sequence = only(tmp_path / "run.bag", channels)
        assert sequence.stored_camera is None and sequence.rig.camera.fx == 70.0

    def test_a_raw_pair_stands_as_its_matrices_say(self, tmp_path: Path) -> None:
        turn, _ = cv2.Rodrigues(np.array([0.0, 0.02, 0.0]))
        channels = [
            raw("/left/image_raw", SCENE.images, "mono8"),
            raw("/right/image_raw", SCENE.rights, "mono8"),
            info("/left/camera_info"),
            info("/right/camera_info", R=turn, P=P_RIGHT),
        ]
        sequence = only(tmp_path / "run.bag", channels)
        assert sequence.rig.baseline_m == pytest.approx(BASELINE_M) and sequence.rectifier is not None

    def test_a_pair_without_a_baseline_is_one_camera_and_that_is_said(self, tmp_path: Path) -> None:
        channels = [*pair_of()[:3], info("/right/camera_info")]
        sequence = only(tmp_path / "run.bag", channels)
        assert sequence.rig.kind is RigKind.MONO
        assert "right images on /right/image_rect, but no baseline of a pair" in messages(sequence)

    def test_without_camera_info_a_file_beside_the_bag_serves(self, tmp_path: Path) -> None:
        path = write(tmp_path / "run.bag", [raw("/camera/image_raw", SCENE.images, "mono8")])
        with pytest.raises(FrontendError, match=r"no camera_info topic beside /camera/image_raw, and no camera file"):
            open_dataset(path)
        (tmp_path / "run.yaml").write_text(CAMERA)
        assert open_dataset(path).sequences[0].rig.camera.fx == FX

    def test_a_camera_that_is_not_calibrated_is_refused(self, tmp_path: Path) -> None:
        channel = Channel(
            "/camera/camera_info", INFO, RECEIVED, lambda store, i: info_message(store, STAMPS[i], SIZE, 0 * K)
        )
        with pytest.raises(FrontendError, match="the camera is not calibrated: K holds zeros"):
            only(tmp_path / "run.bag", [raw("/camera/image_raw", SCENE.images, "mono8"), channel])

    def test_a_camera_info_of_another_name_is_named(self, tmp_path: Path) -> None:
        channels = [raw("/camera/image_raw", SCENE.images, "mono8"), info("/elsewhere/info")]
        assert only(tmp_path / "run.bag", channels, camera_topic="/elsewhere/info").rig.camera.fy == FY


class TestDepth:
    def channels(self, depth: Channel, **values: Any) -> list[Channel]:
        return [
            raw("/camera/color/image_raw", SCENE.images, "mono8"),
            info("/camera/color/camera_info"),
            depth,
            info("/camera/aligned_depth_to_color/camera_info", **values),
        ]

    def test_millimetres(self, tmp_path: Path) -> None:
        sequence = only(
            tmp_path / "run.bag",
            self.channels(raw("/camera/aligned_depth_to_color/image_raw", SCENE.depth_mm, "16UC1")),
        )
        assert sequence.rig.kind is RigKind.RGBD
        np.testing.assert_allclose(sequence.read(2).depth_m, SCENE.depth_mm[2] / 1000.0, rtol=1e-6)

    def test_metres(self, tmp_path: Path) -> None:
        metres = SCENE.depth_mm.astype(np.float32) / 1000
        metres[:, 5, 5] = np.nan
        sequence = only(
            tmp_path / "mcap", self.channels(raw("/camera/aligned_depth_to_color/image_raw", metres, "32FC1"))
        )
        np.testing.assert_array_equal(sequence.read(2).depth_m, np.nan_to_num(metres[2]))

    def test_compressed_depth(self, tmp_path: Path) -> None:
        files = [bytes(12) + png(depth) for depth in SCENE.depth_mm]
        topic = "/camera/aligned_depth_to_color/image_raw/compressedDepth"
        sequence = only(tmp_path / "sqlite3", self.channels(packed(topic, files, "16UC1; compressedDepth png")))
        np.testing.assert_allclose(sequence.read(4).depth_m, SCENE.depth_mm[4] / 1000.0, rtol=1e-6)

    def test_depth_of_another_camera_is_not_taken_for_the_image_s(self, tmp_path: Path) -> None:
        other = np.diag([1.3, 1.3, 1.0]) @ K
        channels = self.channels(raw("/camera/aligned_depth_to_color/image_raw", SCENE.depth_mm, "16UC1"))
        channels[3] = Channel(
            channels[3].topic, INFO, RECEIVED, lambda store, i: info_message(store, STAMPS[i], SIZE, other)
        )
        sequence = only(tmp_path / "run.bag", channels)
        assert sequence.rig.kind is RigKind.MONO and "is of another camera than" in messages(sequence)


def test_true_poses_of_a_topic_that_is_named(tmp_path: Path) -> None:
    poses = Channel("/car/pose", POSE, RECEIVED, lambda store, i: pose_message(store, STAMPS[i], SCENE.poses[i]))
    sequence = only(tmp_path / "run.bag", [*pair_of("/car"), poses], truth_topic="pose")
    assert sequence.groundtruth is not None and sequence.groundtruth.stamps_ns.tolist() == STAMPS
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=1e-12)
    with pytest.raises(FrontendError, match=r"no topic of poses odom: there are /car/pose \(PoseStamped\)"):
        open_dataset(tmp_path / "run.bag", recording=RecordingConfig(truth_topic="odom"))


def test_moments_without_a_pose_and_times_twice_are_counted(tmp_path: Path) -> None:
    """As odometry sends them that is not started yet: NaN, or a quaternion of zeros."""

    def message(store: Any, i: int) -> Any:
        one = pose_message(store, STAMPS[max(i, 1) if i < 4 else i - 1], SCENE.poses[i])
        if i == 0:
            one.pose.position.x = float("nan")
        if i == 5:
            one.pose.orientation.w = one.pose.orientation.x = one.pose.orientation.y = one.pose.orientation.z = 0.0
        return one

    poses = Channel("/car/pose", POSE, RECEIVED, message)
    sequence = only(tmp_path / "run.bag", [*pair_of("/car"), poses], truth_topic="pose")
    said = " ".join(problem.message for problem in sequence.problems)
    assert f"/car/pose: 2 of {COUNT} messages hold no pose" in said and "/car/pose: 1 poses have the time" in said
    assert sequence.groundtruth is not None
    kept = [i for i in range(COUNT) if i not in (0, 4, 5)]
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses[kept], atol=1e-6)


def test_a_pose_of_another_length_is_none(tmp_path: Path) -> None:
    def message(store: Any, i: int) -> Any:
        one = pose_message(store, STAMPS[i], SCENE.poses[i])
        one.pose.orientation.w += 0.3 * (i == 2)
        return one

    write(tmp_path / "run.bag", [*pair_of("/car"), Channel("/car/pose", POSE, RECEIVED, message)])
    with pytest.raises(FrontendError, match="message 2 is no pose: its quaternion's length is 1"):
        open_dataset(tmp_path / "run.bag", recording=RecordingConfig(truth_topic="pose"))


def test_without_the_package_one_line_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "run.bag", pair_of())
    monkeypatch.setitem(sys.modules, "rosbags.interfaces", None)
    with pytest.raises(FrontendError, match=r'bags are read by the package rosbags: pip install "maslam\[bags\]"'):
        open_dataset(path)
