"""``maslam inspect`` and ``preprocess`` name pairs that are none, by their images: against what was done to them."""

from __future__ import annotations

import re
import shutil
import sys
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "frontend"))
from dataset_makers import make_scene, write_euroc

from maslam.frontend.datasets import open_dataset
from maslam.tools.cli import main
from maslam.tools.inspection.command import inspect_dataset


def messages(folder: Path) -> list[str]:
    return [f"{p.severity} {p.message}" for s in inspect_dataset(folder).sequences for p in s.problems]


@pytest.fixture
def pair(town_stereo: Path, tmp_path: Path) -> Path:
    return shutil.copytree(town_stereo / "agent_00", tmp_path / "pair")


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


def shift(folder: Path, lag: int) -> None:
    """File k of ``image_1`` holds what belongs to image k - lag; what has no partner then is left out."""
    left, right = files(folder / "image_0"), files(folder / "image_1")
    data = [path.read_bytes() for path in right]
    for k, path in enumerate(right):
        if 0 <= k - lag < len(data):
            path.write_bytes(data[k - lag])
    for paths in (left, right):
        for path in paths[:lag] if lag > 0 else paths[lag:]:
            path.unlink()
    for name in ("times.txt", "poses.txt"):
        (folder / name).unlink()


@pytest.mark.parametrize(("lag", "words"), [(1, "lag by 1 frame:"), (3, "lag by 3 frames:"), (-2, "lead by 2 frames:")])
def test_right_images_of_other_moments_are_named(pair: Path, lag: int, words: str) -> None:
    shift(pair, lag)
    found = [message for message in messages(pair) if message.startswith("error")]
    assert len(found) == 1 and words in found[0] and str(pair / "image_1") in found[0] and "shift them" in found[0]
    # The example is true: file k holds what belongs to image k - lag.
    right, left = map(int, re.findall(r"(\d+)\.png", found[0]))
    assert right - left == lag


@pytest.mark.parametrize("step", [0.5, -0.5, 0.27, 0.96])
def test_a_camera_that_moves_sideways_shows_its_pairs_again_and_is_no_fault(pair: Path, step: float) -> None:
    """After ``1 / step`` frames the left camera is where the right one was: its image is the same to the pixel, or
    nearly. The true partner still has common rows, and disparities."""
    rng = np.random.default_rng(0)
    left, right = files(pair / "image_0"), files(pair / "image_1")
    height, width = cv2.imread(str(left[0]), cv2.IMREAD_GRAYSCALE).shape
    layers = [cv2.GaussianBlur(rng.integers(0, 256, (height, 4 * width)).astype(np.uint8), (5, 5), 0) for _ in range(2)]
    layers = [cv2.normalize(layer, None, 0, 255, cv2.NORM_MINMAX) for layer in layers]

    def view(x: float) -> np.ndarray:
        far, near = (
            cv2.warpAffine(layer, np.array([[1.0, 0.0, -1.5 * width - shift * x], [0.0, 1.0, 0.0]]), (width, height))
            for layer, shift in zip(layers, (12.0, 30.0), strict=True)
        )
        return np.where(np.arange(height)[:, None] < height // 2, far, near)

    for k, (a, b) in enumerate(zip(left, right, strict=True)):
        assert cv2.imwrite(str(a), view(step * k)) and cv2.imwrite(str(b), view(step * k + 1.0))
    (pair / "poses.txt").unlink()
    assert not [message for message in messages(pair) if "lag" in message or "lead" in message]


def test_right_images_of_another_size_are_an_error_in_one_line(pair: Path) -> None:
    for path in files(pair / "image_1"):
        cv2.imwrite(str(path), cv2.resize(cv2.imread(str(path)), None, fx=0.5, fy=0.5))
    assert any(message.startswith("error") and "image_1" in message for message in messages(pair))


def test_an_image_lost_on_one_side_in_the_middle_is_named(pair: Path) -> None:
    paths = files(pair / "image_1")
    for path, after in pairwise(paths[9:]):
        path.write_bytes(after.read_bytes())
    [found] = [message for message in messages(pair) if message.startswith("error")]
    assert "lead by 1 frame" in found and "not everywhere: was an image lost" in found


def test_a_camera_that_stands_says_nothing_of_time(pair: Path) -> None:
    rng = np.random.default_rng(3)
    for side in ("image_0", "image_1"):
        still = cv2.imread(str(files(pair / side)[7]), cv2.IMREAD_GRAYSCALE)
        for path in files(pair / side):
            noisy = np.clip(still + rng.normal(0, 2, still.shape), 0, 255).astype(np.uint8)
            assert cv2.imwrite(str(path), noisy)
    assert messages(pair) == []


@pytest.mark.parametrize("how", ["copied", "saved again as jpeg"])
def test_one_picture_twice_is_named(pair: Path, how: str) -> None:
    for left, right in zip(files(pair / "image_0"), files(pair / "image_1"), strict=True):
        if how == "copied":
            shutil.copy(left, right)
        else:
            right.unlink()
            cv2.imwrite(str(right.with_suffix(".jpg")), cv2.imread(str(left)), [cv2.IMWRITE_JPEG_QUALITY, 92])
    [found] = messages(pair)
    assert found == f"error {pair / 'image_1'}: left and right images are the same pictures: no depth comes from these"


@pytest.mark.parametrize("turns", [1, 3])
def test_one_camera_above_the_other_is_named(pair: Path, turns: int) -> None:
    """Both images turned by 90 degrees are what a rig sees whose cameras stand one above the other."""
    for path in (*files(pair / "image_0"), *files(pair / "image_1")):
        assert cv2.imwrite(str(path), np.rot90(cv2.imread(str(path)), turns))
    camera = yaml.safe_load((pair / "camera.yaml").read_text())
    turned = {"width": "height", "height": "width", "fx": "fy", "fy": "fx", "cx": "cy", "cy": "cx"}
    (pair / "camera.yaml").write_text(yaml.safe_dump({turned.get(k, k): v for k, v in camera.items()}))
    [found] = messages(pair)
    assert found.startswith("error") and "one above the other" in found


def test_a_calibration_with_one_camera_above_the_other_is_refused_by_name(tmp_path: Path) -> None:
    write_euroc(tmp_path, make_scene())
    sensor = tmp_path / "mav0/cam1/sensor.yaml"
    # T_BS of the left camera with the right one 0.25 m along its y: the body's -z.
    text = sensor.read_text()
    start, end = text.index("data: ["), text.index("]", text.index("data: ["))
    T = np.array([[0, 0, 1, 0.1], [-1, 0, 0, 0.2], [0, -1, 0, 0.3 - 0.25], [0, 0, 0, 1.0]])
    sensor.write_text(text[:start] + "data: [" + ", ".join(map(str, T.ravel())) + text[end:])
    [sequence] = open_dataset(tmp_path, strict=False).sequences
    [problem] = [p for p in sequence.problems if p.severity == "error"]
    assert "the right camera stands 0.25 m below the left one, 0 m beside it" in problem.message
    assert "turn both images by 90 degrees" in problem.message


def test_empty_files_are_counted(pair: Path) -> None:
    for k in (5, 11, 12):
        files(pair / "image_1")[k].write_bytes(b"")
    said = f"{pair / 'image_1' / '000005.png'}: 3 of 20 right images are empty files; these frames cannot be read"
    assert f"warning {said}" in messages(pair)


def test_repeated_images_are_counted(pair: Path) -> None:
    for k in (6, 7, 13):
        shutil.copy(files(pair / "image_0")[k - 1], files(pair / "image_0")[k])
    found = [message for message in messages(pair) if "byte for byte" in message]
    assert found == [
        f"warning {pair / 'image_0' / '000006.png'}: the same as the image before, byte for byte; 3 of 20 are like "
        "this: did the camera hang?"
    ]


def test_preprocess_refuses_what_inspect_calls_an_error(
    pair: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shift(pair, 2)
    assert main(["preprocess", str(pair), str(tmp_path / "seqs"), "--workers", "1"]) == 1
    assert "right images lag by 2 frames" in capsys.readouterr().err
    assert not (tmp_path / "seqs" / "manifest.json").exists()


# ---- depth


@pytest.fixture
def walk(indoor_rgbd: Path, tmp_path: Path) -> Path:
    return shutil.copytree(indoor_rgbd / "agent_00", tmp_path / "walk")


def move_depth(folder: Path, dx: int, dy: int) -> None:
    for path in files(folder / "depth_0"):
        depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert cv2.imwrite(str(path), np.roll(depth, (dy, dx), axis=(0, 1)))


@pytest.mark.parametrize(("dx", "dy", "words"), [
    (8, 0, "lie 8 px too far right in the image"),
    (-14, 0, "lie 14 px too far left in the image"),
    (6, -4, "lie 6 px too far right and 4 px too far up in the image"),
])  # fmt: skip
def test_depth_that_lies_beside_its_image_is_named_with_the_offset(walk: Path, dx: int, dy: int, words: str) -> None:
    assert messages(walk) == []
    move_depth(walk, dx, dy)
    [found] = messages(walk)
    assert found.startswith(f"warning {walk / 'depth_0'}: edges of the depth") and words in found


def test_depth_of_other_moments_is_named(walk: Path) -> None:
    paths = files(walk / "depth_0")
    data = [path.read_bytes() for path in paths]
    for k, path in enumerate(paths):
        path.write_bytes(data[(k + len(paths) // 2) % len(paths)])
    assert any("edges of the depth" in message for message in messages(walk))


@pytest.mark.parametrize(("turn_deg", "pairs"), [(1.5, True), (37.0, False)])
def test_a_turn_that_no_rig_has_is_not_laid_to_the_calibration(turn_deg: float, pairs: bool) -> None:
    from maslam.frontend.datasets.pair_check import PairFit
    from maslam.tools.checks.sensor_checks import turned_lines

    turn = np.array([0.0, turn_deg, 0.0])
    _, said, _ = turned_lines([], PairFit(90, 200, turn, np.full(3, 0.1), 3.0, 8.0, 0.5))
    assert ("calibrate the pair anew" in said) == pairs
    assert ("of other moments" in said) != pairs
