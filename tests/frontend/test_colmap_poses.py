"""Poses of COLMAP's models and of ``transforms.json``, as ground truth and as poses to import, against COLMAP."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from dataset_makers import FX, HEIGHT, WIDTH, make_scene, numbered, own_camera, write_images

from maslam.backend.geometry import se3_inverse
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.datasets.poses_of_images import GivenPoses
from maslam.frontend.errors import FrontendError
from maslam.frontend.files.pose_table import read_poses
from maslam.tools.common.errors import ToolError
from maslam.tools.interchange.given_files import read_given, trajectory_files

SCENE = make_scene()
NAMES = numbered()
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


def write_model(folder: Path, form: str, names: list[str], poses: np.ndarray = SCENE.poses) -> Path:
    """A model of images with two key-points each, as COLMAP itself writes it."""
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(pycolmap.Camera.create_from_model_id(1, 1, FX, WIDTH, HEIGHT))
    for k in np.random.default_rng(2).permutation(len(names)).tolist():
        points = np.array([[1.0, 2.0], [30.5, 4.25]]) if k % 2 else np.zeros((0, 2))  # without, the line is empty
        image = pycolmap.Image(name=names[k], keypoints=points, camera_id=1, image_id=k + 1)
        T = se3_inverse(poses[k])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(T[:3, :3]), T[:3, 3]))
    folder.mkdir(parents=True, exist_ok=True)
    getattr(model, f"write_{form}")(str(folder))
    return folder


def opened(folder: Path) -> ImageSequence:
    write_images(folder / "images", NAMES, SCENE.images)
    (folder / "camera.yaml").write_text(own_camera() + "rate_hz: 10\n")
    return open_dataset(folder).sequences[0]


def given(file: Path, names: list[str] = NAMES) -> GivenPoses:
    images: Any = SimpleNamespace(left=tuple(f"/data/alice/images/{name}" for name in names), stamps_ns=SCENE.stamps_ns)
    return read_given(file, images, None, None)


@pytest.mark.parametrize("form", ["text", "binary"])
@pytest.mark.parametrize("inside", [".", "sparse/0"])
def test_a_model_is_the_ground_truth_of_its_images_and_said(tmp_path: Path, form: str, inside: str) -> None:
    write_model(tmp_path / inside, form, NAMES)
    sequence = opened(tmp_path)
    assert sequence.groundtruth is not None
    np.testing.assert_allclose(sequence.groundtruth.poses, SCENE.poses, atol=1e-9)
    said = " ".join(problem.message for problem in sequence.problems)
    assert "taken as the ground truth, which COLMAP has estimated" in said
    assert "map the world to the camera: inverted; in a unit of its own" in said


@pytest.mark.parametrize("form", ["text", "binary"])
def test_a_model_is_a_trajectory_to_import(tmp_path: Path, form: str) -> None:
    folder = write_model(tmp_path / "sparse" / "0", form, NAMES[:2] + NAMES[3:], np.delete(SCENE.poses, 2, axis=0))
    files = trajectory_files(tmp_path, ["alice"])
    assert files == {"alice": folder / f"images.{'txt' if form == 'text' else 'bin'}"}
    found = given(files["alice"])
    assert not found.timed and found.form == "COLMAP, by the images' names"
    np.testing.assert_array_equal(found.trajectory.stamps_ns, np.delete(SCENE.stamps_ns, 2))
    np.testing.assert_allclose(found.trajectory.poses, np.delete(SCENE.poses, 2, axis=0), atol=1e-9)


def test_names_with_folders_tell_robots_and_cameras_apart(tmp_path: Path) -> None:
    """Of robots with images of equal names; what is in none of the folders is no robot's."""
    names = [f"{robot}/images/{name}" for robot in ("bob", "alice") for name in NAMES]
    poses = np.concatenate([SCENE.poses[::-1], SCENE.poses])
    model = write_model(tmp_path, "text", names, poses) / "images.txt"
    assert trajectory_files(tmp_path, ["alice", "bob"]) == {"alice": model, "bob": model}
    np.testing.assert_allclose(given(model).trajectory.poses, SCENE.poses, atol=1e-9)
    both = write_model(
        tmp_path / "rig", "text", [f"{side}/{name}" for side in ("left", "right") for name in NAMES], poses
    )
    with pytest.raises(FrontendError, match="names no image here"):
        given(both / "images.txt")
    twice = write_model(tmp_path / "b", "text", [f"{one}/images/{name}" for one in "ab" for name in NAMES], poses)
    with pytest.raises(FrontendError, match=r"a/images/000000\.png and b/images/000000\.png may be images/000000\.png"):
        given(twice / "images.txt")
    alone = write_model(tmp_path / "alone", "text", NAMES)
    with pytest.raises(ToolError, match="one trajectory for 2 sequences"):
        trajectory_files(alone / "images.txt", ["alice", "bob"])


def test_lines_without_key_points_may_be_missing_and_broken_ones_are_named(tmp_path: Path) -> None:
    lines = (write_model(tmp_path, "text", NAMES) / "images.txt").read_text().splitlines()
    images = [line for line in lines if line.endswith(".png")]
    (tmp_path / "images.txt").write_text("\n".join(images) + "\n")
    np.testing.assert_allclose(given(tmp_path / "images.txt").trajectory.poses, SCENE.poses, atol=1e-9)
    (tmp_path / "images.txt").write_text("\n".join([images[0], "", images[1].replace(" ", ",")]) + "\n")
    with pytest.raises(FrontendError, match=r"images\.txt:3: an image's number, qw qx qy qz"):
        read_poses(tmp_path / "images.txt")
    data = (write_model(tmp_path, "binary", NAMES) / "images.bin").read_bytes()
    (tmp_path / "images.bin").write_bytes(data[:-3])
    with pytest.raises(FrontendError, match=r"images\.bin: .* missing"):
        read_poses(tmp_path / "images.bin")


def test_a_list_of_names_called_images_is_no_model(tmp_path: Path) -> None:
    (tmp_path / "images.txt").write_text("\n".join(NAMES) + "\n")
    sequence = opened(tmp_path)
    assert sequence.groundtruth is None and sequence.problems == ()


@pytest.mark.parametrize("scale", [None, 0.25])
def test_transforms_are_a_trajectory_to_import(tmp_path: Path, scale: float | None) -> None:
    poses = SCENE.poses @ OPENGL
    poses[:, :3, 3] *= scale or 1.0
    frames = [
        {"file_path": f"./images/{name[:-4]}", "transform_matrix": T.tolist()}
        for name, T in zip(NAMES, poses, strict=True)
    ]
    extra = {} if scale is None else {"applied_scale": scale}
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": FX, **extra, "frames": frames[::-1]}))
    files = trajectory_files(tmp_path, ["alice"])
    found = given(files["alice"])
    np.testing.assert_allclose(found.trajectory.poses, SCENE.poses, atol=1e-9)
    assert "turned from OpenGL's" in found.notes[0]
