"""Calibrations of Open3D, RealSense, OpenCV's tutorials, and numbers without names; files that hold none are said."""

from __future__ import annotations

import codecs
import json
from pathlib import Path

import numpy as np
import pytest
from dataset_makers import CX, CY, FX, FY, HEIGHT, WIDTH, make_scene, numbered, own_camera, write_images

from maslam.frontend.cameras.calibration import Distortion, RawCamera
from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.datasets import ImageSequence, open_dataset
from maslam.frontend.errors import FrontendError

SCENE = make_scene()
BENT = (-0.2, 0.05, 0.001, -0.002)
SIZE = {"width": WIDTH, "height": HEIGHT}
MATRIX = [[FX, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]]
ROWS = "\n".join(" ".join(map(str, row)) for row in MATRIX)
PLAIN, LENS = RawCamera(FX, FY, CX, CY), RawCamera(FX, FY, CX, CY, None, Distortion.RADIAL_TANGENTIAL, BENT)
OPEN3D = {**SIZE, "intrinsic_matrix": [FX, 0, 0, 0, FY, 0, CX, CY, 1]}
REALSENSE = {**SIZE, "ppx": CX, "ppy": CY, "fx": FX, "fy": FY, "model": "Brown Conrady", "coeffs": [0.0] * 5}
SIZED = RawCamera(FX, FY, CX, CY, (WIDTH, HEIGHT))


@pytest.mark.parametrize(
    ("name", "text", "camera"),
    [
        ("camera_intrinsic.json", json.dumps(OPEN3D), SIZED),
        ("intrinsics.json", json.dumps(REALSENSE), SIZED),
        ("rs.json", json.dumps({**REALSENSE, "coeffs": [*BENT, 0.0], "model": "distortion.brown_conrady"}),
         RawCamera(FX, FY, CX, CY, (WIDTH, HEIGHT), Distortion.RADIAL_TANGENTIAL, (*BENT, 0.0))),
        ("calibration.json", json.dumps({"mtx": MATRIX, "dist": [BENT]}), LENS),
        ("calibration.yaml", f"camera_matrix: {MATRIX}\ndist_coeff: [{list(BENT)}]\n", LENS),
        ("calib.txt", f"{FX} {FY} {CX} {CY}\n", PLAIN),
        ("calib.txt", f"# fx fy cx cy k1 k2 p1 p2\r\n{FX}, {FY}, {CX}, {CY}, {', '.join(map(str, BENT))}\r\n", LENS),
        ("intrinsics.txt", ROWS + "\n", PLAIN),
        ("K.txt", " ".join(ROWS.split()), PLAIN),
        ("camera.txt", f"{FX} 0 {CX} 0\n0 {FY} {CY} 0\n0 0 1 0\n0 0 0 1\n", PLAIN),
        ("camera-intrinsics.txt", "\n".join(map(str, (FX, FY, CX, CY))), PLAIN),
    ],
)  # fmt: skip
@pytest.mark.parametrize("mark", [b"", codecs.BOM_UTF8])
def test_what_is_understood(tmp_path: Path, name: str, text: str, camera: RawCamera, mark: bytes) -> None:
    write_images(tmp_path / "images", numbered(), SCENE.images)
    (tmp_path / name).write_bytes(mark + text.encode())
    assert read_calibration(tmp_path / name).left == camera
    [sequence] = open_dataset(tmp_path).sequences
    assert not sequence.focal_guess and name in sequence.understood[0].sentence()


PAIRS = {
    "mtxL": ("mtxL", "distL", "mtxR", "distR"), "mtx_left": ("mtx_left", "dist_left", "mtx_right", "dist_right"),
    "cameraMatrixL": ("cameraMatrixL", "distCoeffsL", "cameraMatrixR", "distCoeffsR"),
    "K1": ("K1", "D1", "K2", "D2"), "mtx1": ("mtx1", "dist1", "mtx2", "dist2"),
}  # fmt: skip


@pytest.mark.parametrize("keys", PAIRS.values(), ids=PAIRS)
def test_a_pair_is_known_by_what_tutorials_call_its_matrices(tmp_path: Path, keys: tuple[str, ...]) -> None:
    other = [[FX + 5.0, 0.0, CX], [0.0, FY, CY], [0.0, 0.0, 1.0]]
    values = dict(zip(keys, (MATRIX, [BENT], other, [[0.0] * 5]), strict=True))
    np.savez(tmp_path / "stereo.npz", R=np.eye(3), T=[[-0.2], [0.0], [0.0]], **values)
    rig = read_calibration(tmp_path / "stereo.npz")
    assert rig.left == LENS and rig.right is not None and rig.right.fx == FX + 5.0
    assert rig.T_left_right is not None and rig.T_left_right[0, 3] == pytest.approx(0.2)
    odd = {f"odd_{key}" if "ist" in key or key[0] == "D" else key: value for key, value in values.items()}
    np.savez(tmp_path / "odd.npz", R=np.eye(3), T=[[-0.2], [0.0], [0.0]], **odd)
    if keys[1] != "D1":  # nothing in odd_D1 says what it is
        with pytest.raises(FrontendError, match=f"odd_{keys[1]}: coefficients of a lens under another name"):
            read_calibration(tmp_path / "odd.npz")


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("a.json", json.dumps({**OPEN3D, "intrinsic_matrix": [FX, 0, CX, 0, FY, CY, 0, 0, 1]}), "column by column"),
        ("a.json", json.dumps({**REALSENSE, "model": "inverse brown conrady", "coeffs": [*BENT, 0.0]}), "model: Brown"),
        ("camera.json", json.dumps({"focal": 500}), "no camera in this file"),
        ("calibration.xml", "<?xml version='1.0'?>\n<a><focal>500</focal></a>", "no camera in this file"),
        ("camera.yaml", "K: [0, 0, 0, 0, 0, 0, 0, 0, 0]\nD: []\n", "K: the matrix of a calibrated camera expected"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, text: str, said: str) -> None:
    write_images(tmp_path / "images", numbered(), SCENE.images)
    (tmp_path / name).write_text(text)
    with pytest.raises(FrontendError, match=rf"{name}: .*{said}"):
        open_dataset(tmp_path)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("P0: 1 2 3\n", "calib.txt:1: fx fy cx cy, with"),
        (f"{FX} {FY} {CX}\n", "found 3 numbers in 1 lines"),
        (f"{FX} {FY} {CX} nan\n", "finite numbers expected"),
        (f"{FX} 2 {CX}\n0 {FY} {CY}\n0 0 1\n", "a camera without skew"),
        ("", "found nothing"),
        ("0.5 0.5 0.5 0.5 1 2 3\n", "found 7 numbers"),
    ],
)
def test_numbers_that_are_no_camera_are_said_where_a_focal_length_is_guessed(
    tmp_path: Path, text: str, said: str
) -> None:
    write_images(tmp_path / "images", numbered(), SCENE.images)
    (tmp_path / "calib.txt").write_text(text)
    with pytest.raises(FrontendError, match=said):
        read_calibration(tmp_path / "calib.txt")
    [sequence] = open_dataset(tmp_path).sequences
    assert sequence.focal_guess and "; calib.txt is of no form that is read" in sequence.problems[0].message


def test_a_file_of_names_comes_before_numbers(tmp_path: Path) -> None:
    write_images(tmp_path / "images", numbered(), SCENE.images)
    (tmp_path / "calib.txt").write_text("1 2 3 4\n")
    (tmp_path / "my.yaml").write_text(own_camera())
    assert _opened(tmp_path).rig.camera.fx == FX


def test_a_baseline_of_millimetres_is_doubted(tmp_path: Path) -> None:
    """0.54 m given as Camera.bf is a baseline of 7 mm."""
    for side, images in (("left", SCENE.images), ("right", SCENE.rights)):
        write_images(tmp_path / side, numbered(), images)
    keys = "".join(f"Camera.{k}: {v}\n" for k, v in (("fx", FX), ("fy", FY), ("cx", CX), ("cy", CY), ("bf", 0.54)))
    (tmp_path / "camera.yaml").write_text("%YAML:1.0\n" + keys)
    messages = [problem.message for problem in _opened(tmp_path).problems]
    assert any("the stereo baseline is 6.75 mm" in m and "Camera.bf is the baseline times fx" in m for m in messages)


def _opened(folder: Path) -> ImageSequence:
    [sequence] = open_dataset(folder).sequences
    return sequence


def test_matrices_that_are_not_of_rectified_images_are_refused(tmp_path: Path) -> None:
    """left.yaml and right.yaml as ROS writes them, but with a transform in millimetres in P."""
    for side, images in (("left", SCENE.images), ("right", SCENE.rights)):
        write_images(tmp_path / side, numbered(), images)
        P = [FX, 0, CX, 0, 0, FY, CY, 0, 0, 0, 1, 0]
        if side == "right":
            P[3], P[7], P[11] = -250.0, -4.0, -1.0
        text = f"K: {[v for row in MATRIX for v in row]}\nD: [0, 0, 0, 0]\nR: [1, 0, 0, 0, 1, 0, 0, 0, 1]\nP: {P}\n"
        (tmp_path / f"{side}.yaml").write_text(text)
    with pytest.raises(FrontendError, match=r"left.yaml: projection matrices whose third row is not 0 0 1 0"):
        open_dataset(tmp_path)
