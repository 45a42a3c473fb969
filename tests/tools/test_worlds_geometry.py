"""Pictures against closed-form geometry: depth, disparity, and intensities that agree between views."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.backend.geometry import se3, so3_exp
from maslam.frontend.cameras.models import PinholeCamera
from maslam.tools.worlds.rendering.light import Light, random_light
from maslam.tools.worlds.rendering.renderer import Renderer, View
from maslam.tools.worlds.rendering.sensor import SensorConfig, depth_map, develop
from maslam.tools.worlds.scene import textures
from maslam.tools.worlds.scene.mesh import MeshBuilder
from maslam.tools.worlds.scene.texture_atlas import AtlasBuilder
from maslam.tools.worlds.scene.world import FreeSpace, World
from maslam.tools.worlds.town.town import build_town

CAMERA = PinholeCamera(160, 120, 100.0, 104.0, 77.3, 61.9)
POSE = se3(so3_exp(np.array([0.1, -0.2, 0.05])), np.array([0.3, -0.4, -0.2]))


def _world(mesh: MeshBuilder, atlas: AtlasBuilder) -> World:
    return World("test", 0, mesh.build(), atlas.build(), FreeSpace(np.ones((1, 1), np.float32), (0.0, 0.0), 1.0))


@cache
def _room() -> tuple[World, Renderer]:
    """A textured wall z = 7 m, 40 m wide, and in front of it a cube of 1 m about (0.5, 0, 4)."""
    rng = np.random.default_rng(0)
    atlas, mesh = AtlasBuilder(), MeshBuilder()
    material = atlas.material(atlas.texture(textures.paving(rng, 8, 8, (150, 140, 130)), 3.0, 3.0))
    mesh.wall(np.array([-20.0, 7.0]), np.array([20.0, 7.0]), -20.0, 20.0, material)
    mesh.box(np.array([0.5, 0.0, 4.0]), np.eye(3), np.ones(3), material, open_bottom=False)
    world = _world(mesh, atlas)
    return world, Renderer(world)


def _ray(camera: PinholeCamera, u: float, v: float) -> NDArray[np.float64]:
    return np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0])


def test_depth_of_a_wall_and_a_cube_in_closed_form() -> None:
    view = _room()[1].render(POSE, CAMERA, Light())
    low, high = np.array([0.0, -0.5, 3.5]), np.array([1.0, 0.5, 4.5])
    cubes = 0
    for u in range(0, CAMERA.width, 7):
        for v in range(0, CAMERA.height, 7):
            d, o = POSE[:3, :3] @ _ray(CAMERA, u, v), POSE[:3, 3]
            expected = (7.0 - o[2]) / d[2]
            near, far = np.sort(np.stack([(low - o) / d, (high - o) / d]), axis=0)
            if near.max() < far.min():
                expected, cubes = near.max(), cubes + 1
            assert view.depth_m[v, u] == pytest.approx(expected, abs=2e-5)
    assert cubes > 10


def test_stereo_disparity_is_that_of_the_depth() -> None:
    """OpenCV's optical flow from the left to the right picture finds the disparity that follows from depth and
    baseline, unbiased."""
    pose, baseline = _street_pose(), 0.54
    right = pose.copy()
    right[:3, 3] += baseline * pose[:3, 0]
    camera, exposure = PinholeCamera(320, 240, 177.7, 177.7, 159.5, 119.5), Light().metered() * Light().exposure
    views = [Renderer(_town()).render(p, camera, Light()) for p in (pose, right)]
    images = [develop(v.radiance, SensorConfig(), exposure, np.random.default_rng(k)) for k, v in enumerate(views)]
    grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in images]
    corners = cv2.goodFeaturesToTrack(grey[0], 500, 0.01, 5).reshape(-1, 2)
    flow, status, _ = cv2.calcOpticalFlowPyrLK(*grey, corners, None, winSize=(13, 13), maxLevel=4)
    depth = views[0].depth_m[np.rint(corners[:, 1]).astype(int), np.rint(corners[:, 0]).astype(int)]
    true = 177.7 * baseline / np.maximum(depth, 1e-6)
    back, _, _ = cv2.calcOpticalFlowPyrLK(grey[1], grey[0], flow, None, winSize=(13, 13), maxLevel=4)
    known = (status.ravel() > 0) & (depth > 0) & (np.linalg.norm(back - corners, axis=1) < 0.5)
    error = (corners[:, 0] - flow[:, 0] - true)[known]
    rows = np.abs(corners[:, 1] - flow[:, 1])[known]
    assert known.sum() > 250
    tracked = error[np.abs(error) < 0.5]  # the others sit on edges, where the window sees two depths
    assert abs(tracked.mean()) < 0.05 and len(tracked) > 0.65 * known.sum()
    assert np.median(np.abs(error)) < 0.2 and np.median(rows) < 0.15


def _warp_residual(first: View, second: View, T_2_1: NDArray[np.float64], camera: PinholeCamera) -> NDArray[np.float64]:
    """Differences of display intensity between a view and another one seen through the first one's exact depth, where
    nothing hides."""
    images = [
        cv2.cvtColor(develop(v.radiance, SensorConfig.ideal(), 1.0, None), cv2.COLOR_RGB2GRAY).astype(np.float32)
        for v in (first, second)
    ]
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    z = first.depth_m
    points = (
        np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=-1) @ T_2_1[:3, :3].T
        + T_2_1[:3, 3]
    )
    depth = np.maximum(points[..., 2], 1e-3)
    u2 = (points[..., 0] / depth * camera.fx + camera.cx).astype(np.float32)
    v2 = (points[..., 1] / depth * camera.fy + camera.cy).astype(np.float32)
    warped = cv2.remap(images[1], u2, v2, cv2.INTER_CUBIC)
    there = cv2.remap(second.depth_m.astype(np.float32), u2, v2, cv2.INTER_NEAREST)
    inside = (u2 > 2) & (v2 > 2) & (u2 < camera.width - 3) & (v2 < camera.height - 3)
    visible = inside & (z > 0) & (np.abs(there - depth) < 0.02 * depth)
    return (warped - images[0])[visible]


@cache
def _town() -> World:
    return build_town(3, facade_count=24, ground_texel_m=0.1)[0]


def _street_pose() -> NDArray[np.float64]:
    from maslam.tools.worlds.town.streets import town_network

    line = town_network(np.random.default_rng([3, 1])).lines[20]
    k = len(line) // 3
    d = (line[k + 1] - line[k]) / np.linalg.norm(line[k + 1] - line[k])
    pose = np.eye(4)
    pose[:3, :3] = np.array([[d[1], 0, d[0]], [0, 1, 0], [-d[0], 0, d[1]]])
    at = line[k] + 1.6 * np.array([d[1], -d[0]])
    pose[:3, 3] = at[0], -1.65, at[1]
    return pose


def test_views_agree_through_depth() -> None:
    """One metre on and a little turned, the town looks the same to a few grey levels at 30 times that contrast:
    textures do not swim."""
    world = _town()
    renderer, camera = Renderer(world), PinholeCamera(480, 270, 262.0, 262.0, 239.5, 134.5)
    pose = _street_pose()
    moved = pose @ se3(so3_exp(np.array([0.004, 0.02, -0.006])), np.array([0.15, -0.02, 0.9]))
    views = [renderer.render(p, camera, Light()) for p in (pose, moved)]
    residual = _warp_residual(views[0], views[1], np.linalg.inv(moved) @ pose, camera)
    picture = cv2.cvtColor(develop(views[0].radiance, SensorConfig.ideal(), 1.0, None), cv2.COLOR_RGB2GRAY)
    assert len(residual) > 0.5 * camera.width * camera.height
    assert picture.std() > 35
    assert abs(np.median(residual)) < 0.5 and np.median(np.abs(residual)) < 3.5
    assert np.sqrt(np.mean(residual**2)) < 0.3 * picture.std()


def test_tracking_is_accurate_to_a_fraction_of_a_pixel() -> None:
    """OpenCV's optical flow follows corners to where exact depth and pose say they are."""
    world = _town()
    renderer, camera = Renderer(world), PinholeCamera(480, 270, 262.0, 262.0, 239.5, 134.5)
    pose = _street_pose()
    moved = pose @ se3(so3_exp(np.array([0.002, 0.01, 0.003])), np.array([0.02, 0.0, 0.5]))
    views = [renderer.render(p, camera, Light()) for p in (pose, moved)]
    grey = [
        cv2.cvtColor(develop(v.radiance, SensorConfig(), 1.0, np.random.default_rng(k)), cv2.COLOR_RGB2GRAY)
        for k, v in enumerate(views)
    ]
    corners = cv2.goodFeaturesToTrack(grey[0], 600, 0.005, 6)
    assert corners is not None and len(corners) > 400
    flow, status, _ = cv2.calcOpticalFlowPyrLK(grey[0], grey[1], corners, None, winSize=(15, 15), maxLevel=3)
    back, _, _ = cv2.calcOpticalFlowPyrLK(grey[1], grey[0], flow, None, winSize=(15, 15), maxLevel=3)
    good = (status.ravel() > 0) & (np.linalg.norm((back - corners).reshape(-1, 2), axis=1) < 0.5)
    start, end = corners.reshape(-1, 2), flow.reshape(-1, 2)
    z = views[0].depth_m[np.rint(start[:, 1]).astype(int), np.rint(start[:, 0]).astype(int)]
    good &= z > 0
    K, T = camera.K, np.linalg.inv(moved) @ pose
    rays = np.column_stack([start, np.ones(len(start))]) @ np.linalg.inv(K).T
    projected = ((rays * z[:, None]) @ T[:3, :3].T + T[:3, 3]) @ K.T
    error = np.linalg.norm(projected[:, :2] / projected[:, 2:] - end, axis=1)[good]
    assert good.sum() > 300 and np.median(error) < 0.2 and np.mean(error < 1.0) > 0.8


def test_distant_texture_is_averaged_not_aliased() -> None:
    """Fine tiles seen from far away give a smooth grey: the same from a slightly shifted camera."""
    renderer = _room()[1]
    far = np.eye(4)
    far[2, 3] = -300.0
    views = []
    for shift in (0.0, 0.37):
        pose = far.copy()
        pose[0, 3] = shift
        views.append(renderer.render(pose, PinholeCamera(64, 48, 300.0, 300.0, 31.5, 23.5), Light()).radiance)
    wall = views[0][8:40, 16:48]
    assert wall.std() / wall.mean() < 0.08
    assert np.abs(views[0] - views[1])[8:40, 16:48].max() / wall.mean() < 0.12


def test_the_light_changes_the_picture_but_not_the_depth() -> None:
    renderer = _room()[1]
    views = [renderer.render(POSE, CAMERA, random_light(np.random.default_rng(k))) for k in (1, 2)]
    assert np.array_equal(views[0].depth_m, views[1].depth_m)
    assert not np.allclose(views[0].radiance, views[1].radiance, rtol=0.02)


def test_sensor_noise_is_that_of_photons_and_reading() -> None:
    config = SensorConfig(full_well=5000.0, read_noise=10.0, vignetting=0.0, gamma=1.0)
    flat = np.full((200, 200, 3), 0.4, np.float32)
    clean = develop(flat, config, 1.0, None).astype(float)
    noisy = develop(flat, config, 1.0, np.random.default_rng(0)).astype(float)
    assert clean.std() < 1e-9 and abs(noisy.mean() - clean.mean()) < 0.5
    electrons = 0.4 * 0.625 * 5000
    slope = (develop(flat * 1.1, config, 1.0, None).astype(float).mean() - clean.mean()) / (0.1 * electrons)
    expected = np.hypot(np.sqrt(electrons + 10.0**2) * slope, np.sqrt(1 / 12))
    assert noisy.std() == pytest.approx(expected, rel=0.12)


def test_depth_map_without_noise_is_the_depth_and_with_noise_about_it() -> None:
    depth = np.tile(np.linspace(0.5, 12.0, 300), (100, 1))
    ideal = depth_map(depth, SensorConfig.ideal(), None) * 0.001
    near = depth <= 10.0
    assert np.abs(ideal - depth)[near].max() <= 0.00051 and not ideal[~near].any()
    noisy = depth_map(depth, SensorConfig(), np.random.default_rng(0)) * 0.001
    known = near & (noisy > 0)
    error = (noisy - depth)[known] / depth[known] ** 2
    assert known.sum() > 0.95 * near.sum() and 0.0012 < error.std() < 0.0022
