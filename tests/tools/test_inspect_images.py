"""``maslam inspect``: what images say about their calibration, and the picture of a frame."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "frontend"))
from dataset_makers import make_scene, write_euroc

from maslam.frontend.datasets import open_dataset
from maslam.tools.cli import main
from maslam.tools.inspection.command import InspectReport, inspect_dataset


def messages(report: InspectReport) -> list[str]:
    return [f"{p.severity} {p.message}" for s in report.sequences for p in s.problems]


@pytest.fixture
def pair(town_stereo: Path, tmp_path: Path) -> Path:
    return shutil.copytree(town_stereo / "agent_00", tmp_path / "pair")


def shift_rows(folder: Path, rows: int) -> None:
    for path in sorted((folder / "image_1").iterdir()):
        image = cv2.imread(str(path))
        assert image is not None and cv2.imwrite(str(path), np.roll(image, rows, axis=0))


def test_a_true_pair_has_its_rows_in_common(pair: Path) -> None:
    report = inspect_dataset(pair)
    assert messages(report) == []
    apart = float(report.sequences[0].rows.split()[2])
    assert abs(apart) < 0.1 and "rows          apart by" in "\n".join(report.lines())


@pytest.mark.parametrize("rows", [2, -3])
def test_a_pair_that_is_not_rectified_is_warned_of_with_its_figure(pair: Path, rows: int) -> None:
    shift_rows(pair, rows)
    [message] = messages(inspect_dataset(pair))
    assert message.startswith("warning") and "not rectified" in message
    found = float(message.split("differ by ")[1].split()[0])
    assert found == pytest.approx(rows, abs=0.2)


def test_left_and_right_swapped_is_an_error(pair: Path) -> None:
    (pair / "image_0").rename(pair / "other")
    (pair / "image_1").rename(pair / "image_0")
    (pair / "other").rename(pair / "image_1")
    report = inspect_dataset(pair)
    assert report.errors == 1 and "left and right are swapped" in messages(report)[0]


def test_images_that_are_no_pairs_are_warned_of(pair: Path) -> None:
    rng = np.random.default_rng(0)
    for path in sorted((pair / "image_1").iterdir()):
        noise = cv2.GaussianBlur(rng.uniform(0, 255, (180, 320)).astype(np.float32), (0, 0), 1.5)
        assert cv2.imwrite(str(path), np.clip(128 + 4 * (noise - 128), 0, 255).astype(np.uint8))
    assert any("are they pairs?" in message for message in messages(inspect_dataset(pair)))


def test_a_depth_unit_that_cannot_be_is_warned_of(indoor_rgbd: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(indoor_rgbd / "agent_00", tmp_path / "walk")
    report = inspect_dataset(folder)
    assert messages(report) == [] and "median" in report.sequences[0].depth
    camera = folder / "camera.yaml"
    unit = float(camera.read_text().split("depth_unit_m:")[1].split()[0])
    camera.write_text(camera.read_text().replace(f"depth_unit_m: {unit}", "depth_unit_m: 1.0"))
    [message] = messages(inspect_dataset(folder))
    assert message.startswith("warning") and "is the depth unit right?" in message


def test_the_picture_of_a_pair_shows_both_images_with_features_and_rows(
    town_stereo: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    png = tmp_path / "look.png"
    assert main(["inspect", str(town_stereo), "--png", str(png)]) == 0
    assert str(png) in capsys.readouterr().out
    picture = cv2.imread(str(png))
    assert picture is not None and picture.shape[1] == 2 * 320 and picture.shape[0] > 2 * 180
    frame = open_dataset(town_stereo).sequences[0].read(10)
    strip = picture.shape[0] // 2 - 180
    for panel, image in ((picture[strip : strip + 180, :320], frame.image), (picture[strip:, 320:][:180], frame.right)):
        grey = (panel == panel[..., :1]).all(axis=-1)  # what nothing was drawn on
        np.testing.assert_array_equal(panel[grey][:, 0], image[grey])
        assert 0.4 < grey.mean() < 0.97


def test_the_picture_of_a_distorted_camera_is_undistorted(tmp_path: Path) -> None:
    write_euroc(tmp_path / "set", make_scene())
    inspect_dataset(tmp_path / "set", png=tmp_path / "look.png")
    picture = cv2.imread(str(tmp_path / "look.png"))
    sequence = open_dataset(tmp_path / "set").sequences[0]
    image = sequence.read(2).image  # the middle of six frames
    assert picture is not None and sequence.rectifier is not None
    panel = picture[-image.shape[0] :, : image.shape[1]]
    grey = (panel == panel[..., :1]).all(axis=-1)
    np.testing.assert_array_equal(panel[grey][:, 0], image[grey])


def test_depth_is_drawn_beside_the_image(indoor_rgbd: Path, tmp_path: Path) -> None:
    inspect_dataset(indoor_rgbd / "agent_00", png=tmp_path / "look.png")
    picture = cv2.imread(str(tmp_path / "look.png"))
    assert picture is not None and picture.shape[1] == 640
    frame = open_dataset(indoor_rgbd / "agent_00").sequences[0].read(8)
    depth = picture[-240:, 320:].astype(int)
    edges = (depth == 255).all(axis=-1)
    assert (depth[(frame.depth_m == 0) & ~edges] == 0).all()
    near, far = np.quantile(frame.depth_m[frame.depth_m > 0], [0.1, 0.9])
    redder = (depth[..., 2] - depth[..., 0]).astype(float)
    assert redder[(frame.depth_m > 0) & (frame.depth_m < near)].mean() > redder[frame.depth_m > far].mean()
