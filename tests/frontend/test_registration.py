"""Depth moved from its own camera to the image's, against rays cut with known surfaces by each camera for itself."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.depth_registration import DepthRegistration
from maslam.frontend.cameras.models import PinholeCamera

Array = NDArray[np.float64]
DEPTH = PinholeCamera(160, 120, 146.0, 146.0, 80.0, 60.0)
COLOUR = PinholeCamera(160, 120, 131.0, 131.0, 79.0, 61.0)
BESIDE = se3(np.eye(3), [0.025, 0.0, 0.0])
TURNED = se3(so3_exp(np.array([0.02, -0.03, 0.04])), [0.03, -0.01, 0.02])

WALL = (np.array([0.0, 0.0, 1.0]), 3.0)
SLANTED = (np.array([0.75, -0.2, 0.63]), 1.6)
STEEP = (np.array([0.93, 0.05, 0.36]), 1.0)


def rays(camera: PinholeCamera) -> Array:
    """``(H, W, 3)``, z = 1."""
    v, u = np.mgrid[: camera.height, : camera.width]
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(u.shape)], axis=2)


def seen(camera: PinholeCamera, T_D_X: Array, planes: list[tuple[Array, float]], box: bool = False) -> Array:
    """Depth ``(H, W)`` that ``camera`` at ``T_D_X`` sees: planes ``n . p = d`` of the depth camera's frame, and with
    ``box`` a square of 0.6 m, 1.2 m ahead. 0 where there is nothing within 0.3 to 20 m."""
    directions, origin = rays(camera) @ T_D_X[:3, :3].T, T_D_X[:3, 3]
    depth = np.full(directions.shape[:2], np.inf)
    for normal, distance in planes:
        with np.errstate(divide="ignore"):
            z = (distance - normal @ origin) / (directions @ normal)
        depth = np.where((z > 0.3) & (z < 20.0), np.minimum(depth, z), depth)
    if box:
        z = (1.2 - origin[2]) / directions[..., 2]
        hit = origin + z[..., None] * directions
        inside = (np.abs(hit[..., 0]) < 0.3) & (np.abs(hit[..., 1]) < 0.3)
        depth = np.where(inside, np.minimum(depth, z), depth)
    return np.where(np.isfinite(depth), depth, 0.0)


def pixel_in_depth(depth_C: Array, T_C_D: Array) -> tuple[Array, Array]:
    """Column and row at which the depth camera sees what the image's camera sees."""
    points = (rays(COLOUR) * depth_C[..., None] - T_C_D[:3, 3]) @ T_C_D[:3, :3]
    z = np.maximum(points[..., 2], 1e-9)
    return DEPTH.fx * points[..., 0] / z + DEPTH.cx, DEPTH.fy * points[..., 1] / z + DEPTH.cy


def measured_inside(depth_C: Array, T_C_D: Array, margin: float) -> NDArray[np.bool_]:
    u, v = pixel_in_depth(depth_C, T_C_D)
    inside = (u > margin) & (u < DEPTH.width - 1 - margin) & (v > margin) & (v < DEPTH.height - 1 - margin)
    return inside & (depth_C > 0)


@pytest.mark.parametrize("T_C_D", [BESIDE, TURNED], ids=["beside", "turned"])
@pytest.mark.parametrize("plane", [WALL, SLANTED, STEEP], ids=["wall", "slanted", "steep"])
def test_a_plane_has_its_own_depth_and_no_hole(plane: tuple[Array, float], T_C_D: Array) -> None:
    measured = seen(DEPTH, np.eye(4), [plane])
    expected = seen(COLOUR, np.linalg.inv(T_C_D), [plane])
    found = DepthRegistration(DEPTH, COLOUR, T_C_D).register(measured.astype(np.float32))
    slope = np.abs(np.gradient(expected)).sum(axis=0)
    # Where depth changes by more than 3 % a pixel, neighbours count as two surfaces.
    inside = measured_inside(expected, T_C_D, 1.0) & (slope < 0.025 * expected)
    assert inside.sum() > 4000 and (found[inside] > 0).all(), "a hole in a surface that was measured"
    outside = (expected > 0) & ~measured_inside(expected, T_C_D, -1.5)
    assert outside.any() and (found[outside] == 0).all(), "depth where nothing was measured"
    # The nearest measured pixel is up to one pixel off (half of one beside, half of one above).
    step = slope[inside]
    assert (np.abs(found[inside] - expected[inside]) <= 0.8 * step + 1e-5).all()
    # Unregistered, the same plane would be off by more than that wherever it slants.
    if plane is not WALL:
        assert np.mean(np.abs(measured[inside] - expected[inside])) > 3 * np.mean(np.abs(found - expected)[inside])


def test_a_box_hides_the_wall_and_its_shadow_stays_unknown() -> None:
    measured = seen(DEPTH, np.eye(4), [WALL], box=True)
    T_D_C = np.linalg.inv(BESIDE)
    expected = seen(COLOUR, T_D_C, [WALL], box=True)
    found = DepthRegistration(DEPTH, COLOUR, BESIDE).register(measured.astype(np.float32))
    on_box, on_wall = found == np.float32(1.2), found == np.float32(3.0)
    assert (on_box | on_wall | (found == 0)).all(), "a depth that no surface has"
    # The box lies where the image's camera sees it, to the pixel that the depth camera's own pixels leave open.
    for axis in (0, 1):
        line = found.shape[axis] // 2
        got = np.flatnonzero(on_box.take(line, axis)), np.flatnonzero(expected.take(line, axis) == 1.2)
        assert abs(got[0][0] - got[1][0]) <= 1 and abs(got[0][-1] - got[1][-1]) <= 1
    assert on_box[expected == 1.2].mean() > 0.95
    # The wall that only the image's camera sees, left of the box's left edge or right of its right one: unknown.
    row = COLOUR.height // 2
    columns = np.flatnonzero(expected[row] == 1.2)
    shadow_px = COLOUR.fx * 0.025 * (1 / 1.2 - 1 / 3.0)
    left = found[row, columns[0] - 5 : columns[0]]
    right = found[row, columns[-1] + 1 : columns[-1] + 6]
    assert shadow_px > 1.5
    # The image's camera stands on the left: points move right in its image, near ones farther than far ones.
    assert 1 <= np.sum(left == 0) <= np.ceil(shadow_px) + 1 and np.sum(right == 0) == 0


def test_unknown_depth_is_unknown_where_it_lands_and_edges_are_not_bridged() -> None:
    measured = seen(DEPTH, np.eye(4), [WALL]).astype(np.float32)
    measured[50:58, 70:79] = 0
    measured[30, 40] = 0
    found = DepthRegistration(DEPTH, COLOUR, BESIDE).register(measured)
    assert np.isfinite(found).all() and set(np.unique(found)) <= {np.float32(0.0), np.float32(3.0)}
    u, v = pixel_in_depth(np.full(found.shape, 3.0), BESIDE)
    in_hole = (u > 69.5) & (u < 78.5) & (v > 49.5) & (v < 57.5)
    assert in_hole.sum() > 40 and (found[in_hole] == 0).all()
    assert (DepthRegistration(DEPTH, COLOUR, BESIDE).register(np.zeros_like(measured)) == 0).all()


def test_one_camera_for_both_changes_nothing() -> None:
    rng = np.random.default_rng(3)
    measured = np.where(rng.random((120, 160)) < 0.2, 0, rng.uniform(0.4, 8.0, (120, 160))).astype(np.float32)
    found = DepthRegistration(DEPTH, DEPTH, np.eye(4)).register(measured)
    np.testing.assert_allclose(found, measured, rtol=1e-6)


def test_points_behind_the_image_camera_are_not_drawn() -> None:
    ahead = se3(np.eye(3), [0.0, 0.0, -2.0])
    found = DepthRegistration(DEPTH, COLOUR, ahead).register(np.full((120, 160), 1.5, np.float32))
    assert (found == 0).all()


def test_depth_of_another_size_is_refused() -> None:
    with pytest.raises(ValueError, match="100x120 pixels, its camera 160x120"):
        DepthRegistration(DEPTH, COLOUR, BESIDE).register(np.ones((120, 100), np.float32))
