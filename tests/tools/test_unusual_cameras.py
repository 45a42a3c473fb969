"""What a user would not notice: two pictures in one, a robot that only stands, keys and files that are not used."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.frontend.datasets import open_dataset
from maslam.mas.sequence import load_sequences
from maslam.tools.cli import main
from maslam.tools.inspection.command import inspect_dataset


def messages(folder: Path) -> list[str]:
    report = inspect_dataset(folder)
    return [f"{p.severity} {p.message}" for s in report.sequences for p in s.problems]


def notes(folder: Path) -> list[str]:
    [sequence] = open_dataset(folder).sequences
    return list(sequence.notes)


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


@pytest.fixture
def pair(town_stereo: Path, tmp_path: Path) -> Path:
    return shutil.copytree(town_stereo / "agent_00", tmp_path / "pair")


@pytest.fixture
def single(pair: Path) -> Path:
    shutil.rmtree(pair / "image_1")
    return pair


def join(pair: Path, rows: int = 0) -> None:
    for left, right in zip(files(pair / "image_0"), files(pair / "image_1"), strict=True):
        images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in (left, right)]
        assert cv2.imwrite(str(left), np.hstack([images[0], np.roll(images[1], rows, axis=0)]))
    shutil.rmtree(pair / "image_1")


@pytest.mark.parametrize("rows", [0, 3])
def test_two_pictures_side_by_side_are_refused_with_the_cure(
    pair: Path, rows: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    join(pair, rows)
    (pair / "camera.yaml").unlink()
    [found] = [message for message in messages(pair) if message.startswith("error")]
    assert "640x180 pixels is two pictures of 320x180 side by side" in found and "crop=iw/2:ih:iw/2:0" in found
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet"]) == 1
    assert "two pictures of 320x180 side by side" in capsys.readouterr().err


def test_a_calibration_of_one_half_says_so(pair: Path) -> None:
    join(pair)
    assert any("320x180 pixels, but" in m and "two pictures side by side?" in m for m in messages(pair))


def stack(pair: Path, upper: int) -> None:
    for both in zip(files(pair / "image_0"), files(pair / "image_1"), strict=True):
        images = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in both]
        assert cv2.imwrite(str(both[0]), np.vstack([images[upper], images[1 - upper]]))
    shutil.rmtree(pair / "image_1")


@pytest.mark.parametrize("upper", [0, 1])
def test_two_pictures_one_above_the_other_are_refused_with_the_cure(
    pair: Path, upper: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stack(pair, upper)
    assert any(
        "320x180 pixels, but" in m and "one above the other? cut each into its upper" in m for m in messages(pair)
    )
    (pair / "camera.yaml").unlink()
    [found] = [message for message in messages(pair) if message.startswith("error")]
    assert "320x360 pixels is two pictures of 320x180 one above the other" in found and "crop=iw:ih/2:0:ih/2" in found
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet"]) == 1
    assert "one above the other" in capsys.readouterr().err


def test_one_view_of_any_shape_is_no_stack(single: Path) -> None:
    (single / "camera.yaml").unlink()
    assert not [message for message in messages(single) if "two pictures" in message]


def test_one_wide_view_is_no_pair(single: Path) -> None:
    for path in files(single / "image_0"):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert cv2.imwrite(str(path), image[40:160])
    (single / "camera.yaml").unlink()
    assert not [message for message in messages(single) if "two pictures" in message]


def stand(folder: Path) -> None:
    rng = np.random.default_rng(1)
    for side in ("image_0", "image_1"):
        paths = files(folder / side)
        still = cv2.imread(str(paths[7]), cv2.IMREAD_GRAYSCALE)
        for path in paths:
            assert cv2.imwrite(str(path), np.clip(still + rng.normal(0, 1.5, still.shape), 0, 255).astype(np.uint8))


def test_a_robot_that_only_stands_says_so_and_can_keep_its_one_view(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stand(pair)
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet"]) == 1
    [line] = capsys.readouterr().err.splitlines()
    assert "the camera stands still" in line and "--odometry.min-track-keyframes 1" in line
    options = ["--odometry.min-track-keyframes", "1", "--quiet"]
    assert main(["preprocess", str(pair), str(tmp_path / "one"), *options]) == 0
    manifest, _ = load_sequences(tmp_path / "one")
    assert len(manifest.agents) == 1
    assert "20 frames, 1 key-frame" in capsys.readouterr().out


KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [250.0, 250.0, 159.5, 89.5]
  distortion_model: none
  resolution: [320, 180]
  timeshift_cam_imu: {0}
cam1:
  camera_model: pinhole
  intrinsics: [250.0, 250.0, 159.5, 89.5]
  distortion_model: none
  resolution: [320, 180]
  timeshift_cam_imu: {1}
  T_cn_cnm1: [[1, 0, 0, -0.3], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
"""


def test_shifts_of_kalibrs_clocks_are_named(pair: Path) -> None:
    (pair / "camera.yaml").write_text(KALIBR.format(-0.004, -0.0039))
    assert any("timeshift_cam_imu (-4, -3.9 ms) is not used" in note for note in notes(pair))
    assert not [message for message in messages(pair) if "timeshift" in message]
    (pair / "camera.yaml").write_text(KALIBR.format(-0.004, 0.021))
    [found] = [message for message in messages(pair) if "timeshift" in message]
    assert found.startswith("warning") and "differ by 25 ms" in found and "after the left one" in found
    (pair / "camera.yaml").write_text(KALIBR.format(0, 0))
    assert not [note for note in notes(pair) if "timeshift" in note]


ORB = """%YAML:1.0
Camera.type: "PinHole"
Camera1.fx: 250.0
Camera1.fy: 250.0
Camera1.cx: {0}
Camera1.cy: {1}
Camera.width: 320
Camera.height: 180
Camera.fps: {2}
"""


def test_a_new_size_of_orb_slam_is_named(single: Path) -> None:
    (single / "camera.yaml").write_text(ORB.format(159.5, 89.5, 10.0) + "Camera.newWidth: 160\nCamera.newHeight: 90\n")
    assert any("Camera.newWidth 160 and Camera.newHeight 90 are not used" in note for note in notes(single))
    assert inspect_dataset(single).sequences[0].rig.camera.fx == 250.0


def test_exchanged_cx_and_cy_are_named_with_their_values(single: Path) -> None:
    (single / "camera.yaml").write_text(ORB.format(89.5, 159.5, 10.0))
    [found] = [message for message in messages(single) if "principal" in message]
    assert "cx 89.5, cy 159.5" in found and "are cx and cy exchanged?" in found
    (single / "camera.yaml").write_text(ORB.format(150.0, 100.0, 10.0))
    assert not [message for message in messages(single) if "principal" in message]


def test_an_image_every_ten_seconds_is_doubted(single: Path) -> None:
    for name in ("times.txt", "poses.txt"):
        (single / name).unlink()
    (single / "camera.yaml").write_text(ORB.format(159.5, 89.5, 0.1))
    assert any("0.1 images per second (one every 10 s)" in message for message in messages(single))


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("SN27756144.conf", "[LEFT_CAM_HD]\nfx=529\n", "ZED's calibration"),
        ("any.conf", "[STEREO]\nBaseline=120\n[LEFT_CAM_2K]\nfx=1000\n", "ZED's calibration"),
        ("camera_models.json", '{"v2 unknown 1 1 perspective 0": {"focal_x": 0.9}}', "OpenSfM's cameras"),
        ("reconstruction.json", '[{"cameras": {}, "shots": {}}]', "OpenSfM's reconstruction"),
        ("perspective.txt", "calib_time: 01\nS_00: 1392 512\n", "KITTI-360's calibration"),
        ("camera.txt", "Pinhole a b c\n640 480\nfull\n640 480\n", "DSO's calibration"),
    ],
)
def test_other_programs_calibrations_are_named(single: Path, name: str, text: str, words: str) -> None:
    (single / "camera.yaml").unlink()
    (single / name).write_text(text)
    [found] = [message for message in messages(single) if name in message]
    assert words in found and "not read: write its numbers into camera.yaml" in found


@pytest.mark.parametrize("where", ["robot", "masks"])
def test_mask_path_of_transforms_is_used(single: Path, where: str) -> None:
    """A folder that is called as masks are when nobody names them is not looked through again."""
    mask = np.full((180, 320), 255, np.uint8)
    mask[:, 240:] = 0
    (single / where).mkdir()
    assert cv2.imwrite(str(single / where / "body.png"), mask)
    names = [path.name for path in files(single / "image_0")]
    frames = [{"file_path": f"image_0/{name}", "mask_path": f"{where}/body.png"} for name in names]
    data = {"fl_x": 250.0, "fl_y": 250.0, "cx": 159.5, "cy": 89.5, "w": 320, "h": 180, "frames": frames}
    (single / "camera.yaml").unlink()
    (single / "transforms.json").write_text(json.dumps(data))
    [sequence] = open_dataset(single).sequences
    used = sequence.read(3).used
    assert used is not None and used[:, :230].all() and not used[:, 250:].any()
    assert any("mask_path masks 20 of 20 images; 25.0 %" in note for note in sequence.notes)
    assert not any("mask" in problem.message for problem in inspect_dataset(single).sequences[0].problems)
    assert cv2.imwrite(str(single / where / "body.png"), np.zeros_like(mask))
    found = inspect_dataset(single).sequences[0].problems
    assert any("mask_path: 0.0 % of the pixels are used" in problem.message for problem in found)
    frames[0]["mask_path"] = f"{where}/none.png"
    (single / "transforms.json").write_text(json.dumps(data))
    found = inspect_dataset(single).sequences[0].problems
    assert any("none.png" in problem.message for problem in found)


@pytest.mark.parametrize("text", ["250 250 159.5 89.5\n", "250 0 159.5\n0 250 89.5\n0 0 1\n"])
def test_numbers_alone_beside_a_folder_called_as_kitti_s_are_read(single: Path, text: str) -> None:
    (single / "camera.yaml").unlink()
    (single / "calib.txt").write_text(text)
    [sequence] = open_dataset(single).sequences
    assert sequence.kind == "images"
    camera = sequence.rig.camera
    assert (camera.fx, camera.cy) == (250.0, 89.5)
