"""Calibration files of every format, from text written here by the formats' own documents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from maslam.frontend.cameras.calibration import Distortion, RawRig
from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.datasets.camera_file import find_camera_file
from maslam.frontend.errors import FrontendError

OWN = """width: 640
height: 480
fx: 500.0
fy: 501.0
cx: 320.5
cy: 241.0
baseline_m: 0.12
depth_unit_m: 0.0002
rate_hz: 15
"""

OPENCV = """%YAML:1.0
---
calibration_time: "Mon 01 Jan 2024"
image_width: 640
image_height: 480
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 500.0, 0., 320.5, 0., 501.0, 241.0, 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -2.0e-01, 5.0e-02, 1.0e-03, -1.0e-03, 2.0e-03 ]
"""

ROS = """image_width: 640
image_height: 480
camera_name: narrow
camera_matrix:
  rows: 3
  cols: 3
  data: [500.0, 0.0, 320.5, 0.0, 501.0, 241.0, 0.0, 0.0, 1.0]
distortion_model: {model}
distortion_coefficients:
  rows: 1
  cols: 5
  data: [{d}]
rectification_matrix:
  rows: 3
  cols: 3
  data: [{R}]
projection_matrix:
  rows: 3
  cols: 4
  data: [480.0, 0.0, 322.0, {Tx}, 0.0, 480.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
"""

MESSAGE = """header: {seq: 0}
height: 480
width: 640
distortion_model: "plumb_bob"
D: [0.0, 0.0, 0.0, 0.0, 0.0]
K: [500.0, 0.0, 320.5, 0.0, 501.0, 241.0, 0.0, 0.0, 1.0]
"""

ORB2 = """%YAML:1.0

#--------------------------------------------------------------------------------------------
Camera.fx: 500.0
Camera.fy: 501.0
Camera.cx: 320.5
Camera.cy: 241.0
Camera.k1: -0.2
Camera.k2: 0.05
Camera.p1: 0.001
Camera.p2: -0.001
Camera.fps: 30.0
Camera.RGB: 1
DepthMapFactor: 5000.0
ORBextractor.nFeatures: 1000
"""

ORB3 = """%YAML:1.0
File.version: "1.0"
Camera.type: "PinHole"
Camera1.fx: 500.0
Camera1.fy: 501.0
Camera1.cx: 320.5
Camera1.cy: 241.0
Camera1.k1: -0.2
Camera1.k2: 0.05
Camera1.p1: 0.001
Camera1.p2: -0.001
Camera2.fx: 490.0
Camera2.fy: 491.0
Camera2.cx: 310.5
Camera2.cy: 231.0
Camera2.k1: -0.1
Camera2.k2: 0.01
Camera2.p1: 0.0
Camera2.p2: 0.0
Camera.width: 640
Camera.height: 480
Camera.fps: 20
Stereo.T_c1_c2: !!opencv-matrix
  rows: 4
  cols: 4
  dt: f
  data: [1.0, 0.0, 0.0, 0.12, 0.0, 0.8, -0.6, 0.01, 0.0, 0.6, 0.8, 0.02, 0.0, 0.0, 0.0, 1.0]
"""

KALIBR = """cam0:
  camera_model: pinhole
  intrinsics: [500.0, 501.0, 320.5, 241.0]
  distortion_model: equidistant
  distortion_coeffs: [-0.01, 0.002, -0.003, 0.0004]
  resolution: [640, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [1.0, 0.0, 0.0, -0.12]
  - [0.0, 1.0, 0.0, 0.0]
  - [0.0, 0.0, 1.0, 0.0]
  - [0.0, 0.0, 0.0, 1.0]
  camera_model: pinhole
  intrinsics: [490.0, 491.0, 310.5, 231.0]
  distortion_model: radtan
  distortion_coeffs: [-0.1, 0.01, 0.0, 0.0]
  resolution: [640, 480]
"""

IDENTITY = "1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0"
RADTAN, FISHEYE, NONE = Distortion.RADIAL_TANGENTIAL, Distortion.EQUIDISTANT, Distortion.NONE


def ros(
    model: str = "plumb_bob", d: str = "-0.2, 0.05, 0.001, -0.001, 0.002", R: str = IDENTITY, Tx: float = 0.0
) -> str:
    return ROS.format(model=model, d=d, R=R, Tx=Tx)


def read(tmp_path: Path, text: str) -> RawRig:
    path = tmp_path / "camera.yaml"
    path.write_text(text)
    return read_calibration(path)


@pytest.mark.parametrize(
    ("text", "size", "distortion", "coefficients"),
    [
        (OWN, (640, 480), NONE, ()),
        (OPENCV, (640, 480), RADTAN, (-0.2, 0.05, 0.001, -0.001, 0.002)),
        (ros(), (640, 480), RADTAN, (-0.2, 0.05, 0.001, -0.001, 0.002)),
        (ros("rational_polynomial", "1., 2., 3., 4., 5., 6., 7., 8."), (640, 480), RADTAN, (1, 2, 3, 4, 5, 6, 7, 8)),
        (ros("equidistant", "0.1, 0.2, 0.3, 0.4"), (640, 480), FISHEYE, (0.1, 0.2, 0.3, 0.4)),
        (ros("plumb_bob", "0., 0., 0., 0., 0."), (640, 480), NONE, ()),
        (MESSAGE, (640, 480), NONE, ()),
        (ORB2, None, RADTAN, (-0.2, 0.05, 0.001, -0.001)),
        (ORB3, (640, 480), RADTAN, (-0.2, 0.05, 0.001, -0.001)),
        (KALIBR, (640, 480), FISHEYE, (-0.01, 0.002, -0.003, 0.0004)),
    ],
)
def test_the_left_camera(
    tmp_path: Path, text: str, size: tuple[int, int], distortion: Distortion, coefficients: tuple[float, ...]
) -> None:
    left = read(tmp_path, text).left
    assert (left.fx, left.fy, left.cx, left.cy) == (500.0, 501.0, 320.5, 241.0)
    assert (left.size, left.distortion, left.coefficients) == (size, distortion, coefficients)


def test_our_own_file(tmp_path: Path) -> None:
    rig = read(tmp_path, OWN)
    assert rig.rectified and rig.baseline_m == 0.12 and rig.depth_unit_m == 0.0002 and rig.rate_hz == 15
    assert read(tmp_path, OWN.replace("baseline_m: 0.12\n", "")).right is None


def test_orb_slam_settings(tmp_path: Path) -> None:
    mono = read(tmp_path, ORB2)
    assert mono.right is None and mono.depth_unit_m == pytest.approx(1 / 5000) and mono.rate_hz == 30
    flat = (
        ORB2.replace("-0.2", "0")
        .replace("0.05", "0")
        .replace("0.001", "0")
        .replace("-0.001", "0")
        .replace("-0\n", "0\n")
    )
    rectified = read(tmp_path, flat + "Camera.bf: 60.0\n")
    assert rectified.rectified and rectified.baseline_m == pytest.approx(0.12)
    raw = read(tmp_path, ORB3)
    assert not raw.rectified and raw.right is not None and raw.right.fx == 490.0 and raw.T_left_right is not None
    # T_c1_c2 maps camera 2 into camera 1: its last column is where camera 2 stands.
    np.testing.assert_allclose(raw.T_left_right[:3, 3], [0.12, 0.01, 0.02])
    np.testing.assert_allclose(raw.T_left_right[1:3, 1:3], [[0.8, -0.6], [0.6, 0.8]])


def test_orb_slam2_raw_stereo_settings(tmp_path: Path) -> None:
    side = "{s}.width: 640\n{s}.height: 480\n{s}.D: [-0.2, 0.05, 0.0, 0.0, 0.0]\n"
    side += "{s}.K: [500.0, 0.0, 320.5, 0.0, 501.0, 241.0, 0.0, 0.0, 1.0]\n"
    side += "{s}.R: [{R}]\n{s}.P: [480.0, 0.0, 322.0, {Tx}, 0.0, 480.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]\n"
    text = (
        ORB2.replace("%YAML:1.0\n", "")
        + side.format(s="LEFT", R=IDENTITY, Tx=0.0)
        + side.format(s="RIGHT", R=IDENTITY, Tx=-57.6)
    )
    rig = read(tmp_path, text)
    assert not rig.rectified and rig.baseline_m == pytest.approx(0.12) and rig.left.coefficients[0] == -0.2


def test_kalibr_pair(tmp_path: Path) -> None:
    rig = read(tmp_path, KALIBR)
    # T_cn_cnm1 maps cam0 into cam1: the right camera stands at +0.12 in the left one.
    assert not rig.rectified and rig.baseline_m == pytest.approx(0.12)
    assert rig.right is not None and rig.right.distortion is RADTAN
    assert read(tmp_path, KALIBR[: KALIBR.index("cam1:")]).right is None


def test_a_pair_of_ros_files_stands_as_its_rectification_says(tmp_path: Path) -> None:
    c, s = np.cos(0.1), np.sin(0.1)
    turn = np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])
    (tmp_path / "left.yaml").write_text(ros())
    (tmp_path / "right.yaml").write_text(ros(R=", ".join(map(repr, turn.ravel().tolist())), Tx=-57.6))
    found = find_camera_file(tmp_path)
    assert found is not None
    T = found[0].T_left_right
    assert T is not None
    # A point ahead of the right camera, by hand: turned into the rectified frame, moved by the baseline 57.6 / 480.
    np.testing.assert_allclose(T[:3, :3] @ [0, 0, 2] + T[:3, 3], turn @ [0, 0, 2] + [0.12, 0, 0], atol=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (OWN.replace("fx: 500.0", "fx: wide"), "camera.yaml: fx: a number expected, found 'wide'"),
        (OWN.replace("fx: 500.0", "fx: .nan"), "camera.yaml: fx: a finite number expected"),
        (OWN.replace("cy: 241.0\n", ""), "camera.yaml: cy: a number expected, found None"),
        (OWN.replace("fx: 500.0", "fx: -500.0"), "focal lengths -500.0, 501.0 px cannot be"),
        (ros("omnidirectional"), "distortion model 'omnidirectional' is not known"),
        (ros("equidistant"), "5 coefficients for equidistant distortion"),
        (ros().replace("data: [500.0, 0.0,", "data: [500.0,"), "camera_matrix: 9 finite numbers expected"),
        (
            KALIBR.replace("camera_model: pinhole", "camera_model: scaramuzza"),
            "cam0.camera_model: pinhole, omni, eucm or ds expected, found 'scaramuzza'",
        ),
        (
            KALIBR.replace("[0.0, 1.0, 0.0, 0.0]", "[0.0, 2.0, 0.0, 0.0]"),
            "cam1.T_cn_cnm1: a rigid 4x4 transform expected",
        ),
        (OWN + "basline_m: 0.5\n", "camera.yaml: basline_m: no such key; did you mean 'baseline_m'"),
        (OWN + "k1: -0.3\n", "camera.yaml: k1: no such key"),
        ("a: [1, 2", "camera.yaml: not YAML"),
        ("just words", "camera.yaml: not a calibration"),
        ("lens: good\n", "no camera in this file"),
    ],
)
def test_files_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(FrontendError, match=message):
        read(tmp_path, text)


def test_nothing_in_a_file_is_executed(tmp_path: Path) -> None:
    with pytest.raises(FrontendError, match="not YAML"):
        read(tmp_path, "fx: !!python/object/apply:os.getcwd []\n")
