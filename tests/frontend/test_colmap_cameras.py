"""COLMAP's files of cameras, against COLMAP."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from calibration_texts import read

from maslam.frontend.cameras.calibration import RawCamera
from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.cameras.lens import project
from maslam.frontend.datasets.camera_file import find_camera_file
from maslam.frontend.errors import FrontendError


def pycolmap_cameras() -> dict[str, object]:
    pycolmap = pytest.importorskip("pycolmap")
    lens = {"k": 0.05, "k1": 0.05, "k2": -0.02, "k3": 0.01, "k4": 0.003, "k5": 0.02, "k6": 0.001, "p1": 0.002,
            "p2": -0.001, "omega": 0.9, "alpha": 0.6, "beta": 1.1, "f": 400.0, "fx": 400.0, "fy": 405.0, "cx": 360.5,
            "cy": 240.5}  # fmt: skip
    cameras = {}
    for name, model in pycolmap.CameraModelId.__members__.items():
        if name == "INVALID":
            continue
        one = pycolmap.Camera.create_from_model_id(1, model, 400.0, 752, 480)
        if all(key in lens for key in one.params_info.split(", ")):
            one.params = [lens[key] for key in one.params_info.split(", ")]
        cameras[name] = one
    return cameras


def test_colmaps_cameras_are_colmaps(tmp_path: Path) -> None:
    """Every model that COLMAP has, as COLMAP writes it in both forms: read with the same projection, or refused."""
    pycolmap = pytest.importorskip("pycolmap")
    rays = np.random.default_rng(5).uniform([-0.5, -0.4, 1.0], [0.5, 0.4, 1.0], (40, 3))
    refused = []
    for name, one in pycolmap_cameras().items():
        model = pycolmap.Reconstruction()
        model.add_camera_with_trivial_rig(one)
        folder = tmp_path / name
        folder.mkdir()
        model.write_binary(str(folder))
        model.write_text(str(folder))
        try:
            rigs = [read_calibration(folder / file) for file in ("cameras.txt", "cameras.bin")]
        except FrontendError as error:
            refused.append(name if f"the model {name} is not read" in str(error) else str(error))
            continue
        expected = np.array([one.img_from_cam(ray) for ray in rays]) - 0.5
        for rig in rigs:
            assert rig.left.size == (752, 480)
            np.testing.assert_allclose(project(rig.left, rays), expected, atol=1e-6, err_msg=name)
    assert {"OPENCV", "EUCM", "FOV", "SIMPLE_RADIAL_FISHEYE"}.isdisjoint(refused)
    assert {"THIN_PRISM_FISHEYE", "EQUIRECTANGULAR"} <= set(refused)


def test_colmaps_files_beside_images_come_after_a_file_of_ours(tmp_path: Path) -> None:
    line = "# Camera list\r\n1 PINHOLE 752 480 400 401 360.5 240.5\r\n"
    (tmp_path / "sparse/0").mkdir(parents=True)
    (tmp_path / "sparse/0/cameras.txt").write_text(line)
    found = find_camera_file(tmp_path)
    assert found is not None and found[0].left == RawCamera(400.0, 401.0, 360.0, 240.0, (752, 480))
    (tmp_path / "camera.yaml").write_text("fx: 300\nfy: 300\ncx: 100\ncy: 100\n")
    both = find_camera_file(tmp_path)
    assert both is not None and both[0].left == RawCamera(300.0, 300.0, 100.0, 100.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 PINHOLE 752 480 400 401 360.5\n", "PINHOLE has 4 finite parameters, found 3"),
        ("1 PINHOLE 752\n", "cameras.txt:1: a camera's number, model, width, height and parameters expected"),
        ("\n1 BENT 752 480 4 4\n", "cameras.txt:2: the model 'BENT' is not known"),
        ("1 PINHOLE 752 480 400 1_0 360.5 1\n", "line 1: parameters: a list of numbers expected"),
        ("1 PINHOLE 752 480 4 4 1 1\n2 PINHOLE 752 480 5 4 1 1\n", "2 unlike cameras"),
        ("# nothing\n", "no camera in this file"),
        ("1 EQUIRECTANGULAR 752 480 752 480\n", "the model EQUIRECTANGULAR is not read"),
    ],
)
def test_colmaps_text_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FrontendError, match=message):
        read(tmp_path, text, "cameras.txt")


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"\x01", "cut off after 1 bytes"),
        (struct.pack("<QIiQQ", 1, 1, 1, 752, 480), "cut off"),
        (struct.pack("<QIiQQ", 2**60, 1, 99, 752, 480), "the model number 99 is not known"),
        (struct.pack("<QIiQQ4dB", 1, 1, 1, 752, 480, 1, 1, 1, 1, 7), "1 bytes behind the last camera"),
    ],
)
def test_colmaps_binary_that_cannot_be_used(tmp_path: Path, data: bytes, message: str) -> None:
    (tmp_path / "cameras.bin").write_bytes(data)
    with pytest.raises(FrontendError, match=message):
        read_calibration(tmp_path / "cameras.bin")
