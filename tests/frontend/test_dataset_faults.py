"""Folders of several agents, folders that are no data set, and numbers that cannot be right."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from dataset_makers import (
    COUNT,
    CX,
    CY,
    FX,
    FY,
    HEIGHT,
    WIDTH,
    make_scene,
    write_kitti,
    write_rendered,
)

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import Severity, open_dataset
from maslam.frontend.errors import FrontendError

# ---- several agents


def test_agents_of_any_kind_in_order_of_their_numbers(tmp_path: Path) -> None:
    scene = make_scene()
    write_kitti(tmp_path / "agent_10", scene)
    write_rendered(tmp_path / "agent_2", scene, "rgbd")
    (tmp_path / "world.json").write_text("{}")
    dataset = open_dataset(tmp_path)
    assert [(s.name, s.kind, s.rig.kind) for s in dataset.sequences] == [
        ("agent_2", "images", "rgbd"),
        ("agent_10", "kitti", "stereo"),
    ]
    assert dataset.kind == "agents (images, kitti)"
    assert {s.rig.kind for s in open_dataset(tmp_path, RigKind.MONO).sequences} == {RigKind.MONO}


def test_an_unfinished_rendering_is_not_taken_for_whole(tmp_path: Path) -> None:
    write_rendered(tmp_path / "agent_0", make_scene(), "stereo")
    (tmp_path / "unfinished.json").write_text("{}")
    with pytest.raises(FrontendError, match="rendering was not finished"):
        open_dataset(tmp_path)


def test_a_broken_agent_is_named(tmp_path: Path) -> None:
    write_kitti(tmp_path / "agent_0", make_scene())
    (tmp_path / "agent_1").mkdir()
    with pytest.raises(FrontendError, match="agent_1: no images of a known layout"):
        open_dataset(tmp_path)
    lenient = open_dataset(tmp_path, strict=False)
    assert [sequence.name for sequence in lenient.sequences] == ["agent_0"]
    assert "agent_1: no images" in lenient.problems[0].message
    shutil.rmtree(tmp_path / "agent_0/image_0")
    with pytest.raises(FrontendError, match="no images"):
        open_dataset(tmp_path, strict=False)


# ---- folders that are no data set


@pytest.mark.parametrize(
    ("files", "message"),
    [
        ([], "no images of a known layout here"),
        (["readme.txt"], "no images of a known layout here"),
        (
            ["00/calib.txt", "00/image_0/x.png", "01/calib.txt", "01/image_0/x.png"],
            "holds several sequences \\(00, 01\\); name one of them",
        ),
        (["0.png"], "0.png: "),
        (["calib.txt", "image_0/readme.txt"], "no images in image_0 or image_2"),
        (["0.png", "one.yaml", "two.yaml"], "which of one.yaml, two.yaml is the camera"),
    ],
)
def test_folders_without_a_usable_data_set(tmp_path: Path, files: list[str], message: str) -> None:
    for name in files:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("")
    with pytest.raises(FrontendError, match=message):
        open_dataset(tmp_path)


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(FrontendError, match="no such folder"):
        open_dataset(tmp_path / "nowhere")
    (tmp_path / "file").write_text("")
    with pytest.raises(FrontendError, match="not a folder"):
        open_dataset(tmp_path / "file")


# ---- numbers that cannot be right


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        (
            "times.txt",
            "0.150000000",
            "0.020000000",
            r"times.txt: time goes back at frame 3 \(000003.png\): 0.100000000 s, then 0.020000000 s",
        ),
        ("times.txt", "0.150000000", "0.100000000", r"times.txt: time stands still at frame 3"),
        ("times.txt", "0.150000000", "nan", r"times.txt:4: not a time: 'nan'"),
        ("times.txt", "0.150000000\n", "", r"times.txt: 5 times for 6 images"),
        ("calib.txt", f"P0: {FX}", "P0: nan", r"calib.txt:1: a projection matrix has 12 finite numbers"),
        ("calib.txt", f"P0: {FX} 0", "P0: 0", r"calib.txt:1: a projection matrix has 12 finite numbers, found 11"),
        ("calib.txt", f"P0: {FX}", "P0: 0", r"calib.txt:1: focal lengths 0.0, 80.0 px cannot be"),
        ("calib.txt", f" {CX} ", " 470.5 ", r"the principal point \(470.5, 31.5\) px lies outside the image of 96x64"),
        ("calib.txt", "-20.0", "20.0", r"baseline is -0.25 m: the right camera stands left of the left one"),
        ("calib.txt", "-20.0", "-20000.0", r"baseline is 250 m, outside 0.001 to 10 m: another unit"),
        ("calib.txt", "-20.0", "-0.02", r"baseline is 0.00025 m"),
        ("calib.txt", "-20.0", "0.0", r"baseline is -0.0 m"),
    ],
)
def test_kitti_numbers(tmp_path: Path, file: str, old: str, new: str, message: str) -> None:
    write_kitti(tmp_path, make_scene())
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new))
    with pytest.raises(FrontendError, match=message):
        open_dataset(tmp_path)


def test_times_that_are_no_cameras_in_any_unit(tmp_path: Path) -> None:
    write_kitti(tmp_path, make_scene())
    (tmp_path / "times.txt").write_text("".join(f"{i * 0.00005:.9f}\n" for i in range(COUNT)))
    with pytest.raises(FrontendError, match=r"times.txt: 2e\+04 images per second .* another unit"):
        open_dataset(tmp_path)


def test_warnings_do_not_stop(tmp_path: Path) -> None:
    write_kitti(tmp_path, make_scene())
    calib = tmp_path / "calib.txt"
    calib.write_text(calib.read_text().replace(f" {CX} ", " 90.0 ").replace(f" {FY} {CY} ", f" 100.0 {CY} "))
    (tmp_path / "times.txt").write_text("".join(f"{t}\n" for t in (0, 0.05, 0.1, 2.1, 2.15, 2.2)))
    [sequence] = open_dataset(tmp_path, RigKind.MONO).sequences
    messages = [problem.message for problem in sequence.problems]
    assert all(problem.severity is Severity.WARNING for problem in sequence.problems) and len(messages) == 3
    assert any("a gap of 2.000 s after 000002.png" in m for m in messages)
    assert any("fx 80.00 px and fy 100.00 px differ by 25 %" in m for m in messages)
    assert any("principal point (90.0, 31.5) px is far from the centre" in m for m in messages)


@pytest.mark.parametrize(("images", "rig", "few"), [
    (2, RigKind.MONO, True), (3, RigKind.MONO, False), (2, RigKind.STEREO, False),
])  # fmt: skip
def test_two_images_of_one_camera_are_few(tmp_path: Path, images: int, rig: RigKind, few: bool) -> None:
    write_rendered(tmp_path, make_scene(), "stereo")
    for side in ("image_0", "image_1"):
        for image in sorted((tmp_path / side).iterdir())[images:]:
            image.unlink()
    for name in ("times.txt", "poses.txt", "groundtruth.txt"):
        (tmp_path / name).unlink(missing_ok=True)
    [sequence] = open_dataset(tmp_path, rig).sequences
    said = [problem for problem in sequence.problems if "too few to track" in problem.message]
    assert [problem.severity for problem in said] == [Severity.WARNING] * few
    assert all(f"{tmp_path}: 2 images: " in problem.message for problem in said)


def test_a_calibration_for_another_size(tmp_path: Path) -> None:
    write_rendered(tmp_path, make_scene(), "stereo")
    camera = tmp_path / "camera.yaml"
    camera.write_text(camera.read_text().replace(f"width: {WIDTH}", "width: 640"))
    with pytest.raises(
        FrontendError,
        match=rf"camera.yaml: a calibration for 640x{HEIGHT} pixels, but .*000000.png has {WIDTH}x{HEIGHT}",
    ):
        open_dataset(tmp_path)


def test_a_pair_without_any_right_image_is_mono_and_says_so(tmp_path: Path) -> None:
    write_rendered(tmp_path, make_scene(), "stereo")
    (tmp_path / "image_1").rename(tmp_path / "elsewhere")
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is RigKind.MONO
    assert "a calibrated pair, but" in sequence.problems[0].message
    with pytest.raises(FrontendError, match="cannot be read as stereo; its files allow mono"):
        open_dataset(tmp_path, RigKind.STEREO)


def test_right_images_without_a_baseline_are_told(tmp_path: Path) -> None:
    write_rendered(tmp_path, make_scene(), "stereo")
    file = tmp_path / "camera.yaml"
    file.write_text("".join(line for line in file.read_text().splitlines(True) if not line.startswith("baseline_m")))
    (sequence,) = open_dataset(tmp_path).sequences
    assert sequence.rig.kind is RigKind.MONO
    assert [p.message for p in sequence.problems if "right images" in p.message]
    (chosen,) = open_dataset(tmp_path, RigKind.MONO).sequences
    assert not [p for p in chosen.problems if "right images" in p.message], "one camera was asked for"
