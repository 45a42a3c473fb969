"""A calibration that is off is said by `inspect` and by `preprocess`, also where tracking corrects it; images are
turned and shifted by known homographies."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from maslam.frontend.datasets import open_dataset
from maslam.frontend.datasets.pair_check import check_pairs
from maslam.tools.cli import main
from maslam.tools.inspection.command import InspectReport, inspect_dataset


@pytest.fixture
def pair(town_stereo: Path, tmp_path: Path) -> Path:
    return shutil.copytree(town_stereo / "agent_00", tmp_path / "pair")


def messages(report: InspectReport) -> list[str]:
    return [f"{p.severity} {p.message}" for s in report.sequences for p in s.problems]


def turn_right_camera(folder: Path, turn_deg: tuple[float, float, float], rows: float = 0.0) -> None:
    """The right images of a camera turned by a rotation vector, then shifted down by ``rows`` pixels."""
    K = open_dataset(folder).sequences[0].rig.camera.K
    R, _ = cv2.Rodrigues(np.radians(np.array(turn_deg)))
    H = np.array([[1.0, 0, 0], [0, 1, rows], [0, 0, 1]]) @ K @ R @ np.linalg.inv(K)
    for path in sorted((folder / "image_1").iterdir()):
        image = cv2.imread(str(path))
        assert image is not None
        size = (image.shape[1], image.shape[0])
        assert cv2.imwrite(str(path), cv2.warpPerspective(image, H, size, borderMode=cv2.BORDER_REPLICATE))


@pytest.mark.parametrize("turn", [(1.5, 0, 0), (0, 1.5, 0), (0, -1.5, 0), (0, 0, 1.5), (0.8, -1.0, -1.2)])
def test_a_rig_turned_by_a_degree_and_a_half_is_warned_of_with_the_turn(
    pair: Path, turn: tuple[float, float, float]
) -> None:
    turn_right_camera(pair, turn)
    fit = check_pairs(open_dataset(pair).sequences[0])
    assert fit is not None and fit.off
    # A turn about y shows by its rows in the corners alone: of 2 px at most here.
    assert (np.abs(fit.turn_deg - turn) < [0.1, 0.45, 0.1]).all()
    [message] = messages(inspect_dataset(pair))
    assert message.startswith("warning the calibration is off") and "turned by" in message


def test_a_true_rig_is_not_warned_of(pair: Path) -> None:
    fit = check_pairs(open_dataset(pair).sequences[0])
    assert fit is not None and not fit.off and fit.rms_px < 0.3


def test_rows_farther_apart_than_a_search_along_rows_looks_are_found(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """And a run that cannot start for it says so."""
    turn_right_camera(pair, (0, 0, 0), rows=14.0)
    [message] = messages(inspect_dataset(pair))
    assert "differ by +14.0" in message
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet", "--workers", "1"]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert "no frame of 20 could be tracked" in error and "rows of the pair differ by +14.0" in error


@pytest.mark.parametrize(
    ("turn", "rows", "said"),
    [((0, 0, 1.5), 0.0, ("about its axis by ", 1.5)), ((0, 0, 0), 2.0, ("rows of the pair by ", 2.0))],
)
def test_what_tracking_corrects_is_said_and_noted(
    pair: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    turn: tuple[float, float, float],
    rows: float,
    said: tuple[str, float],
) -> None:
    turn_right_camera(pair, turn, rows)
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet", "--workers", "1"]) == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("warning: pair: the calibration")]
    assert len(lines) == 2 and "differ by" in lines[0] and "was corrected while tracking" in lines[1]
    assert float(lines[1].split(said[0])[1].split()[0]) == pytest.approx(said[1], abs=0.1)
    noted = json.loads((tmp_path / "out" / "manifest.json").read_text())["settings"]["problems"]
    assert [f"warning: {line}" for line in noted if "calibration" in line] == lines


def test_a_true_rig_is_tracked_without_a_word(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet", "--workers", "1"]) == 0
    assert "warning" not in capsys.readouterr().err


def test_the_same_image_twice_is_named(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.rmtree(pair / "image_1")
    shutil.copytree(pair / "image_0", pair / "image_1")
    report = inspect_dataset(pair)
    assert report.errors == 1 and "the same pictures" in messages(report)[0]
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet", "--workers", "1"]) == 1
    assert "left and right images are the same pictures" in capsys.readouterr().err


def test_fog_is_named_by_its_features(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in [*(pair / "image_0").iterdir(), *(pair / "image_1").iterdir()]:
        image = cv2.GaussianBlur(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), (0, 0), 4.0).astype(float)
        assert cv2.imwrite(str(path), (128 + 0.15 * (image - 128)).astype(np.uint8))
    [message] = messages(inspect_dataset(pair))
    assert message.startswith("warning hardly any feature in 8 of 8 images")
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet", "--workers", "1"]) == 1
    error = capsys.readouterr().err
    assert "too few features in the image (20 x)" in error and "depth" not in error


def test_dark_images_are_named(pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in [*(pair / "image_0").iterdir(), *(pair / "image_1").iterdir()]:
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        assert image is not None and cv2.imwrite(str(path), image // 25)
    [message] = messages(inspect_dataset(pair))
    assert message.startswith("warning 8 of 8 images looked at are too dark") and "at most 9 of 255" in message
    assert main(["preprocess", str(pair), str(tmp_path / "out"), "--quiet", "--workers", "1"]) == 1
    assert "too dark (20 x)" in capsys.readouterr().err
