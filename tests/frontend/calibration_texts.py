"""Calibration files as text, written by the formats' own documents."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from maslam.backend.geometry import se3, se3_inverse, so3_exp
from maslam.frontend.cameras.calibration import RawRig
from maslam.frontend.cameras.calibration_files import read_calibration

T_LEFT_RIGHT = se3(so3_exp([0.02, -0.01, 0.03]), [0.11, 0.002, -0.004])
T_BODY_LEFT = se3(so3_exp([0.5, -0.2, 1.1]), [0.04, -0.06, 0.01])
T_BODY_RIGHT = T_BODY_LEFT @ T_LEFT_RIGHT
T_RIGHT_LEFT = se3_inverse(T_LEFT_RIGHT)
IDENTITY = "[1, 0, 0, 0, 1, 0, 0, 0, 1]"


def numbers(matrix: np.ndarray) -> str:
    return "[" + ", ".join(repr(float(v)) for v in np.asarray(matrix).ravel()) + "]"


def opencv_matrix(key: str, matrix: np.ndarray) -> str:
    rows, cols = matrix.shape
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: {numbers(matrix)}\n"


def read(tmp_path: Path, text: str, name: str = "camera.yaml") -> RawRig:
    (tmp_path / name).write_text(text)
    return read_calibration(tmp_path / name)


def kalibr(model: str, intrinsics: list[float], distortion: str, coefficients: list[float], more: str = "") -> str:
    return (
        f"  camera_model: {model}\n  intrinsics: {intrinsics}\n  distortion_model: {distortion}\n"
        f"  distortion_coeffs: {coefficients}\n  resolution: [752, 480]\n{more}"
    )


def vins(
    model: str, projection: dict[str, float], bent: dict[str, float], mirror: dict[str, float] | None = None
) -> str:
    groups = {"mirror_parameters": mirror, "distortion_parameters": bent, "projection_parameters": projection}
    text = f"%YAML:1.0\n---\nmodel_type: {model}\ncamera_name: camera\nimage_width: 752\nimage_height: 480\n"
    for name, group in groups.items():
        if group:
            text += f"{name}:\n" + "".join(f"   {key}: {value}\n" for key, value in group.items())
    return text


MIDDLE = {"fx": 400.0, "fy": 401.0, "cx": 360.0, "cy": 240.0}
RADTAN = {"k1": -0.3, "k2": 0.1, "p1": 0.001, "p2": -0.002}


def basalt(kind: str, lens: dict[str, float]) -> str:
    def pose(T: np.ndarray) -> dict[str, float]:
        w = np.sqrt(1.0 + np.trace(T[:3, :3])) / 2.0
        x, y, z = (T[2, 1] - T[1, 2], T[0, 2] - T[2, 0], T[1, 0] - T[0, 1]) / (4.0 * w)
        px, py, pz = T[:3, 3]
        return {"px": px, "py": py, "pz": pz, "qx": x, "qy": y, "qz": z, "qw": w}

    camera = {"camera_type": kind, "intrinsics": {**MIDDLE, **lens}}
    value = {
        "T_imu_cam": [pose(T_BODY_LEFT), pose(T_BODY_RIGHT)],
        "intrinsics": [camera, camera],
        "resolution": [[752, 480], [752, 480]],
        "vignette": [],
    }
    return json.dumps({"value0": value})


def nerfstudio(**values: object) -> str:
    frames = [{"file_path": "images/0.png", "transform_matrix": np.eye(4).tolist()}]
    return json.dumps(
        {"w": 752, "h": 480, "fl_x": 400, "fl_y": 401, "cx": 360.5, "cy": 240.5, "frames": frames, **values}
    )


def stella(model: str, coefficients: str, more: str = "") -> str:
    return (
        f'Camera.name: "x"\nCamera.setup: "monocular"\nCamera.model: "{model}"\nCamera.fx: 400.0\nCamera.fy: 401.0\n'
        f"Camera.cx: 360.0\nCamera.cy: 240.0\n{coefficients}Camera.fps: 20\nCamera.cols: 752\nCamera.rows: 480\n{more}"
    )


FISHEYE = "Camera.k1: 0.05\nCamera.k2: -0.01\nCamera.k3: 0.004\nCamera.k4: -0.001\n"
K4 = (0.05, -0.01, 0.004, -0.001)
XI = {"xi": 1.7}
ECHO = (
    "header:\n  stamp:\n    sec: 12\n    nanosec: 0\n  frame_id: cam\nheight: 480\nwidth: 752\n"
    "distortion_model: {model}\n{D}: {d}\n{K}: [400.0, 0.0, 360.0, 0.0, 401.0, 240.0, 0.0, 0.0, 1.0]\n"
    "{R}: [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]\n"
    "{P}: [400.0, 0.0, 360.0, 0.0, 0.0, 401.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]\n"
    "binning_x: 0\nbinning_y: 0\nroi:\n  x_offset: 0\n  y_offset: 0\n  height: 0\n  width: 0\n  do_rectify: false\n"
    "---\nheader:\n  stamp: {{sec: 13}}\n---\n"
)
UPPER, LOWER = {key: key for key in "DKRP"}, {key: key.lower() for key in "DKRP"}
OPENCV = (
    "%YAML:1.0\n---\nimage_width: 752\nimage_height: 480\n{more}"
    + opencv_matrix("camera_matrix", np.array([[400.0, 0, 360.0], [0, 401.0, 240.0], [0, 0, 1]]))
    + "distortion_coefficients: !!opencv-matrix\n   rows: 4\n   cols: 1\n   dt: d\n"
    + "   data: [0.05, -0.01, 0.004, -0.001]\n"
)


def kalibr_pair(first: str, second: str) -> str:
    one = kalibr("pinhole", [400, 401, 360, 240], "radtan", [-0.3, 0.1, 0.001, -0.002])
    return f"cam0:\n{one}{first}cam1:\n{one}{second}"


def rows(key: str, T: np.ndarray) -> str:
    return f"  {key}:\n" + "".join(f"  - {numbers(row)}\n" for row in T)


def orb(*keys: str) -> str:
    one = "{c}.fx: 400.0\n{c}.fy: 401.0\n{c}.cx: 360.0\n{c}.cy: 240.0\n" + FISHEYE.replace("Camera", "{c}")
    return "%YAML:1.0\n" + 'Camera.type: "KannalaBrandt8"\n' + "".join(one.format(c=key) for key in keys)
