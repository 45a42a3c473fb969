"""Every calibration format to the end: the file is read, the camera rectified, and OpenCV's own camera model, given the
same numbers by hand, says where each undistorted pixel must come from."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.frontend.cameras.calibration import RawRig
from maslam.frontend.cameras.calibration_files import read_calibration
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.cameras.rectification import rectify_rig

SIZE = (640, 480)
K = np.array([[400.0, 0, 315.5], [0, 402.0, 238.25], [0, 0, 1]])
RADTAN = [-0.28, 0.07, 0.0012, -0.0007, 0.01]
RATIONAL = [0.3, -0.1, 0.0011, -0.0006, 0.02, 0.55, -0.12, 0.03]
FISHEYE = [-0.02, 0.008, -0.006, 0.0011]
MATRIX = "[400.0, 0.0, 315.5, 0.0, 402.0, 238.25, 0.0, 0.0, 1.0]"


def opencv(coefficients: list[float], model: str = "") -> str:
    named = f'distortion_model: "{model}"\n' if model else ""
    return (
        "%YAML:1.0\n---\nimage_width: 640\nimage_height: 480\n" + named + "camera_matrix: !!opencv-matrix\n   rows: 3\n"
        f"   cols: 3\n   dt: d\n   data: {MATRIX}\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n"
        f"   cols: {len(coefficients)}\n   dt: d\n   data: {coefficients}\n"
    )


def ros(coefficients: list[float], model: str) -> str:
    return (
        "image_width: 640\nimage_height: 480\ncamera_name: head\n"
        f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: {MATRIX}\n"
        f"distortion_model: {model}\ndistortion_coefficients:\n  rows: 1\n  cols: {len(coefficients)}\n"
        f"  data: {coefficients}\n"
    )


def message(coefficients: list[float], model: str) -> str:
    return f"height: 480\nwidth: 640\ndistortion_model: {model}\nD: {coefficients}\nK: {MATRIX}\n"


def kalibr(coefficients: list[float], model: str) -> str:
    return (
        "cam0:\n  camera_model: pinhole\n  intrinsics: [400.0, 402.0, 315.5, 238.25]\n"
        f"  distortion_model: {model}\n  distortion_coeffs: {coefficients}\n  resolution: [640, 480]\n"
    )


def orb_slam(coefficients: list[float], names: str, camera: str, kind: str = "") -> str:
    lines = [f"{camera}.{n}: {v}" for n, v in zip(("fx", "fy", "cx", "cy"), (400.0, 402.0, 315.5, 238.25), strict=True)]
    lines += [f"{camera}.{n}: {v}" for n, v in zip(names.split(), coefficients, strict=True)]
    typed = [f'Camera.type: "{kind}"'] if kind else []
    return "\n".join(["%YAML:1.0", *typed, *lines, "Camera.width: 640", "Camera.height: 480", "Camera.fps: 20.0", ""])


FILES = {
    "opencv": (opencv(RADTAN), RADTAN),
    "opencv, rational": (opencv(RATIONAL), RATIONAL),
    "opencv, fisheye": (opencv(FISHEYE, "fisheye"), None),
    "ros": (ros(RADTAN, "plumb_bob"), RADTAN),
    "ros, rational": (ros(RATIONAL, "rational_polynomial"), RATIONAL),
    "ros, equidistant": (ros(FISHEYE, "equidistant"), None),
    "ros message": (message(RADTAN, "plumb_bob"), RADTAN),
    "kalibr": (kalibr(RADTAN[:4], "radtan"), RADTAN[:4]),
    "kalibr, equidistant": (kalibr(FISHEYE, "equidistant"), None),
    "orb-slam2": (orb_slam(RADTAN, "k1 k2 p1 p2 k3", "Camera"), RADTAN),
    "orb-slam3": (orb_slam(RADTAN[:4], "k1 k2 p1 p2", "Camera1", "PinHole"), RADTAN[:4]),
    "orb-slam3, fisheye": (orb_slam(FISHEYE, "k1 k2 k3 k4", "Camera1", "KannalaBrandt8"), None),
}


def read(tmp_path: Path, text: str) -> RawRig:
    (tmp_path / "camera.yaml").write_text(text)
    return read_calibration(tmp_path / "camera.yaml")


def project(rays: NDArray[np.float64], radtan: list[float] | None) -> NDArray[np.float64]:
    """Stored pixels ``(n, 2)`` of directions, by OpenCV; None: its fisheye model."""
    still = np.zeros(3)
    if radtan is None:
        return cv2.fisheye.projectPoints(rays[:, None], still, still, K, np.array(FISHEYE))[0][:, 0]
    return cv2.projectPoints(rays, still, still, K, np.array(radtan))[0][:, 0]


@pytest.mark.parametrize("name", FILES)
def test_each_undistorted_pixel_comes_from_where_opencv_sees_its_ray(tmp_path: Path, name: str) -> None:
    text, radtan = FILES[name]
    done = rectify_rig(read(tmp_path, text), RigKind.MONO, SIZE)
    assert done.rectifier is not None
    v, u = (c.ravel() for c in np.mgrid[0:480:37, 0:640:41])
    rays = np.stack([(u - done.camera.cx) / done.camera.fx, (v - done.camera.cy) / done.camera.fy, np.ones(len(u))], 1)
    whole, part = done.rectifier.left  # OpenCV's fixed-point maps: 1/32 pixel
    source = whole[v, u] + np.stack([part[v, u] & 31, part[v, u] >> 5], axis=1) / 32.0
    expected = project(rays, radtan)
    assert np.abs(source - expected).max() < 0.05
    assert np.abs(expected - np.stack([u, v], axis=1)).max() > 10.0, "the distortion is worth the test"


def test_a_file_without_distortion_needs_no_rectifying(tmp_path: Path) -> None:
    for text in (opencv([0.0] * 5), kalibr([0.0] * 4, "radtan"), orb_slam([], "", "Camera1", "Rectified")):
        done = rectify_rig(read(tmp_path, text), RigKind.MONO, SIZE)
        assert done.rectifier is None and (done.camera.fx, done.camera.cy) == (400.0, 238.25)
