"""Ground truth that goes by the images' numbers or names, and matrices column by column, is each image's own."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from dataset_makers import make_scene, numbered, own_camera, quaternion_wxyz, write_images

from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.files.pose_table import read_poses

SCENE = make_scene()
NAMES = numbered()


def rows(first: list[str], mark: str = " ") -> list[str]:
    out = []
    for text, pose in zip(first, SCENE.poses, strict=True):
        w, x, y, z = quaternion_wxyz(pose[:3, :3])
        out.append(mark.join([text, *(f"{v:.12f}" for v in (*pose[:3, 3], x, y, z, w))]) + "\n")
    return out


def opened(folder: Path, text: str, name: str = "groundtruth.txt", first: int = 0) -> ImageSequence:
    write_images(folder, [f"{int(one[:-4]) + first:06d}.png" for one in NAMES], SCENE.images)
    (folder / "camera.yaml").write_text(own_camera() + "rate_hz: 10\n")
    (folder / name).write_text(text)
    return open_dataset(folder).sequences[0]


def check(sequence: ImageSequence, missing: int | None = None) -> None:
    assert sequence.groundtruth is not None
    kept = [k for k in range(len(NAMES)) if k != missing]
    np.testing.assert_array_equal(sequence.groundtruth.stamps_ns, sequence.stamps_ns[kept])
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses[kept], atol=1e-9)


@pytest.mark.parametrize("first", [0, 1])
def test_a_column_that_counts_has_the_numbers_of_the_images(tmp_path: Path, first: int) -> None:
    sequence = opened(tmp_path, "".join(rows([str(k + first) for k in range(len(NAMES))])))
    check(sequence)
    [problem] = sequence.problems
    assert "its first column counts and is no time of the images" in problem.message


def test_numbers_with_a_hole_are_those_of_the_names(tmp_path: Path) -> None:
    lines = rows([str(k + 1) for k in range(len(NAMES))])
    check(opened(tmp_path, "".join(lines[:2] + lines[3:]), first=1), missing=2)


def test_seconds_that_count_are_seconds_where_images_are_then(tmp_path: Path) -> None:
    """A receiver at 1 Hz beside images of half a minute."""
    write_images(tmp_path, [f"{k:06d}.png" for k in range(30)], np.tile(SCENE.images, (5, 1, 1)))
    (tmp_path / "camera.yaml").write_text(own_camera())
    (tmp_path / "times.txt").write_text("".join(f"{k / 5:.3f}\n" for k in range(30)))
    (tmp_path / "groundtruth.txt").write_text("".join(rows([str(k) for k in range(len(NAMES))])))
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.groundtruth is not None
    assert sequence.groundtruth.stamps_ns.tolist() == [k * 10**9 for k in range(len(NAMES))]


@pytest.mark.parametrize(("head", "mark"), [("", " "), ("filename,tx,ty,tz,qx,qy,qz,qw\n", ",")])
def test_names_in_front_say_whose_pose_it_is(tmp_path: Path, head: str, mark: str) -> None:
    lines = rows([f"rgb/{name}" for name in NAMES], mark)
    check(opened(tmp_path, head + "".join(lines[::-1]), "poses.csv"))


@pytest.mark.parametrize("timed", [False, True])
def test_matrices_column_by_column_are_read_and_said(tmp_path: Path, timed: bool) -> None:
    text = "".join(
        " ".join([*([f"{k}.5"] if timed else []), *(f"{v:.12f}" for v in pose.T.ravel())]) + "\n"
        for k, pose in enumerate(SCENE.poses)
    )
    (tmp_path / "poses.txt").write_text(text)
    found = read_poses(tmp_path / "poses.txt")
    np.testing.assert_allclose(found.poses, SCENE.poses, atol=1e-9)
    assert any("column by column" in note for note in found.notes)
