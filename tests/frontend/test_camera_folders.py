"""A folder of images with calibration files beside them: what is used, what is said, what is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_makers import (
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    make_scene,
    numbered,
    own_camera,
    write_euroc,
    write_images,
    write_kitti,
    write_tum,
)

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.text_tables import read_table
from maslam.tools.inspection.command import inspect_dataset
from maslam.tools.inspection.record import record

SCENE = make_scene()
K = f"[{FX}, 0, {CX}, 0, {FY}, {CY}, 0, 0, 1]"
ONE_CAMERA = f"image_width: {WIDTH}\nimage_height: {HEIGHT}\ncamera_matrix: {{rows: 3, cols: 3, data: {K}}}\n"
ORB = f"%YAML:1.0\nCamera.fx: {FX}\nCamera.fy: {FY}\nCamera.cx: {CX}\nCamera.cy: {CY}\nCamera.fps: 20\n"
FISHEYE = 'Camera.type: "KannalaBrandt8"\nCamera.k1: 0.05\nCamera.k2: -0.01\nCamera.k3: 0.0\nCamera.k4: 0.0\n'
KALIBR = (
    "cam0:\n  camera_model: ds\n  intrinsics: [-0.1, 0.55, 60.0, 60.0, 47.5, 31.5]\n  distortion_model: none\n"
    "  distortion_coeffs: []\n  resolution: [96, 64]\n"
)


def folder_of(tmp_path: Path, files: dict[str, str], *images: str) -> Path:
    for name in images:
        write_images(tmp_path / name, numbered(), SCENE.rights if name == "right" else SCENE.images)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    return tmp_path


def the_sequence(path: Path, rig: RigKind | None = None) -> ImageSequence:
    return open_dataset(path, rig).sequences[0]


def said(sequence: ImageSequence) -> str:
    return "\n".join(problem.message for problem in sequence.problems)


def test_right_images_that_a_file_of_one_camera_leaves_unused(tmp_path: Path) -> None:
    folder_of(tmp_path, {"camera.yaml": ONE_CAMERA}, "left", "right")
    sequence = the_sequence(tmp_path)
    assert sequence.rig.kind is RigKind.MONO
    assert "right are not used, read as one camera" in said(sequence) and "right.yaml" in said(sequence)
    assert "not used" not in said(the_sequence(tmp_path, RigKind.MONO)), "asked for"
    with pytest.raises(FrontendError, match=r"camera.yaml: the file of one camera: a pair needs left.yaml"):
        open_dataset(tmp_path, RigKind.STEREO)


def test_a_distance_of_rectified_images_is_none_of_distorted_ones(tmp_path: Path) -> None:
    folder_of(tmp_path, {"camera.yaml": ORB + FISHEYE + "Camera.bf: 20.0\n"}, "left", "right")
    with pytest.raises(FrontendError, match=r"camera.yaml: Camera.bf needs rectified images.* Stereo.T_c1_c2"):
        open_dataset(tmp_path)
    assert the_sequence(tmp_path, RigKind.MONO).rectifier is not None


def test_without_right_images_nobody_asks_for_a_pair(tmp_path: Path) -> None:
    folder_of(tmp_path, {"camera.yaml": ORB + FISHEYE + "Camera.bf: 20.0\n"}, "left")
    assert "Camera.bf" not in said(the_sequence(tmp_path))


@pytest.mark.parametrize("lens", ["", "Camera.k1: 0.2624\nCamera.k2: -0.9531\n"])
def test_the_projector_of_an_rgbd_camera_is_no_pair(tmp_path: Path, lens: str) -> None:
    """As TUM1.yaml and TUM3.yaml of ORB-SLAM have it: Camera.bf and DepthMapFactor."""
    folder_of(tmp_path, {"TUM3.yaml": ORB + lens + "Camera.bf: 40.0\nDepthMapFactor: 1000.0\n"}, "rgb")
    write_images(tmp_path / "depth", numbered(), SCENE.depth_mm)
    sequence = the_sequence(tmp_path)
    assert sequence.rig.kind is RigKind.RGBD and "pair" not in said(sequence)


def test_opencvs_pair_of_files_takes_the_size_of_the_images(tmp_path: Path) -> None:
    files = {
        "intrinsics.yml": "".join(f"M{i}: {{data: {K}}}\nD{i}: {{data: [0, 0, 0, 0]}}\n" for i in (1, 2)),
        "extrinsics.yml": "R: {data: [1, 0, 0, 0, 1, 0, 0, 0, 1]}\nT: {data: [-0.54, 0, 0]}\n",
    }
    sequence = the_sequence(folder_of(tmp_path, files, "left", "right"))
    assert sequence.rig.kind is RigKind.STEREO and sequence.rig.baseline_m == pytest.approx(0.54)
    assert (sequence.rig.camera.width, sequence.rig.camera.height) == (WIDTH, HEIGHT)


def test_a_pair_of_messages_whose_projection_says_nothing_is_no_pair(tmp_path: Path) -> None:
    files = {"left.yaml": ONE_CAMERA, "right.yaml": ONE_CAMERA}
    folder_of(tmp_path, files, "left", "right")
    with pytest.raises(FrontendError, match="how the cameras stand is not known"):
        open_dataset(tmp_path)
    assert the_sequence(tmp_path, RigKind.MONO).rig.camera.fx == FX


@pytest.mark.parametrize(
    ("size", "message"),
    [
        ("image_width: 192\nimage_height: 128\n", "for 192x128 pixels, but .* has 96x64: images scaled by 0.5"),
        ("image_width: 64\nimage_height: 96\n", "for 64x96 pixels, but .* has 96x64: turned by 90 degrees"),
        ("image_width: 96\nimage_height: 60\n", "for 96x60 pixels, but .* has 96x64$"),
    ],
)
def test_sizes_are_compared(tmp_path: Path, size: str, message: str) -> None:
    folder_of(tmp_path, {"camera.yaml": size + f"camera_matrix: {{data: {K}}}\n"}, "images")
    with pytest.raises(FrontendError, match=message):
        open_dataset(tmp_path)


def test_the_right_cameras_size_is_compared_too(tmp_path: Path) -> None:
    right = KALIBR.replace("cam0", "cam1").replace("[96, 64]", "[48, 32]")
    chain = KALIBR + right + "  T_cn_cnm1: [[1, 0, 0, -0.2], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n"
    folder_of(tmp_path, {"camchain.yaml": chain}, "left", "right")
    with pytest.raises(FrontendError, match=r"for 48x32 pixels, but .*right.000000.png has 96x64"):
        open_dataset(tmp_path)


@pytest.mark.parametrize("focal", ["4.2", "0.8"])
def test_a_focal_length_in_another_unit_is_refused(tmp_path: Path, focal: str) -> None:
    folder_of(tmp_path, {"camera.yaml": own_camera().replace(f"fx: {FX}", f"fx: {focal}")}, "images")
    with pytest.raises(FrontendError, match=r"focal length of (4.2|0.8) px .* pixels are meant"):
        open_dataset(tmp_path)


def test_cameras_that_look_apart_have_no_common_view(tmp_path: Path) -> None:
    chain = KALIBR + KALIBR.replace("cam0", "cam1")
    chain += "  T_cn_cnm1: [[-1, 0, 0, 0.2], [0, 1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]\n"
    folder_of(tmp_path, {"camchain.yaml": chain.replace("[-0.1, 0.55, 60", "[-0.1, 0.1, 160")}, "left", "right")
    with pytest.raises(FrontendError, match=r"camchain.yaml: the calibration leaves no view"):
        open_dataset(tmp_path)


def test_files_that_hold_no_camera_are_passed_over(tmp_path: Path) -> None:
    files = {"notes.yaml": "weather: rain\n", "world.json": "{}", "broken.yaml": "a: [", "front.yaml": ONE_CAMERA}
    assert the_sequence(folder_of(tmp_path, files, "images")).rig.camera.fx == FX


def test_several_cameras_must_be_told_apart(tmp_path: Path) -> None:
    folder_of(tmp_path, {"front.yaml": ONE_CAMERA, "rear.yaml": ORB}, "images")
    with pytest.raises(FrontendError, match=r"which of front.yaml, rear.yaml is the camera\? name it camera.yaml"):
        open_dataset(tmp_path)
    (tmp_path / "camera.yaml").write_text(ONE_CAMERA)
    assert the_sequence(tmp_path).rig.camera.fx == FX
    (tmp_path / "camera.yaml").write_text("a: [")
    with pytest.raises(FrontendError, match=r"camera.yaml: not YAML"):
        open_dataset(tmp_path)


def test_a_file_for_each_image_is_not_opened(tmp_path: Path) -> None:
    poses = {f"{i:06d}.json": '{"fl_x": 1}' for i in range(40)}
    folder_of(tmp_path, {**poses, "front.yaml": own_camera()}, "images")
    assert the_sequence(tmp_path).rig.camera.fx == FX


def test_inspect_says_what_was_understood(tmp_path: Path) -> None:
    report = inspect_dataset(folder_of(tmp_path, {"camchain.yaml": KALIBR}, "images"))
    [line] = [line for line in report.lines() if line.startswith("  calibration ")]
    for part in (
        "double sphere xi -0.1 alpha 0.55; 96x64 px, fx 60.00 fy 60.00 cx 47.50 cy 31.50 px",
        "from camchain.yaml (Kalibr); rectified here, to a pinhole of",
    ):
        assert part in line
    [one] = record(report)["sequences"][0]["calibration"]
    assert (one["model"], one["coefficients"]) == ("double-sphere", {"xi": -0.1, "alpha": 0.55})
    assert (one["format"], one["size"], one["side"]) == ("Kalibr", [96, 64], "camera")
    assert one["sentence"] in line and one["file"].endswith("camchain.yaml")


def test_inspect_names_both_cameras_of_a_pair(tmp_path: Path) -> None:
    write_kitti(tmp_path, SCENE)
    lines = inspect_dataset(tmp_path).lines()
    assert [line.split("  ")[1] for line in lines if "used as stored" in line] == ["left camera", "right camera"]
    assert any("without distortion; size not in the file" in line for line in lines)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("ends", ["\r\n", "\r"])
@pytest.mark.parametrize("write", [write_kitti, write_euroc, write_tum], ids=["kitti", "euroc", "tum"])
def test_text_files_of_other_systems(tmp_path: Path, encoding: str, ends: str, write) -> None:
    """A byte order mark and other line ends in every text file of a data set change nothing."""
    write(tmp_path / "plain", SCENE)
    write(tmp_path / "other", SCENE)
    for path in (tmp_path / "other").rglob("*"):
        if path.suffix in (".txt", ".csv", ".yaml", ".tum"):
            text = path.read_bytes().decode("ascii").replace("\r\n", "\n")
            path.write_bytes(text.replace("\n", ends).encode(encoding))
    plain, other = the_sequence(tmp_path / "plain"), the_sequence(tmp_path / "other")
    np.testing.assert_array_equal(plain.stamps_ns, other.stamps_ns)
    assert plain.rig == other.rig and plain.groundtruth is not None and other.groundtruth is not None
    np.testing.assert_array_equal(plain.groundtruth.poses, other.groundtruth.poses)


def test_a_table_of_another_system_names_the_right_line(tmp_path: Path) -> None:
    (tmp_path / "t.txt").write_bytes("# a\r\n1 2\r\n\r\n1 x\r\n".encode("utf-16"))
    with pytest.raises(FrontendError, match=r"t.txt:4: not a number: 'x'"):
        read_table(tmp_path / "t.txt", 2, "a row")
