"""What newcomers bring that was passed over in silence, or refused without a cure: calibrations in archives, images in
two formats, truths in forms that are not read, archives and films of other kinds as sources."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import COUNT, HEIGHT, WIDTH, make_scene, numbered, own_camera, write_images

from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.datasets import open_dataset
from maslam.frontend.errors import FrontendError

SCENE = make_scene()
K = np.array([[410.0, 0.0, WIDTH / 2], [0.0, 411.0, HEIGHT / 2], [0.0, 0.0, 1.0]])
DIST = np.array([[-0.2, 0.05, 0.001, -0.001, 0.01]])


def written(folder: Path, camera: bool = True) -> Path:
    write_images(folder, numbered(), SCENE.images)
    if camera:
        (folder / "camera.yaml").write_text(own_camera())
    return folder


def messages(folder: Path) -> str:
    [sequence] = open_dataset(folder, strict=False).sequences
    return "\n".join(problem.message for problem in sequence.problems)


@pytest.mark.parametrize(("matrix", "coefficients"), [("mtx", "dist"), ("camMatrix", "distCoef"), ("K", "D")])
def test_a_calibration_in_an_archive_of_arrays_is_read(tmp_path: Path, matrix: str, coefficients: str) -> None:
    """As OpenCV's tutorials save it, with the views of the board beside."""
    views = np.zeros((40, 3, 1))
    np.savez(tmp_path / "B.npz", **{matrix: K, coefficients: DIST, "rvecs": views, "tvecs": views})
    left = read_calibration(tmp_path / "B.npz").left
    assert (left.fx, left.fy, left.cx, left.cy) == (410.0, 411.0, WIDTH / 2, HEIGHT / 2)
    assert left.coefficients[:5] == tuple(DIST[0])
    [sequence] = open_dataset(written(tmp_path / "set", camera=False), strict=False).sequences
    assert sequence.focal_guess
    (tmp_path / "B.npz").rename(tmp_path / "set" / "B.npz")
    np.savez(tmp_path / "set" / "poses.npz", poses=SCENE.poses)  # no camera, passed over
    [sequence] = open_dataset(tmp_path / "set", strict=False).sequences
    assert not sequence.focal_guess and sequence.groundtruth is not None


def test_other_coefficients_in_an_archive_are_not_passed_over(tmp_path: Path) -> None:
    np.savez(tmp_path / "calib.npz", mtx=K, distorsion=DIST)
    with pytest.raises(FrontendError, match=r"calib.npz: .*distorsion"):
        read_calibration(tmp_path / "calib.npz")
    (tmp_path / "calib.npz").write_bytes(b"no archive")
    with pytest.raises(FrontendError, match=r"calib.npz: damaged, or not such a file"):
        read_calibration(tmp_path / "calib.npz")


@pytest.mark.parametrize(
    "name", ["camera_matrix.npy", "calibration.pkl", "intrinsics.toml", "cameraParams.mat", "mtx.npy"]
)
def test_a_calibration_that_is_not_read_is_named(tmp_path: Path, name: str) -> None:
    (written(tmp_path, camera=False) / name).write_bytes(b"x")
    assert f"{name} is a calibration by its name, which is not read" in messages(tmp_path)


def test_images_in_two_formats_are_not_two_images_each(tmp_path: Path) -> None:
    folder = written(tmp_path)
    for path in list(folder.glob("*.png")):
        cv2.imwrite(str(path.with_suffix(".jpg")), cv2.imread(str(path)))
    with pytest.raises(
        FrontendError, match=rf"{COUNT} of its {2 * COUNT} images have the name of another .*jpg and .png"
    ):
        open_dataset(folder)
    for path in list(folder.glob("*.jpg"))[1:]:
        path.unlink()
    (folder / "000000.png").unlink()
    assert len(open_dataset(folder).sequences[0]) == COUNT, "some in another format are images"


@pytest.mark.parametrize("name", ["groundtruth.xlsx", "gt.jsonl", "poses.txt.gz", "ground_truth.mat", "robot_gt.pkl"])
def test_a_truth_in_a_form_that_is_not_read_is_named(tmp_path: Path, name: str) -> None:
    (written(tmp_path) / name).write_bytes(b"x")
    assert f"{name}: by the name a ground truth, in a form that is not read" in messages(tmp_path)


def nested(folder: Path) -> Path:
    written(folder / "2021" / "data" / "images")
    return folder


def holding(name: str) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(b"x")
        return folder

    return make


def being(name: str) -> Callable[[Path], Path]:
    return lambda folder: holding(name)(folder) / name


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (nested, "no images directly in it, but in 2021/data/images: name that folder, or 2021/data with what lies"),
        (holding("drive.mts"), "holds drive.mts, which is not read: ffmpeg -i drive.mts -c copy drive.mkv"),
        (holding("drive.zip"), "holds drive.zip, which is not read: unpack it"),
        (being("drive.tar.gz"), "unpack it, and name the folder"),
        (being("drive.wmv"), "ffmpeg -i drive.wmv"),
        (being("0001.png"), "one image; name its folder"),
        (holding("manifest.json"), "agent sequences, which `maslam preprocess` made"),
        (holding("notes.md"), "no images of a known layout here"),
    ],
)
def test_sources_that_are_not_read_are_refused_with_the_cure(
    tmp_path: Path, make: Callable[[Path], Path], said: str
) -> None:
    with pytest.raises(FrontendError, match=r"^[^\n]*$") as caught:
        open_dataset(make(tmp_path))
    assert said in str(caught.value)
