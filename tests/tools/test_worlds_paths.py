"""Ways: on the road, inside the rooms, never through walls, at bounded speed, and meeting each other in the same
direction."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from maslam.frontend.cameras.models import PinholeCamera
from maslam.frontend.files.trajectory import write_kitti_poses
from maslam.tools.worlds.config import RenderConfig
from maslam.tools.worlds.rendering.light import Light
from maslam.tools.worlds.rendering.renderer import Renderer
from maslam.tools.worlds.scenario import Scenario, plan_scenario
from maslam.tools.worlds.town.streets import ROAD_HALF_M

Poses = NDArray[np.float64]


@cache
def _plan(world: str, agents: int, frames: int, seed: int, moving_cars: int = 0) -> Scenario:
    config = RenderConfig(world=world, agents=agents, frames=frames, seed=seed, cheap=True, moving_cars=moving_cars)
    return plan_scenario(config)


def _meetings(first: Poses, second: Poses, within_m: float) -> int:
    """Frames of ``first`` from whose place ``second``, at any time, looks the same way (30 degrees)."""
    apart = np.linalg.norm(first[:, None, :3, 3] - second[None, :, :3, 3], axis=2)
    same_way = np.einsum("ik,jk->ij", first[:, :3, 2], second[:, :3, 2]) > np.cos(np.deg2rad(30))
    return int(((apart < within_m) & same_way).any(axis=1).sum())


def _ways_between(renderer: Renderer, poses: Poses) -> float:
    """Smallest part of the way to the next camera that is free of any surface: below 1 a wall was passed."""
    import open3d as o3d

    centres = poses[:, :3, 3]
    rays = np.concatenate([centres[:-1], np.diff(centres, axis=0)], axis=1).astype(np.float32)
    hit = renderer._layers[0].scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    return float(hit.min())


@pytest.mark.parametrize("seed", [1, 2])
def test_cars_stay_on_the_road_at_bounded_speed(seed: int) -> None:
    scenario = _plan("town", 4, 120, seed)
    renderer = Renderer(scenario.world)
    for agent in scenario.agents:
        centres = agent.poses[:, :3, 3]
        assert scenario.world.free.at(centres[:, [0, 2]]).min() > 0.9
        assert _ways_between(renderer, agent.poses) > 1.0
        speed = np.linalg.norm(np.diff(centres, axis=0), axis=1) * 10
        assert speed.min() > 2.0 and speed.max() < 11.0 and np.abs(np.diff(speed)).max() < 0.6
        turn = np.einsum("nij,nij->n", agent.poses[:-1, :3, :3], agent.poses[1:, :3, :3])
        assert np.rad2deg(np.arccos(np.clip((turn - 1) / 2, -1, 1))).max() < 5.5
        assert np.allclose(np.linalg.det(agent.poses[:, :3, :3]), 1.0)
        assert (agent.poses[:, 1, 1] > 0.99).all()


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_cars_meet_each_other_in_the_same_direction(seed: int) -> None:
    agents = _plan("town", 4, 120, seed).agents
    for k, agent in enumerate(agents):
        others = [_meetings(agent.poses, other.poses, 3.0) for j, other in enumerate(agents) if j != k]
        assert max(others) >= 20, (k, others)
        starts = [
            np.linalg.norm(agent.poses[0, :3, 3] - other.poses[0, :3, 3]) for j, other in enumerate(agents) if j != k
        ]
        assert min(starts) > 10.0


def test_a_long_drive_comes_back_on_its_own_tracks() -> None:
    poses = _plan("town", 1, 500, 3).agents[0].poses
    later = np.array([_meetings(poses[k : k + 1], poses[: max(k - 150, 0)], 3.0) for k in range(len(poses))])
    assert later.sum() >= 30


@pytest.mark.parametrize("seed", [1, 2])
def test_walkers_pass_through_doors_and_not_through_walls(seed: int) -> None:
    scenario = _plan("indoor", 3, 300, seed)
    renderer = Renderer(scenario.world)
    for agent in scenario.agents:
        centres = agent.poses[:, :3, 3]
        assert scenario.world.free.at(centres[:, [0, 2]]).min() > 0.2
        assert _ways_between(renderer, agent.poses) > 1.0
        assert np.linalg.norm(np.diff(centres, axis=0), axis=1).max() * 10 < 1.5
    assert all(
        _meetings(a.poses, b.poses, 0.7) >= 30 for a, b in zip(scenario.agents[:-1], scenario.agents[1:], strict=True)
    )


def test_moving_cars_drive_and_keep_off_the_cameras() -> None:
    scenario = _plan("town", 2, 60, 4, 5)
    assert len(scenario.movers) == 5 and scenario.moving(0) is not None
    for mover in scenario.movers:
        assert scenario.world.free.at(mover.poses[:, [0, 2], 3]).min() > 0.5
        assert np.linalg.norm(mover.poses[-1, :3, 3] - mover.poses[0, :3, 3]) > 8.0
        for agent in scenario.agents:
            assert np.linalg.norm(mover.poses[:, [0, 2], 3] - agent.poses[:, [0, 2], 3], axis=1).min() > 7.0
    static, moving = (scenario.moving(k) for k in (0, 30))
    assert static is not None and moving is not None
    mover = scenario.movers[0].poses[0]
    behind = mover.copy()
    behind[:3, 3] += -6.0 * mover[:3, 2] + np.array([0, 0.25, 0])
    camera = PinholeCamera(64, 48, 40.0, 40.0, 31.5, 23.5)
    renderer = Renderer(scenario.world)
    with_car = renderer.render(behind, camera, Light(), static)
    without = renderer.render(behind, camera, Light())
    assert with_car.depth_m[30, 32] < 5.0 < without.depth_m[30, 32] or without.depth_m[30, 32] == 0


@pytest.fixture(scope="module")
def eight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A figure of eight driven up and down hill, written as KITTI poses; it crosses itself and is driven one and a
    half times."""
    t = np.arange(0, 3 * np.pi, 0.02)
    x = 70 * np.sin(t)
    centres = np.stack([x, 1.5 * np.sin(x / 40) + 0.03 * t, 45 * np.sin(2 * t)], axis=1)
    heading = np.gradient(centres, axis=0)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    right = np.cross([0.0, 1.0, 0.0], heading)
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (len(t), 1, 1))
    poses[:, :3, :3] = np.stack([right, np.cross(heading, right), heading], axis=2)
    poses[:, :3, 3] = centres
    path = tmp_path_factory.mktemp("poses") / "eight.txt"
    write_kitti_poses(path, poses)
    return path


def test_a_world_grown_along_poses_leaves_their_road_free(eight: Path) -> None:
    scenario = plan_scenario(RenderConfig(poses_file=eight, agents=2, frames=10_000, seed=1, cheap=True))
    renderer = Renderer(scenario.world)
    poses = np.concatenate([a.poses for a in scenario.agents])
    assert len(poses) == 472 + 2 * 10
    ahead = []
    import open3d as o3d

    for agent in scenario.agents:
        assert _ways_between(renderer, agent.poses) > 1.0
        assert scenario.world.free.at(agent.poses[:, [0, 2], 3]).min() > ROAD_HALF_M - 1.0
    for side in (
        -1.5,
        0.0,
        1.5,
    ):  # nothing above the road within the width of a car, and ground 1.1 to 2.3 m below the camera
        start = poses[:, :3, 3] + side * poses[:, :3, 0]
        down = np.concatenate([start, np.tile([0.0, 1.0, 0.0], (len(start), 1))], axis=1).astype(np.float32)
        up = down.copy()
        up[:, 4] = -1.0
        cast = renderer._layers[0].scene.cast_rays
        below, above = (cast(o3d.core.Tensor(r))["t_hit"].numpy() for r in (down, up))
        assert below.min() > 1.1 and below.max() < 2.3
        ahead.append(np.isinf(above).mean())
    assert min(ahead) > 0.9  # leaves of a tree may hang over the road, houses may not
    houses = np.ptp(scenario.world.mesh.vertices[:, :, 1], axis=1) > 2.0
    assert houses.sum() > 100


def test_the_same_seed_plans_the_same_ways() -> None:
    config = RenderConfig(world="indoor", agents=2, frames=50, seed=6)
    first, second = plan_scenario(config), plan_scenario(config)
    assert all(
        np.array_equal(a.poses, b.poses) and a.light == b.light
        for a, b in zip(first.agents, second.agents, strict=True)
    )
    assert np.array_equal(first.world.atlas.texels, second.world.atlas.texels)
    assert np.array_equal(first.world.mesh.vertices, second.world.mesh.vertices)
