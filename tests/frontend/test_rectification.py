"""Rectification against images painted by formula: a raw pixel's colour is a function of the ray it looks along."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from dataset_makers import make_scene, write_euroc, write_kitti
from numpy.typing import NDArray

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.calibration import Distortion, RawCamera, RawRig
from maslam.frontend.cameras.models import PinholeCamera, RigKind
from maslam.frontend.cameras.rectification import rectify_rig, stereo_rotations
from maslam.frontend.datasets import open_dataset

SIZE = (188, 120)
LEFT = RawCamera(114.7, 114.3, 91.8, 62.1, SIZE, Distortion.RADIAL_TANGENTIAL, (-0.283, 0.074, 0.0002, 1.8e-5))
RIGHT = RawCamera(114.4, 114.0, 95.0, 63.8, SIZE, Distortion.RADIAL_TANGENTIAL, (-0.284, 0.0745, -0.0001, -3.6e-5))
FISHEYE = RawCamera(95.0, 95.0, 93.0, 60.0, SIZE, Distortion.EQUIDISTANT, (-0.01, 0.004, -0.003, 0.0005))
IDEAL = RawCamera(114.7, 114.3, 91.8, 62.1, SIZE)
T_LEFT_RIGHT = se3(so3_exp([0.01, -0.02, 0.015]), [0.11, 0.002, -0.003])
WALL_M = 3.0  # distance of a wall across the left camera's optical axis


def rays(camera: RawCamera) -> NDArray[np.float64]:
    """Directions ``(H, W, 3)`` with z = 1 of all pixels, by inverting the distortion with fixed-point iterations
    written here."""
    u, v = np.meshgrid(np.arange(SIZE[0], dtype=float), np.arange(SIZE[1], dtype=float))
    xd, yd = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    x, y = xd.copy(), yd.copy()
    for _ in range(200):
        fx, fy = distort(camera, x, y)
        x, y = x + 0.7 * (xd - fx), y + 0.7 * (yd - fy)
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def distort(camera: RawCamera, x: NDArray, y: NDArray) -> tuple[NDArray, NDArray]:
    if camera.distortion is Distortion.EQUIDISTANT:
        r = np.sqrt(x * x + y * y)
        t = np.arctan(r)
        k1, k2, k3, k4 = camera.coefficients
        scale = t * (1 + k1 * t**2 + k2 * t**4 + k3 * t**6 + k4 * t**8) / np.where(r > 1e-12, r, 1.0)
        scale = np.where(r > 1e-12, scale, 1.0)
        return x * scale, y * scale
    k1, k2, p1, p2 = camera.coefficients or (0.0, 0.0, 0.0, 0.0)
    r2 = x * x + y * y
    radial = 1 + k1 * r2 + k2 * r2 * r2
    return x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y


def paint(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Grey levels of points on the wall, slow waves: linear interpolation hardly errs."""
    x, y = points[..., 0], points[..., 1]
    return 127.5 + 60 * np.sin(2.2 * x + 0.3) * np.cos(2.5 * y) + 50 * np.sin(1.7 * y - 0.9 * x)


def on_wall(origin: NDArray[np.float64], directions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where rays hit the plane z = WALL_M of the left camera's frame."""
    return origin + directions * ((WALL_M - origin[2]) / directions[..., 2])[..., None]


def photograph(camera: RawCamera, T_left_camera: NDArray[np.float64]) -> NDArray[np.uint8]:
    directions = rays(camera) @ T_left_camera[:3, :3].T
    return np.rint(paint(on_wall(T_left_camera[:3, 3], directions))).astype(np.uint8)


def ideal_rays(camera: PinholeCamera) -> NDArray[np.float64]:
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=-1)


@pytest.mark.parametrize("camera", [LEFT, FISHEYE])
def test_one_camera(camera: RawCamera) -> None:
    done = rectify_rig(RawRig(camera), RigKind.MONO, SIZE)
    assert done.rectifier is not None and done.baseline_m is None
    image = done.rectifier.rectify_left(photograph(camera, np.eye(4)))
    expected = paint(on_wall(np.zeros(3), ideal_rays(done.camera)))
    assert np.abs(image - expected).max() < 2.5
    assert done.camera.fx == done.camera.fy and (done.camera.width, done.camera.height) == SIZE


def test_a_stereo_pair_is_where_it_says() -> None:
    done = rectify_rig(RawRig(LEFT, RIGHT, T_LEFT_RIGHT, rectified=False), RigKind.STEREO, SIZE)
    assert done.rectifier is not None and done.baseline_m is not None
    assert done.baseline_m == pytest.approx(np.linalg.norm(T_LEFT_RIGHT[:3, 3]))
    image = done.rectifier.rectify_left(photograph(LEFT, np.eye(4)))
    right = done.rectifier.rectify_right(photograph(RIGHT, T_LEFT_RIGHT))
    assert right is not None
    turned = ideal_rays(done.camera) @ done.R_rectified_left  # rectified rays in the calibrated left camera's frame
    right_centre = done.R_rectified_left.T @ [done.baseline_m, 0, 0]
    np.testing.assert_allclose(right_centre, T_LEFT_RIGHT[:3, 3], atol=1e-12)
    assert np.abs(image - paint(on_wall(np.zeros(3), turned))).max() < 2.5
    assert np.abs(right - paint(on_wall(right_centre, turned))).max() < 2.5


def test_rotations_are_opencvs() -> None:
    T_right_left = np.linalg.inv(T_LEFT_RIGHT)
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        LEFT.K,
        np.array(LEFT.coefficients),
        RIGHT.K,
        np.array(RIGHT.coefficients),
        SIZE,
        T_right_left[:3, :3].copy(),
        T_right_left[:3, 3:].copy(),
        alpha=0,
    )
    R_left, R_right, baseline = stereo_rotations(T_LEFT_RIGHT)
    np.testing.assert_allclose(R_left, R1, atol=1e-9)
    np.testing.assert_allclose(R_right, R2, atol=1e-9)
    assert baseline == pytest.approx(-P2[0, 3] / P2[0, 0])
    # OpenCV's own choice of the common camera (alpha = 0: no empty pixels) is about as wide.
    done = rectify_rig(RawRig(LEFT, RIGHT, T_LEFT_RIGHT, rectified=False), RigKind.STEREO, SIZE)
    assert done.camera.fx == pytest.approx(P1[0, 0], rel=0.03)


@pytest.mark.parametrize("raw", [RawRig(LEFT), RawRig(FISHEYE)])
def test_no_empty_corner_and_no_more_cropping_than_needed(raw: RawRig) -> None:
    done = rectify_rig(raw, RigKind.MONO, SIZE)
    x, y = ideal_rays(done.camera)[..., 0], ideal_rays(done.camera)[..., 1]
    xd, yd = distort(raw.left, x, y)
    u, v = raw.left.fx * xd + raw.left.cx, raw.left.fy * yd + raw.left.cy
    margins = np.array([u.min(), v.min(), SIZE[0] - 1 - u.max(), SIZE[1] - 1 - v.max()])
    assert margins.min() > -0.1
    assert min(margins[0], margins[2]) < 1.0 or min(margins[1], margins[3]) < 1.0


def test_depth_takes_the_nearest_stored_pixel() -> None:
    done = rectify_rig(RawRig(LEFT), RigKind.RGBD, SIZE)
    assert done.rectifier is not None
    stored = np.where(np.arange(SIZE[0]) < 90, 1.0, 5.0)[None].repeat(SIZE[1], axis=0).astype(np.float32)
    depth = done.rectifier.rectify_depth(stored)
    assert depth is not None and set(np.unique(depth)) == {1.0, 5.0}
    x, y = ideal_rays(done.camera)[..., 0], ideal_rays(done.camera)[..., 1]
    u = LEFT.fx * distort(LEFT, x, y)[0] + LEFT.cx
    sure = np.abs(u - 89.5) > 0.01
    np.testing.assert_array_equal(depth[sure], np.where(u < 89.5, 1.0, 5.0)[sure])


def test_an_ideal_camera_is_left_alone() -> None:
    done = rectify_rig(RawRig(IDEAL), RigKind.MONO, SIZE)
    assert done.rectifier is None and (done.camera.fx, done.camera.fy) == (114.7, 114.3)


def test_a_sequence_knows_the_camera_of_its_files_where_they_are_not_rectified(tmp_path: Path) -> None:
    scene = make_scene()
    write_euroc(tmp_path / "raw", scene)
    write_kitti(tmp_path / "ideal", scene)
    raw, ideal = (open_dataset(tmp_path / name).sequences[0] for name in ("raw", "ideal"))
    assert raw.rectifier is not None and raw.stored_camera is not None and raw.R_rectified_left is not None
    np.testing.assert_allclose(raw.R_rectified_left @ raw.R_rectified_left.T, np.eye(3), atol=1e-9)
    assert ideal.rectifier is None and ideal.stored_camera is None and ideal.R_rectified_left is None
