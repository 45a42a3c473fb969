"""How the cameras of a bag stand where only tf says it: pairs, and depth of a camera of its own."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from dataset_makers import BASELINE_M, COUNT, CX, CY, FX, FY, HEIGHT, WIDTH, make_scene
from numpy.typing import NDArray
from recording_makers import (
    IMAGE,
    INFO,
    TRANSFORMS,
    Channel,
    image_message,
    info_message,
    transforms_message,
    write_ros1,
    write_ros2,
)

from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset

pytest.importorskip("rosbags", reason="the extra `bags` is not installed")

SCENE = make_scene()
STAMPS = SCENE.stamps_ns.tolist()
K = np.array([[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]])
Link = tuple[str, str, NDArray[np.float64]]
# Axes of a vehicle's body in those of its cameras: x ahead is the camera's z, y left its -x, z up its -y.
T_BODY_OPTICAL = se3(np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0.0]]), [0.3, 0.1, 0.2])
T_LEFT_RIGHT = se3(so3_exp([0.01, -0.02, 0.005]), [BASELINE_M, 0.002, -0.001])
T_BASE_RIG = se3(so3_exp([0.1, 0.2, 0.3]), [1.0, 2.0, 3.0])
CHAIN: list[Link] = [
    ("base_link", "left_optical", T_BODY_OPTICAL),
    ("base_link", "rig", T_BASE_RIG),
    ("rig", "right_optical", se3_inverse(T_BASE_RIG) @ T_BODY_OPTICAL @ T_LEFT_RIGHT),
]  # fmt: skip


def images(topic: str, pixels: Sequence[Any], encoding: str = "mono8") -> Channel:
    return Channel(topic, IMAGE, STAMPS, lambda store, i: image_message(store, STAMPS[i], pixels[i], encoding))


def info(topic: str, frame: str, size: tuple[int, int] = (WIDTH, HEIGHT), K: Any = K, **values: Any) -> Channel:
    return Channel(topic, INFO, STAMPS, lambda store, i: info_message(store, STAMPS[i], size, K, frame=frame, **values))


def tf(links: Sequence[Link], topic: str = "/tf_static") -> Channel:
    return Channel(topic, TRANSFORMS, STAMPS[:1], lambda store, i: transforms_message(store, links))


def pair(last: str = "image_raw", frames: tuple[str, str] = ("left_optical", "right_optical")) -> list[Channel]:
    return [
        images(f"/car/left/{last}", SCENE.images),
        images(f"/car/right/{last}", SCENE.rights),
        info("/car/left/camera_info", frames[0]),
        info("/car/right/camera_info", frames[1]),
    ]


def opened(path: Path, channels: Sequence[Channel]) -> ImageSequence:
    (write_ros1 if path.suffix == ".bag" else write_ros2)(path, channels)
    [sequence] = open_dataset(path).sequences
    return sequence


def messages(sequence: ImageSequence) -> str:
    return "\n".join(problem.message for problem in sequence.problems)


@pytest.mark.parametrize("name", ["run.bag", "run"])
@pytest.mark.parametrize("topic", ["/tf_static", "/car/tf_static", "/tf"])
def test_a_raw_pair_stands_as_tf_says(tmp_path: Path, name: str, topic: str) -> None:
    """OpenCV's own rectification of what was written is the truth."""
    sequence = opened(tmp_path / name, [*pair(), tf(CHAIN, topic)])
    assert sequence.rig.kind is RigKind.STEREO and not sequence.problems
    T = se3_inverse(T_LEFT_RIGHT)
    none = np.zeros(4)
    R_left, _, _, P_right, *_ = cv2.stereoRectify(K, none, K, none, (WIDTH, HEIGHT), T[:3, :3].copy(), T[:3, 3:].copy())
    assert sequence.rig.baseline_m == pytest.approx(-P_right[0, 3] / P_right[0, 0], abs=1e-9)
    np.testing.assert_allclose(sequence.R_rectified_left, R_left, atol=1e-9)
    assert "camera_info, with tf: 0.25 m between left_optical and right_optical" in sequence.understood[0].sentence()


def test_a_rectified_pair_has_its_baseline_by_tf(tmp_path: Path) -> None:
    links = [("base_link", "left_optical", T_BODY_OPTICAL),
             ("left_optical", "right_optical", se3(np.eye(3), [BASELINE_M, 0.0, 0.0]))]  # fmt: skip
    sequence = opened(tmp_path / "run.bag", [*pair("image_rect"), tf(links)])
    assert sequence.rectifier is None and not sequence.problems
    assert sequence.rig.baseline_m == pytest.approx(BASELINE_M)


def test_a_rectified_pair_that_tf_turns_is_said(tmp_path: Path) -> None:
    sequence = opened(tmp_path / "run.bag", [*pair("image_rect"), tf(CHAIN)])
    assert sequence.rectifier is None and sequence.rig.baseline_m == pytest.approx(BASELINE_M)
    assert "images called rectified, but by tf the right camera is turned by 1.3 degrees" in messages(sequence)


def test_frames_with_a_body_s_axes(tmp_path: Path) -> None:
    """Frames of the housings: x ahead, y to the left; the right camera stands at -y."""
    R = T_BODY_OPTICAL[:3, :3]
    turned = se3(R, np.zeros(3)) @ T_LEFT_RIGHT @ se3(R.T, np.zeros(3))
    links = [("base", "left_link", np.eye(4)), ("left_link", "right_link", turned)]
    sequence = opened(tmp_path / "run.bag", [*pair(frames=("left_link", "right_link")), tf(links)])
    assert sequence.rig.baseline_m == pytest.approx(np.linalg.norm(T_LEFT_RIGHT[:3, 3]))
    assert "turned from a body's axes" in sequence.understood[0].sentence() and not sequence.problems


def _moving(links: list[Link]) -> list[Channel]:
    def make(store: Any, i: int) -> Any:
        parent, child, pose = links[2]
        return transforms_message(store, [*links[:2], (parent, child, pose @ se3(np.eye(3), [0.01 * i, 0.0, 0.0]))])

    return [Channel("/tf", TRANSFORMS, STAMPS, make)]


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (lambda: [], "no baseline of a pair"),
        (lambda: [tf(CHAIN[:2])], "no baseline of a pair"),
        (lambda: [tf(CHAIN, "/other/tf_static")], "no baseline of a pair"),
        (lambda: _moving(CHAIN), "no baseline of a pair"),
        (lambda: [tf([(a, b, np.full((4, 4), np.nan)) for a, b, _ in CHAIN])], "no baseline of a pair"),
    ],
)
def test_without_a_chain_that_stands_still_it_is_one_camera(
    tmp_path: Path, what: Callable[[], list[Channel]], said: str
) -> None:
    sequence = opened(tmp_path / "run", [*pair(), *what()])
    assert sequence.rig.kind is RigKind.MONO and said in messages(sequence)
    assert "tf between the two frames" in messages(sequence)


def test_camera_info_and_tf_that_contradict_each_other_are_said(tmp_path: Path) -> None:
    P = np.hstack([K, [[-FX * 0.4], [0.0], [0.0]]])
    channels = pair()
    channels[3] = info("/car/right/camera_info", "right_optical", P=P)
    sequence = opened(tmp_path / "run.bag", [*channels, tf(CHAIN)])
    assert sequence.rig.baseline_m == pytest.approx(0.4)
    assert "0.4 m between the cameras by its projection matrix, 0.25 m between" in messages(sequence)


class TestDepth:
    SMALL = np.diag([0.5, 0.5, 1.0]) @ K

    def channels(self, depth_mm: NDArray[np.uint16], **values: Any) -> list[Channel]:
        size = (depth_mm.shape[2], depth_mm.shape[1])
        return [
            images("/camera/color/image_raw", SCENE.images),
            info("/camera/color/camera_info", "color_optical"),
            images("/camera/depth/image_rect_raw", depth_mm, "16UC1"),
            info("/camera/depth/camera_info", "depth_optical", size=size, K=self.SMALL, **values),
        ]

    def test_a_wall_seen_from_beside_lies_where_the_image_sees_it(self, tmp_path: Path) -> None:
        """Planes facing both cameras, 2 and 3 m away; their border at x = 0 m of the depth camera, which stands 5 cm to
        the left and 2 cm ahead of the image's."""
        T_C_D = se3(np.eye(3), [-0.05, 0.0, 0.02])
        depth = np.full((COUNT, HEIGHT // 2, WIDTH // 2), 3000, np.uint16)
        depth[:, :, : int(CX / 2) + 1] = 2000
        sequence = opened(tmp_path / "run", [*self.channels(depth), tf([("color_optical", "depth_optical", T_C_D)])])
        assert sequence.rig.kind is RigKind.RGBD and not sequence.problems
        assert "depth moved to the image by tf" in sequence.origin
        found = sequence.read(1).depth_m
        assert found is not None
        border = CX + FX * -0.05 / 2.02  # of the nearer plane, in the image
        row = found[HEIGHT // 2]
        np.testing.assert_allclose(row[10 : int(border) - 2], 2.02, atol=1e-6)
        np.testing.assert_allclose(row[int(border) + 4 : -10][row[int(border) + 4 : -10] > 0], 3.02, atol=1e-6)

    @pytest.mark.parametrize("values", [{"D": (0.1, 0.0, 0.0, 0.0, 0.0)}])
    def test_a_distorted_depth_camera_is_not_read(self, tmp_path: Path, values: dict[str, Any]) -> None:
        channels = self.channels(SCENE.depth_mm, **values)
        channels[2] = images("/camera/depth/image_raw", SCENE.depth_mm, "16UC1")
        sequence = opened(tmp_path / "run", [*channels, tf([("color_optical", "depth_optical", np.eye(4))])])
        assert sequence.rig.kind is RigKind.MONO and "its own camera is distorted" in messages(sequence)

    def test_without_tf_the_frames_are_named(self, tmp_path: Path) -> None:
        sequence = opened(tmp_path / "run", self.channels(SCENE.depth_mm))
        assert sequence.rig.kind is RigKind.MONO
        assert "no tf says how 'depth_optical' stands to 'color_optical'" in messages(sequence)
