"""Files of every format, written here by the formats' own documents: the camera and the pair that they name."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from calibration_texts import (
    ECHO,
    FISHEYE,
    K4,
    LOWER,
    MIDDLE,
    OPENCV,
    RADTAN,
    T_BODY_LEFT,
    T_BODY_RIGHT,
    T_LEFT_RIGHT,
    T_RIGHT_LEFT,
    UPPER,
    XI,
    basalt,
    kalibr,
    kalibr_pair,
    nerfstudio,
    numbers,
    opencv_matrix,
    orb,
    read,
    rows,
    stella,
    vins,
)

from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.frontend.cameras.calibration import Distortion, RawCamera, RawRig
from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.datasets.camera_file import find_camera_file
from maslam.frontend.errors import FrontendError

D = Distortion


def put(tmp_path: Path, files: dict[str, str]) -> RawRig:
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    found = find_camera_file(tmp_path)
    assert found is not None
    return found[0]


ONE_CAMERA = {
    "ROS 2 message": (ECHO.format(model="plumb_bob", d="[0.1, 0.2, 0.3, 0.4, 0.5]", **LOWER), D.RADIAL_TANGENTIAL,
                      (0.1, 0.2, 0.3, 0.4, 0.5)),
    "ROS 1 message": (ECHO.format(model="equidistant", d=list(K4), **UPPER), D.EQUIDISTANT, K4),
    "ROS 2 message without distortion": (ECHO.format(model="plumb_bob", d="\n- 0.0\n- 0.0", **LOWER), D.NONE, ()),
    "OpenCV, fisheye_model": (OPENCV.format(more="fisheye_model: 1\n"), D.EQUIDISTANT, K4),
    "OpenCV, fisheye": (OPENCV.format(more="fisheye: 1\n"), D.EQUIDISTANT, K4),
    "OpenCV, fisheye of no": (OPENCV.format(more="fisheye: false\n"), D.RADIAL_TANGENTIAL, K4),
    "OpenCV, no fisheye_model": (OPENCV.format(more="fisheye_model: 0\n"), D.RADIAL_TANGENTIAL, K4),
    "OpenCV, omnidir": (OPENCV.format(more="xi: 1.7\n"), D.OMNIDIRECTIONAL, (1.7, *K4)),
    "RTAB-Map, fisheye": (
        OPENCV.format(more="distortion_model: fisheye\n").replace("0.05, -0.01, ", "0.05, -0.01, 0., 0., "),
        D.EQUIDISTANT,
        K4,
    ),
    "Kalibr, omni": ("cam0:\n" + kalibr("omni", [1.7, 400, 401, 360, 240], "radtan", [-0.3, 0.1, 0.001, -0.002]),
                     D.OMNIDIRECTIONAL, (1.7, -0.3, 0.1, 0.001, -0.002)),
    "Kalibr, omni without distortion": ("cam0:\n" + kalibr("omni", [1.7, 400, 401, 360, 240], "none", []),
                                        D.OMNIDIRECTIONAL, (1.7, 0, 0, 0, 0)),
    "Kalibr, ds": ("cam0:\n" + kalibr("ds", [-0.2, 0.6, 400, 401, 360, 240], "none", []),
                   D.DOUBLE_SPHERE, (-0.2, 0.6)),
    "Kalibr, eucm": ("cam0:\n" + kalibr("eucm", [0.6, 1.1, 400, 401, 360, 240], "none", []),
                     D.EXTENDED_UNIFIED, (0.6, 1.1)),
    "Kalibr, fov": ("cam0:\n" + kalibr("pinhole", [400, 401, 360, 240], "fov", [0.9]), D.FIELD_OF_VIEW, (0.9,)),
    "Kalibr, equidistant without effect": (
        "cam0:\n" + kalibr("pinhole", [400, 401, 360, 240], "equidistant", [0.0] * 4), D.EQUIDISTANT, (0, 0, 0, 0)),
    "VINS, pinhole": (vins("PINHOLE", MIDDLE, RADTAN), D.RADIAL_TANGENTIAL, (-0.3, 0.1, 0.001, -0.002)),
    "VINS, Kannala-Brandt": (
        vins("KANNALA_BRANDT", {"k2": 0.05, "k3": -0.01, "k4": 0.004, "k5": -0.001, "mu": 400, "mv": 401, "u0": 360,
                                "v0": 240}, {}), D.EQUIDISTANT, K4),
    "VINS, mirror": (vins("MEI", {"gamma1": 400, "gamma2": 401, "u0": 360, "v0": 240}, RADTAN, XI),
                     D.OMNIDIRECTIONAL, (1.7, -0.3, 0.1, 0.001, -0.002)),
    "basalt, pinhole": (basalt("pinhole", {}), D.NONE, ()),
    "basalt, radtan8": (
        basalt("pinhole-radtan8", {**RADTAN, "k3": 0.01, "k4": 0.2, "k5": 0.02, "k6": 0.002, "rpmax": 2.7}),
        D.RADIAL_TANGENTIAL, (-0.3, 0.1, 0.001, -0.002, 0.01, 0.2, 0.02, 0.002)),
    "basalt, kb4": (basalt("kb4", dict(zip(("k1", "k2", "k3", "k4"), K4, strict=True))), D.EQUIDISTANT, K4),
    "basalt, ds": (basalt("ds", {"xi": -0.2, "alpha": 0.6}), D.DOUBLE_SPHERE, (-0.2, 0.6)),
    "basalt, eucm": (basalt("eucm", {"alpha": 0.6, "beta": 1.1}), D.EXTENDED_UNIFIED, (0.6, 1.1)),
    "basalt, ucm": (basalt("ucm", {"alpha": 0.6}), D.EXTENDED_UNIFIED, (0.6, 1.0)),
    "basalt, fov": (basalt("fov", {"w": 0.9}), D.FIELD_OF_VIEW, (0.9,)),
    "nerfstudio": (nerfstudio(camera_model="OPENCV", **RADTAN), D.RADIAL_TANGENTIAL, (-0.3, 0.1, 0.001, -0.002)),
    "nerfstudio, fisheye": (nerfstudio(camera_model="OPENCV_FISHEYE", **dict(zip(("k1", "k2", "k3", "k4"), K4,
                                                                                strict=True))), D.EQUIDISTANT, K4),
    "nerfstudio, pinhole": (nerfstudio(camera_model="PINHOLE", k1=0.0), D.NONE, ()),
    "OpenVSLAM": (stella("perspective", "Camera.k1: -0.3\nCamera.k2: 0.1\nCamera.p1: 0.001\nCamera.p2: -0.002\n"
                         "Camera.k3: 0.01\n"), D.RADIAL_TANGENTIAL, (-0.3, 0.1, 0.001, -0.002, 0.01)),
    "OpenVSLAM, fisheye": (stella("fisheye", FISHEYE), D.EQUIDISTANT, K4),
    "stella_vslam in groups": (
        "Camera:\n" + stella("fisheye", FISHEYE).replace("Camera.", "  ") + "Mapping:\n  baseline_dist_thr: 0.1\n",
        D.EQUIDISTANT, K4),
    "EuRoC": (kalibr("pinhole", [400, 401, 360, 240], "radial-tangential", [-0.3, 0.1, 0.001, -0.002])
              .replace("\n  ", "\n").strip().replace("distortion_coeffs", "distortion_coefficients"),
              D.RADIAL_TANGENTIAL, (-0.3, 0.1, 0.001, -0.002)),
}  # fmt: skip


@pytest.mark.parametrize("name", ONE_CAMERA)
def test_the_camera_that_a_file_names(tmp_path: Path, name: str) -> None:
    text, distortion, coefficients = ONE_CAMERA[name]
    left = read(tmp_path, text).left
    assert (left.fx, left.fy, left.cx, left.cy, left.size) == (400.0, 401.0, 360.0, 240.0, (752, 480))
    assert (left.distortion, left.coefficients) == (distortion, coefficients)


SIDE = (
    "image_width: 752\nimage_height: 480\ncamera_name: {name}\n"
    + "camera_matrix:\n  rows: 3\n  cols: 3\n  data: [400.0, 0., 360.0, 0., 401.0, 240.0, 0., 0., 1.]\n"
    + "distortion_model: plumb_bob\ndistortion_coefficients:\n  rows: 1\n  cols: 5\n  data: [-0.3, 0.1, 0., 0., 0.]\n"
)
POSE = opencv_matrix("rotation_matrix", T_RIGHT_LEFT[:3, :3]) + opencv_matrix(
    "translation_matrix", T_RIGHT_LEFT[:3, 3:]
)
K = np.array([[400.0, 0, 360.0], [0, 401.0, 240.0], [0, 0, 1]])
INTRINSICS = "%YAML:1.0\n---\n" + "".join(
    opencv_matrix(key, value)
    for key, value in (("M1", K), ("D1", np.zeros((1, 5))), ("M2", K), ("D2", np.zeros((1, 5))))
)
EXTRINSICS = (
    "%YAML:1.0\n---\n" + opencv_matrix("R", T_RIGHT_LEFT[:3, :3]) + opencv_matrix("T", T_RIGHT_LEFT[:3, 3:])
    + opencv_matrix("R1", np.eye(3)) + opencv_matrix("Q", np.eye(4))
)  # fmt: skip
VINS_FILE = vins("PINHOLE", MIDDLE, RADTAN)
SENSOR = "%YAML:1.0\nsensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: {T}\nresolution: [752, 480]\n" + (
    "camera_model: pinhole\nintrinsics: [400, 401, 360, 240]\ndistortion_model: radial-tangential\n"
    "distortion_coefficients: [-0.3, 0.1, 0.001, -0.002]\n"
)
PAIRS = {
    "Kalibr, chain": {"camchain.yaml": kalibr_pair("", rows("T_cn_cnm1", T_RIGHT_LEFT))},
    "Kalibr, T_cam_imu only": {
        "camchain-imucam.yaml": kalibr_pair(
            rows("T_cam_imu", se3_inverse(T_BODY_LEFT)), rows("T_cam_imu", se3_inverse(T_BODY_RIGHT))
        )
    },
    "basalt": {"calibration.json": basalt("ds", {"xi": -0.2, "alpha": 0.6})},
    "ORB-SLAM3, two fisheyes": {
        "TUM.yaml": orb("Camera1", "Camera2") + opencv_matrix("Stereo.T_c1_c2", T_LEFT_RIGHT)
    },
    "ORB-SLAM3, Tlr": {
        "TUM.yaml": orb("Camera", "Camera2") + "Camera.bf: 44\n" + opencv_matrix("Tlr", T_LEFT_RIGHT[:3])
    },
    "RTAB-Map": {
        "zed_left.yaml": SIDE.format(name="zed_left"),
        "zed_right.yaml": SIDE.format(name="zed_right"),
        "zed_pose.yaml": "%YAML:1.0\n---\ncamera_name: zed\n" + POSE,
    },
    "OpenCV, two files": {"intrinsics.yml": INTRINSICS, "extrinsics.yml": EXTRINSICS},
    "OpenCV, one file": {"stereo.yaml": INTRINSICS + EXTRINSICS.replace("%YAML:1.0\n---\n", "")},
    "VINS-Fusion": {
        "euroc_stereo_config.yaml": "%YAML:1.0\nnum_of_cam: 2\ncam0_calib: \"cam0.yaml\"\ncam1_calib: \"cam1.yaml\"\n"
        + opencv_matrix("body_T_cam0", T_BODY_LEFT) + opencv_matrix("body_T_cam1", T_BODY_RIGHT),
        "cam0.yaml": VINS_FILE,
        "cam1.yaml": VINS_FILE,
    },
    "Kimera": {
        "LeftCameraParams.yaml": SENSOR.format(T=numbers(T_BODY_LEFT)),
        "RightCameraParams.yaml": SENSOR.format(T=numbers(T_BODY_RIGHT)),
    },
}  # fmt: skip


@pytest.mark.parametrize("name", PAIRS)
def test_the_pair_that_files_name(tmp_path: Path, name: str) -> None:
    rig = put(tmp_path, PAIRS[name])
    assert rig.right is not None and not rig.rectified and rig.T_left_right is not None
    assert rig.left == rig.right and rig.left.fx == 400.0
    np.testing.assert_allclose(rig.T_left_right, T_LEFT_RIGHT, atol=1e-9)


def test_opencvs_own_files_are_read(tmp_path: Path) -> None:
    """As its stereo_calib example writes them: no size in them."""
    for name, values in (
        ("intrinsics.yml", {"M1": K, "D1": np.full((1, 5), 0.01), "M2": K, "D2": np.full((1, 5), 0.02)}),
        ("extrinsics.yml", {"R": np.eye(3), "T": np.array([[-0.54], [0.0], [0.0]]), "Q": np.eye(4)}),
    ):
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for key, value in values.items():
            storage.write(key, value)
        storage.release()
    found = find_camera_file(tmp_path)
    assert found is not None and found[0].right is not None and found[0].baseline_m == pytest.approx(0.54)
    assert found[0].left.size is None and found[0].right.coefficients == (0.02,) * 5


def test_opencvs_xml_is_read(tmp_path: Path) -> None:
    path = tmp_path / "out_camera_data.xml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in (("image_width", 752), ("image_height", 480), ("fisheye_model", 1)):
        storage.write(key, value)
    storage.write("calibration_time", "Mon 12:00")
    storage.write("camera_matrix", K)
    storage.write("distortion_coefficients", np.array(K4)[:, None])
    storage.release()
    found = find_camera_file(tmp_path)
    assert found is not None and found[1] == path
    assert found[0].left == RawCamera(400.0, 401.0, 360.0, 240.0, (752, 480), D.EQUIDISTANT, K4)
    path.write_text('<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>')
    with pytest.raises(FrontendError, match="declarations inside XML are not read"):
        read_calibration(path)
    path.write_text('<?xml version="1.0"?><a>')
    with pytest.raises(FrontendError, match="not XML: no element found"):
        read_calibration(path)


def test_stella_vslams_rectifier(tmp_path: Path) -> None:
    turn = so3_exp([0.0, 0.05, 0.0])
    text = stella("perspective", "", "Camera.focal_x_baseline: 44.0\nStereoRectifier.model: fisheye\n")
    for side, R in (("left", np.eye(3)), ("right", turn)):
        text += f"StereoRectifier.K_{side}: {numbers(K)}\nStereoRectifier.D_{side}: {list(K4)}\n"
        text += f"StereoRectifier.R_{side}: {numbers(R)}\n"
    rig = read(tmp_path, text.replace("monocular", "stereo"))
    assert rig.right is not None and rig.left.distortion is D.EQUIDISTANT and rig.T_left_right is not None
    np.testing.assert_allclose(rig.T_left_right, se3(turn, [0.11, 0.0, 0.0]), atol=1e-12)
    flat = read(tmp_path, stella("perspective", "", "Camera.focal_x_baseline: 44.0\n").replace("monocular", "stereo"))
    assert flat.rectified and flat.baseline_m == pytest.approx(0.11)


def test_a_rectified_pair_of_orb_slam_is_of_undistorted_cameras(tmp_path: Path) -> None:
    text = "".join(f"Camera.{key}: {value}\n" for key, value in MIDDLE.items())
    assert read(tmp_path, text + "Camera.bf: 44.0\n").baseline_m == pytest.approx(0.11)
    for lens in ("Camera.k1: -0.3\n", 'Camera.type: "KannalaBrandt8"\n' + FISHEYE):
        for baseline in ("Camera.bf: 44.0\n", "Stereo.b: 0.11\n"):
            rig = read(tmp_path, text + lens + baseline)
            assert rig.right is None and "needs rectified images" in rig.contradiction


def test_nerfstudios_frames_may_hold_the_camera(tmp_path: Path) -> None:
    own = {"fl_x": 400, "fl_y": 401, "cx": 360.5, "cy": 240.5, "w": 752, "h": 480}
    text = json.dumps({"camera_model": "OPENCV", "frames": [{"file_path": "a", **own}, {"file_path": "b", **own}]})
    assert read(tmp_path, text, "transforms.json").left == RawCamera(400.0, 401.0, 360.0, 240.0, (752, 480))
    with pytest.raises(FrontendError, match="frames are of several cameras"):
        read(tmp_path, text.replace('"fl_x": 400', '"fl_x": 390', 1), "transforms.json")


def test_an_angle_of_view_is_a_focal_length(tmp_path: Path) -> None:
    text = json.dumps({"camera_angle_x": np.pi / 2, "w": 752, "h": 480, "frames": []})
    left = read(tmp_path, text, "transforms.json").left
    assert (left.fx, left.fy, left.cx, left.cy) == pytest.approx((376.0, 376.0, 375.5, 239.5))
