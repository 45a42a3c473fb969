"""Robots of one team whose cameras differ in kind, lens, size and rate: in one folder, and in one bag."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from dataset_makers import BASELINE_M, COUNT, CX, CY, FX, FY, HEIGHT, WIDTH, make_scene, own_camera, write_images
from recording_makers import (
    IMAGE,
    INFO,
    TRANSFORMS,
    Channel,
    image_message,
    info_message,
    transforms_message,
    write_ros2,
)

from maslam.backend.geometry import se3
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset

SCENE = make_scene()
K = np.array([[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]])
FISHEYE = (0.02, -0.01, 0.004, -0.001)
T_LEFT_RIGHT = se3(np.eye(3), [BASELINE_M, 0.0, 0.0])
SMALL = SCENE.images[:, ::2, ::2]
K_SMALL = np.array([[FX / 2, 0.0, CX / 2], [0.0, FY / 2, CY / 2], [0.0, 0.0, 1.0]])


def write_folder(root: Path) -> Path:
    names = [f"{i:06d}.png" for i in range(COUNT)]
    write_images(root / "Alice/cam0", names, SCENE.images)
    write_images(root / "Alice/cam1", names, SCENE.rights)
    camera = {
        "camera_model": "pinhole",
        "distortion_model": "equidistant",
        "distortion_coeffs": list(FISHEYE),
        "intrinsics": [FX, FY, CX, CY],
        "resolution": [WIDTH, HEIGHT],
    }
    chain = {"cam0": camera, "cam1": {**camera, "T_cn_cnm1": np.linalg.inv(T_LEFT_RIGHT).tolist()}}
    (root / "Alice/camchain.yaml").write_text(yaml.safe_dump(chain))
    (root / "Alice/times.txt").write_text("".join(f"{i / 20}\n" for i in range(COUNT)))
    write_images(root / "Bob", names[:3], SMALL[:3])
    small = {"width": WIDTH // 2, "height": HEIGHT // 2, "fx": FX / 2, "fy": FY / 2, "cx": CX / 2, "cy": CY / 2}
    (root / "Bob/camera.yaml").write_text(yaml.safe_dump({**small, "rate_hz": 5}))
    write_images(root / "Carol/rgb", names, SCENE.images)
    write_images(root / "Carol/depth", names, SCENE.depth_mm)
    (root / "Carol/camera.yaml").write_text(own_camera("rate_hz: 30\ndepth_unit_m: 0.001\n"))
    return root


def write_bag(root: Path) -> Path:
    def stamps(rate_hz: float) -> list[int]:
        return [10**18 + round(i * 1e9 / rate_hz) for i in range(COUNT)]

    def images(topic: str, pixels: np.ndarray, rate_hz: float, encoding: str = "mono8") -> Channel:
        times = stamps(rate_hz)
        return Channel(topic, IMAGE, times[: len(pixels)], lambda s, i: image_message(s, times[i], pixels[i], encoding))

    def info(topic: str, size: tuple[int, int], matrix: np.ndarray, frame: str = "camera", **values: object) -> Channel:
        make = info_message
        return Channel(topic, INFO, [10**18], lambda s, i: make(s, 10**18, size, matrix, frame=frame, **values))  # type: ignore[arg-type]

    size, fisheye = (WIDTH, HEIGHT), {"model": "equidistant", "D": FISHEYE}
    links = [("Alice/left_optical", "Alice/right_optical", T_LEFT_RIGHT)]
    write_ros2(root / "team", [
        images("/Alice/left/image_raw", SCENE.images, 20),
        images("/Alice/right/image_raw", SCENE.rights, 20),
        info("/Alice/left/camera_info", size, K, "Alice/left_optical", **fisheye),
        info("/Alice/right/camera_info", size, K, "Alice/right_optical", **fisheye),
        Channel("/tf_static", TRANSFORMS, [10**18], lambda s, i: transforms_message(s, links)),
        images("/Bob/cam/image_raw", SMALL[:3], 5),
        info("/Bob/cam/camera_info", (WIDTH // 2, HEIGHT // 2), K_SMALL),
        images("/Carol/color/image_raw", SCENE.images, 30),
        info("/Carol/color/camera_info", size, K),
        images("/Carol/aligned_depth_to_color/image_raw", SCENE.depth_mm, 30, "16UC1"),
        info("/Carol/aligned_depth_to_color/camera_info", size, K),
    ])  # fmt: skip
    return root / "team"


@pytest.mark.parametrize("write", [write_folder, write_bag])
def test_each_robot_keeps_its_own_camera_size_and_rate(tmp_path: Path, write) -> None:  # type: ignore[no-untyped-def]
    if write is write_bag:
        pytest.importorskip("rosbags", reason="the extra `bags` is not installed")
    dataset = open_dataset(write(tmp_path))
    alice, bob, carol = dataset.sequences
    assert [s.name for s in dataset.sequences] == ["Alice", "Bob", "Carol"]
    assert [s.rig.kind for s in dataset.sequences] == [RigKind.STEREO, RigKind.MONO, RigKind.RGBD]
    assert [s.stored_size for s in dataset.sequences] == [(WIDTH, HEIGHT), (WIDTH // 2, HEIGHT // 2), (WIDTH, HEIGHT)]
    assert [_rate_hz(s) for s in dataset.sequences] == pytest.approx([20.0, 5.0, 30.0], rel=1e-6)
    assert not any(s.problems for s in dataset.sequences)
    assert alice.stored_camera is not None and alice.stored_camera.distortion == "equidistant"
    assert alice.stored_camera.coefficients == FISHEYE and alice.rig.baseline_m == pytest.approx(BASELINE_M)
    assert bob.stored_camera is None and bob.rig.camera.fx == FX / 2
    np.testing.assert_array_equal(bob.read_image(2), SMALL[2])
    np.testing.assert_allclose(carol.read(3).depth_m, SCENE.depth_mm[3] / 1000.0, rtol=1e-6)


def _rate_hz(sequence: ImageSequence) -> float:
    return 1e9 / float(np.median(np.diff(sequence.stamps_ns)))
