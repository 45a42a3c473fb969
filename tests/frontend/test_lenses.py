"""Lenses against their authors' formulas, OpenCV's omnidirectional module and COLMAP, one camera and a pair."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from lens_formulas import FORMULAS
from numpy.typing import NDArray

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.calibration import Distortion, RawCamera, RawRig
from maslam.frontend.cameras.lens import project, unproject
from maslam.frontend.cameras.models import RigKind
from maslam.frontend.cameras.rectification import Maps, common_camera, rectify_rig

SIZE = (256, 192)
WIDE = {
    "equidistant, 230 degrees": RawCamera(64.0, 65.0, 127.0, 96.0, SIZE, Distortion.EQUIDISTANT, (-0.02, 0, 0, 0)),
    "equidistant without coefficients": RawCamera(70.0, 70.0, 127.0, 96.0, SIZE, Distortion.EQUIDISTANT, (0,) * 4),
    "double sphere": RawCamera(78.0, 79.0, 128.0, 95.0, SIZE, Distortion.DOUBLE_SPHERE, (-0.18, 0.59)),
    "double sphere, xi above 0": RawCamera(90.0, 90.0, 128.0, 95.0, SIZE, Distortion.DOUBLE_SPHERE, (0.25, 0.4)),
    "extended unified": RawCamera(80.0, 81.0, 126.0, 97.0, SIZE, Distortion.EXTENDED_UNIFIED, (0.63, 1.05)),
    "unified": RawCamera(100.0, 99.0, 126.0, 97.0, SIZE, Distortion.EXTENDED_UNIFIED, (0.4, 1.0)),
    "mirror": RawCamera(230.0, 231.0, 127.0, 96.0, SIZE, Distortion.OMNIDIRECTIONAL, (1.7, -0.2, 0.1, 0.001, -0.0005)),
    "sphere below 1": RawCamera(
        150.0, 151.0, 127.0, 96.0, SIZE, Distortion.OMNIDIRECTIONAL, (0.7, -0.1, 0.01, 0.001, -0.0005)
    ),
    "field of view": RawCamera(130.0, 131.0, 127.0, 96.0, SIZE, Distortion.FIELD_OF_VIEW, (0.93,)),
}


def by_formula(camera: RawCamera, rays: NDArray[np.float64]) -> NDArray[np.float64]:
    flat = FORMULAS[camera.distortion.value](rays, *camera.coefficients)
    return flat * [camera.fx, camera.fy] + [camera.cx, camera.cy]


def cone(degrees: float, count: int = 500) -> NDArray[np.float64]:
    """Directions within ``degrees`` of the axis, of lengths between 0.5 and 5."""
    rng = np.random.default_rng(11)
    angle, turn = rng.uniform(0.01, np.radians(degrees), count), rng.uniform(0, 2 * np.pi, count)
    unit = np.stack([np.sin(angle) * np.cos(turn), np.sin(angle) * np.sin(turn), np.cos(angle)], 1)
    return unit * rng.uniform(0.5, 5.0, (count, 1))


@pytest.mark.parametrize("name", WIDE)
def test_directions_fall_where_the_authors_formula_says_and_come_back(name: str) -> None:
    camera = WIDE[name]
    rays = cone(85.0)
    pixels = project(camera, rays)
    np.testing.assert_allclose(pixels, by_formula(camera, rays), atol=1e-9)
    unit = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    near = np.arccos(unit[:, 2]) < np.radians(75.0)  # the mirror's inverse distortion is iterated: not at its rim
    np.testing.assert_allclose(unproject(camera, pixels)[near], unit[near], atol=1e-6)
    axis = project(camera, np.array([[0.0, 0.0, 2.0]]))
    np.testing.assert_allclose(axis, [[camera.cx, camera.cy]], atol=1e-12)


def test_a_mirror_is_opencvs() -> None:
    camera, rays, still = WIDE["mirror"], cone(100.0), np.zeros(3)
    k = np.array(camera.coefficients)
    expected, _ = cv2.omnidir.projectPoints(rays[:, None], still, still, camera.K, float(k[0]), k[1:])
    np.testing.assert_allclose(project(camera, rays), expected[:, 0], atol=1e-6)


@pytest.mark.parametrize("name", ["double sphere", "extended unified", "mirror", "sphere below 1"])
def test_what_a_lens_has_no_place_for_is_no_pixel(name: str) -> None:
    """Straight behind, two directions would share a pixel."""
    assert np.isnan(project(WIDE[name], np.array([[0.01, 0.02, -1.0]]))).all()


def test_directions_behind_a_wide_lens_are_seen() -> None:
    for name in ("equidistant, 230 degrees", "double sphere"):
        ray = np.array([[np.sin(1.8), 0.0, np.cos(1.8)]])  # 103 degrees off the axis
        np.testing.assert_allclose(unproject(WIDE[name], project(WIDE[name], ray)), ray, atol=1e-9)


def sources(maps: Maps, u: NDArray[np.int64], v: NDArray[np.int64]) -> NDArray[np.float64]:
    """Stored pixels that OpenCV's fixed-point maps take for rectified ones: 1/32 pixel."""
    whole, part = maps
    return whole[v, u] + np.stack([part[v, u] & 31, part[v, u] >> 5], axis=1) / 32.0


@pytest.mark.parametrize("name", WIDE)
def test_a_rectified_pixel_shows_the_direction_that_it_should(name: str) -> None:
    camera = WIDE[name]
    done = rectify_rig(RawRig(camera), RigKind.MONO, SIZE)
    assert done.rectifier is not None
    v, u = (c.ravel() for c in np.mgrid[0:192:11, 0:256:13])
    rays = np.stack([(u - done.camera.cx) / done.camera.fx, (v - done.camera.cy) / done.camera.fy, np.ones(len(u))], 1)
    expected = by_formula(camera, rays)
    assert np.abs(sources(done.rectifier.left, u, v) - expected).max() < 0.05
    assert expected.min() > -0.1 and (expected < np.array(SIZE) - 0.9).all(), "no empty corner"
    assert np.abs(expected - np.stack([u, v], axis=1)).max() > 5.0, "the lens is worth the test"


@pytest.mark.parametrize("name", ["equidistant, 230 degrees", "double sphere", "mirror"])
def test_a_very_wide_lens_keeps_63_degrees_on_each_side(name: str) -> None:
    """The border looks sideways or back and bounds nothing; beyond, a pinhole has hardly any pixels left."""
    done = rectify_rig(RawRig(WIDE[name]), RigKind.MONO, SIZE)
    assert (SIZE[0] - 1) / done.camera.fx == pytest.approx(4.0, abs=0.01)


def test_a_pair_of_unlike_wide_lenses_is_where_it_says() -> None:
    left, right = WIDE["double sphere"], WIDE["mirror"]
    T_left_right = se3(so3_exp([0.02, -0.03, 0.01]), [0.11, 0.004, -0.006])
    done = rectify_rig(RawRig(left, right, T_left_right, rectified=False), RigKind.STEREO, SIZE)
    assert done.rectifier is not None and done.rectifier.right is not None and done.baseline_m is not None
    v, u = (c.ravel() for c in np.mgrid[0:192:16, 48:256:16])
    for disparity in (4, 32):
        depth = done.camera.fx * done.baseline_m / disparity
        x, y = (u - done.camera.cx) / done.camera.fx * depth, (v - done.camera.cy) / done.camera.fy * depth
        points = np.stack([x, y, np.full(len(u), depth)], axis=1) @ done.R_rectified_left  # in the calibrated left one
        in_right = (points - T_left_right[:3, 3]) @ T_left_right[:3, :3]
        assert np.abs(sources(done.rectifier.left, u, v) - by_formula(left, points)).max() < 0.05
        assert np.abs(sources(done.rectifier.right, u - disparity, v) - by_formula(right, in_right)).max() < 0.05


def test_a_lens_without_effect_needs_no_rectifying() -> None:
    none = [
        (Distortion.DOUBLE_SPHERE, (0.0, 0.0)),
        (Distortion.EXTENDED_UNIFIED, (0.0, 1.3)),
        (Distortion.OMNIDIRECTIONAL, (0.0, 0.0, 0.0, 0.0, 0.0)),
        (Distortion.FIELD_OF_VIEW, (0.0,)),
    ]
    for distortion, coefficients in none:
        camera = RawCamera(130.0, 131.0, 127.0, 96.0, SIZE, distortion, coefficients)
        assert rectify_rig(RawRig(camera), RigKind.MONO, SIZE).rectifier is None
        flat = project(camera, cone(60.0))
        np.testing.assert_allclose(flat, project(RawCamera(130.0, 131.0, 127.0, 96.0, SIZE), cone(60.0)), atol=1e-12)


def test_the_widest_view_of_a_turned_camera_is_bounded_by_what_looks_ahead() -> None:
    turned = common_camera([(WIDE["field of view"], so3_exp([0.0, 0.6, 0.0]))], SIZE)
    straight = common_camera([(WIDE["field of view"], np.eye(3))], SIZE)
    assert turned.fx > straight.fx
