"""Robots and cameras by the names of topics, as published recordings call them."""

from __future__ import annotations

import pytest

from maslam.frontend.datasets.recordings.topic_names import ImageName, by_robot, right_of


def names(*topics: str) -> list[ImageName]:
    return [ImageName.of(topic, topic.rpartition("/")[2].startswith("compressed")) for topic in topics]


@pytest.mark.parametrize(
    ("topics", "robots"),
    [
        (("/Alice/left_camera/compressed", "/Bob/left_camera/compressed"), ["Alice", "Bob"]),  # S3E
        (
            (
                "/acl_jackal/forward/infra1/image_rect_raw/compressed",
                "/acl_jackal/forward/infra2/image_rect_raw/compressed",
                "/sparkal1/forward/infra1/image_rect_raw/compressed",
                "/sparkal1/forward/infra2/image_rect_raw/compressed",
            ),
            ["acl_jackal", "sparkal1"],
        ),  # Kimera-Multi
        (("/robot_0/image", "/robot_1/image", "/robot_2/image"), ["robot_0", "robot_1", "robot_2"]),
        (("/fleet/red/cam0/image_raw", "/fleet/blue/color/image_raw"), ["blue", "red"]),
        (("/red/cam0/image_raw", "/red/cam1/image_raw", "/blue/camera/color/image_raw"), ["blue", "red"]),
        (("/cam0/image_raw", "/cam1/image_raw"), [""]),  # EuRoC
        (("/camera/color/image_raw", "/camera/infra1/image_rect_raw", "/camera/infra2/image_rect_raw"), [""]),
        (("/left/image_raw", "/right/image_raw"), [""]),
        (("/front/image_raw", "/rear/image_raw"), [""]),
        (("/usb_cam/image_raw", "/thermal/image_raw"), [""]),
        (("/camera_left/image_raw", "/camera_right/image_raw"), [""]),
        (("/zed/zed_node/left/image_rect_color", "/zed/zed_node/right/image_rect_color"), [""]),
        (("/image_raw",), [""]),
        (("/alice/image_raw",), [""]),
        (("/red/image_raw", "/blue/picture"), [""]),  # not alike, and nothing says which is which
    ],
)
def test_robots(topics: tuple[str, ...], robots: list[str]) -> None:
    assert list(by_robot(names(*topics))) == robots


@pytest.mark.parametrize(
    ("left", "right"),
    [
        ("/left/image_raw", "/right/image_raw"),
        ("/Alice/left_camera/compressed", "/Alice/right_camera/compressed"),
        ("/d435/infra1/image_rect_raw", "/d435/infra2/image_rect_raw"),
        ("/cam0/image_raw", "/cam1/image_raw"),
        ("/stereo/left/image_rect_color", "/stereo/right/image_rect_color"),
        ("/camera_left/image_raw", "/camera_right/image_raw"),
    ],
)
def test_pairs(left: str, right: str) -> None:
    first, second = names(left, right)
    assert right_of(first, [first, second]) == second and right_of(second, [first, second]) is None


def test_no_pairs() -> None:
    for topics in (("/leftover/image", "/rightover/image"), ("/cam0/image_raw", "/cam2/image_raw")):
        first, second = names(*topics)
        assert right_of(first, [first, second]) is None


@pytest.mark.parametrize(
    ("topic", "camera", "depth", "rectified"),
    [
        ("/camera/image_raw", "/camera", False, False),
        ("/camera/image_raw/compressed", "/camera", False, False),
        ("/camera/image_rect_color", "/camera", False, True),
        ("/Alice/left_camera/compressed", "/Alice/left_camera", False, False),
        ("/camera/depth/image_rect_raw", "/camera/depth", True, True),
        ("/camera/aligned_depth_to_color/image_raw/compressedDepth", "/camera/aligned_depth_to_color", True, False),
        ("/correct/image_raw", "/correct", False, False),
    ],
)
def test_what_a_name_says(topic: str, camera: str, depth: bool, rectified: bool) -> None:
    (name,) = names(topic)
    assert (name.camera, name.is_depth, name.is_rectified) == (camera, depth, rectified)
    assert f"{camera}/camera_info" in name.camera_info


def test_what_no_camera_took_is_known() -> None:
    assert all(n.is_derived for n in names("/stereo/disparity", "/seg/label_image", "/camera/debug_image"))
