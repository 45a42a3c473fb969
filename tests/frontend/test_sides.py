"""Left and right images in one folder, distinguished by a mark in their names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_makers import BASELINE_M, COUNT, make_scene, own_camera, write_images

from maslam.frontend.cameras.models import RigKind
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.errors import FrontendError

STEREO = f"rate_hz: 20.0\nbaseline_m: {BASELINE_M}\n"
MARKS = [
    ("{:04d}_L", "{:04d}_R"), ("{:04d}_l", "{:04d}_r"), ("{:04d}L", "{:04d}R"), ("L{:04d}", "R{:04d}"),
    ("l_{:04d}", "R_{:04d}"), ("frame_L_{:04d}", "frame_R_{:04d}"), ("imgL{:04d}", "imgR{:04d}"),
    ("img0_{:04d}", "img1_{:04d}"), ("cam0_{:04d}", "cam1_{:04d}"), ("CAM_0-{:04d}", "CAM_1-{:04d}"),
    ("cam1_{:04d}", "cam2_{:04d}"), ("{:04d}_cam0", "{:04d}_cam1"), ("infra1_{:04d}", "infra2_{:04d}"),
    ("imgLeft{:04d}", "imgRight{:04d}"), ("{:04d}_left", "{:04d}_right"),
]  # fmt: skip


def write(folder: Path, left: str, right: str, camera: str = STEREO) -> None:
    scene = make_scene()
    for name, images in ((left, scene.images), (right, scene.rights)):
        write_images(folder, [f"{name.format(i)}.png" for i in range(COUNT)], images)
    (folder / "camera.yaml").write_text(own_camera(camera))


def opened(folder: Path, rig: RigKind | None = None) -> ImageSequence:
    [sequence] = open_dataset(folder, rig).sequences
    return sequence


@pytest.mark.parametrize(("left", "right"), MARKS)
def test_names_alike_but_for_the_side_are_pairs(tmp_path: Path, left: str, right: str) -> None:
    write(tmp_path, left, right)
    sequence, scene = opened(tmp_path), make_scene()
    assert sequence.rig.kind is RigKind.STEREO and len(sequence) == COUNT and not sequence.problems
    for i in range(COUNT):
        np.testing.assert_array_equal(sequence.read(i).image, scene.images[i])
        np.testing.assert_array_equal(sequence.read(i).right, scene.rights[i])
    assert len(opened(tmp_path, RigKind.MONO)) == COUNT


@pytest.mark.parametrize(("left", "right"), MARKS)
def test_without_a_baseline_only_the_left_ones_are_read_and_that_is_said(tmp_path: Path, left: str, right: str) -> None:
    write(tmp_path, left, right, "rate_hz: 20.0\n")
    sequence, scene = opened(tmp_path), make_scene()
    assert sequence.rig.kind is RigKind.MONO and len(sequence) == COUNT
    [problem] = sequence.problems
    assert f"right images in {tmp_path} are not used, read as one camera" in problem.message
    assert "add baseline_m" in problem.message
    np.testing.assert_array_equal(sequence.read(3).image, scene.images[3])


@pytest.mark.parametrize("ends", ["_{0}", "_cam{1}"])
def test_times_in_the_names_order_both_sides(tmp_path: Path, ends: str) -> None:
    scene = make_scene()
    for side, number, images in (("L", 0, scene.images), ("R", 1, scene.rights)):
        write_images(tmp_path, [f"{stamp}{ends.format(side, number)}.png" for stamp in scene.stamps_ns], images)
    (tmp_path / "camera.yaml").write_text(own_camera(STEREO))
    sequence = opened(tmp_path)
    np.testing.assert_array_equal(sequence.stamps_ns, scene.stamps_ns)
    np.testing.assert_array_equal(sequence.read(4).right, scene.rights[4])


def test_words_in_place_of_numbers_are_paired(tmp_path: Path) -> None:
    scene = make_scene()
    for side, images in (("L", scene.images), ("R", scene.rights)):
        write_images(tmp_path, [f"{letter}{letter}_{side}.png" for letter in "abcdef"], images)
    (tmp_path / "camera.yaml").write_text(own_camera(STEREO))
    np.testing.assert_array_equal(opened(tmp_path).read(4).right, scene.rights[4])


@pytest.mark.parametrize(("left", "right"), [*MARKS, ("left{:04d}", "right{:04d}"), ("Left_{:04d}", "Right_{:04d}")])
def test_a_right_image_that_is_missing_is_named_and_never_replaced_by_its_left_one(
    tmp_path: Path, left: str, right: str
) -> None:
    write(tmp_path, left, right)
    lost = tmp_path / f"{right.format(2)}.png"
    lost.unlink()
    if left[0] == "l" and right[0] == "R":  # the name that it would have is taken from its left image's
        lost = lost.with_name(lost.name.replace("R", "r"))
    with pytest.raises(FrontendError, match="right image is missing") as error:
        open_dataset(tmp_path)
    assert lost.name in str(error.value)


@pytest.mark.parametrize(("left", "right"), [("L{:04d}", "R9{:03d}"), ("L{:04d}", "a{:04d}"), ("a{:04d}", "b{:04d}")])
def test_images_without_partners_are_one_camera(tmp_path: Path, left: str, right: str) -> None:
    write(tmp_path, left, right)
    assert len(opened(tmp_path)) == 2 * COUNT


def test_two_pairs_are_too_few_to_tell_and_three_are_not(tmp_path: Path) -> None:
    write(tmp_path, "{:04d}_L", "{:04d}_R")
    for i in range(3, COUNT):
        for side in "LR":
            (tmp_path / f"{i:04d}_{side}.png").unlink()
    assert len(opened(tmp_path)) == 3
    for side in "LR":
        (tmp_path / f"0002_{side}.png").unlink()
    assert len(opened(tmp_path)) == 4


def test_images_of_two_sizes_are_no_pairs(tmp_path: Path) -> None:
    write(tmp_path, "{:04d}_L", "{:04d}_R")
    write_images(tmp_path, [f"{i:04d}_R.png" for i in range(COUNT)], make_scene().rights[:, :-8])
    assert len(opened(tmp_path)) == 2 * COUNT


def test_robots_a_folder_each_with_both_sides_in_it(tmp_path: Path) -> None:
    for name in ("alice", "bob"):
        write(tmp_path / name, "L{:04d}", "R{:04d}")
    assert [(s.rig.kind, len(s)) for s in open_dataset(tmp_path).sequences] == [(RigKind.STEREO, COUNT)] * 2
