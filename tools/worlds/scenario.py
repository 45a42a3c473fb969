"""Motion and light of a rendering: everything but the images."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from .config import RenderConfig
from .errors import RenderError
from .motion.paths import WALKING, Gait, drive, way_at
from .rendering.light import Light, random_light
from .scene.mesh import Mesh
from .scene.props import placed
from .scene.world import World
from .town.routes import lane_line, plan_routes
from .town.streets import Network

log = logging.getLogger(__name__)
Poses = NDArray[np.float64]
POSES_OVERLAP = 10
"""Frames that neighbouring agents share where a pose file is cut into one piece for each agent."""


@dataclass(frozen=True)
class AgentPlan:
    """``poses`` ``(F, 4, 4)`` T_W_C of the left camera; ``exposures`` ``(F,)`` factors about 1."""

    poses: Poses
    light: Light
    exposures: NDArray[np.float64]


@dataclass(frozen=True)
class Mover:
    """A driving car: which of the world's movers, and its poses on the ground at the frames' times."""

    look: int
    poses: Poses


@dataclass(frozen=True)
class Scenario:
    """A world, the agents in it with their paths and lights, and what moves there by itself."""

    world: World
    agents: tuple[AgentPlan, ...]
    movers: tuple[Mover, ...] = ()

    def moving(self, frame: int) -> Mesh | None:
        """The cars that drive, where they are at ``frame``; None without any."""
        meshes = []
        for mover in self.movers:
            T = mover.poses[min(frame, len(mover.poses) - 1)]
            meshes.append(placed(self.world.movers[mover.look], T[[0, 2], 3], T[[0, 2], 2], 0.0))
        return Mesh.joined(meshes) if meshes else None


def plan_scenario(config: RenderConfig) -> Scenario:
    """The world, the paths, the lights. Raises RenderError where they cannot be had."""
    movers: tuple[Mover, ...] = ()
    if config.moving_cars and (config.world != "town" or config.poses_file is not None):
        raise RenderError(
            f"{config.moving_cars} moving cars need the streets of the town: not indoors, not with a pose file"
        )
    if config.poses_file is not None:
        world, paths = _along(config)
    elif config.world == "indoor":
        world, paths = _indoor(config)
    else:
        world, paths, movers = _town(config)
    rng = np.random.default_rng([config.seed, 3])
    lights = [random_light(rng, config.light_change, world.kind == "indoor") for _ in paths]
    plans = [
        AgentPlan(poses, light, _drift(len(poses), config, rng)) for poses, light in zip(paths, lights, strict=True)
    ]
    return Scenario(world, tuple(plans), movers)


def _quality(config: RenderConfig) -> dict[str, float]:
    return {"facade_count": 6, "ground_texel_m": 0.1} if config.cheap else {}


def _town(config: RenderConfig) -> tuple[World, list[Poses], tuple[Mover, ...]]:
    from .town.town import build_town

    world, network = build_town(config.seed, **_quality(config))  # type: ignore[arg-type]
    rng = np.random.default_rng([config.seed, 2])
    seconds = config.frames / config.rate_hz
    paths = []
    for route in plan_routes(network, config.agents, 6.5 * seconds, rng):
        gait = Gait(cruise_mps=float(rng.uniform(8.0, 10.0)), height_m=float(rng.uniform(1.55, 1.75)))
        line = lane_line(network, route, gait.cruise_mps * seconds + 60.0)
        paths.append(
            drive(line, config.frames, config.rate_hz, gait, rng, float(np.clip(rng.normal(0, 0.25), -0.5, 0.25)))
        )
    return world, paths, _traffic(config, network, paths)


def _traffic(config: RenderConfig, network: Network, paths: list[Poses]) -> tuple[Mover, ...]:
    """Cars on routes of their own that never come near a camera; fewer than asked for is an error."""
    rng = np.random.default_rng([config.seed, 4])
    seconds = config.frames / config.rate_hz
    out: list[Mover] = []
    for attempt in range(40 * config.moving_cars):
        if len(out) == config.moving_cars:
            break
        route = plan_routes(network, 1, 6.5 * seconds, rng, candidates=1)[0]
        gait = Gait(cruise_mps=float(rng.uniform(6.0, 9.0)), wobble_deg=(0, 0, 0), heave_m=0.0)
        poses = drive(
            lane_line(network, route, gait.cruise_mps * seconds + 60.0), config.frames, config.rate_hz, gait, rng
        )
        others = [*paths, *(m.poses for m in out)]
        if all(np.linalg.norm(poses[:, [0, 2], 3] - path[:, [0, 2], 3], axis=1).min() > 7.0 for path in others):
            out.append(Mover(attempt % 10, poses))
    if len(out) < config.moving_cars:
        raise RenderError(
            f"only {len(out)} of {config.moving_cars} moving cars fit among {config.agents} agents for {seconds:.0f} s"
        )
    return tuple(out)


def _indoor(config: RenderConfig) -> tuple[World, list[Poses]]:
    from .indoor.floor import build_indoor
    from .indoor.walks import tour, walk

    world, floor = build_indoor(config.seed)
    rng = np.random.default_rng([config.seed, 2])
    path = tour(floor, world.free, rng)
    seconds = config.frames / config.rate_hz
    # Each starts where the one before it is after half of the time: so neighbours share the other half of their paths.
    first = float(rng.random())
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    starts = np.arange(config.agents, dtype=np.float64) * (0.5 * seconds)
    where = way_at(walk(path, first, 0.0, 2 * length), WALKING, starts)
    paths = []
    for metres in where:
        line = walk(path, first, metres, WALKING.cruise_mps * seconds + 3.0)
        paths.append(
            drive(line, config.frames, config.rate_hz, WALKING, rng, float(np.clip(rng.normal(0, 0.05), -0.1, 0.1)))
        )
    return world, paths


def _along(config: RenderConfig) -> tuple[World, list[Poses]]:
    """The poses of a file, cut into one piece for each agent."""
    from maslam.frontend.files.trajectory import read_kitti_poses

    from .town.town import build_along

    assert config.poses_file is not None
    _, poses = read_kitti_poses(config.poses_file)
    poses = poses[:: config.poses_step][: config.frames]
    _check_path(poses, config)
    if len(poses) < config.frames:
        every = f" (every {config.poses_step}th is used)" if config.poses_step > 1 else ""
        log.warning(
            "%s: %d poses%s, fewer than --frames %d: %d frames are rendered",
            config.poses_file,
            len(poses),
            every,
            config.frames,
            len(poses),
        )
    world = build_along(config.seed, poses, **_quality(config))  # type: ignore[arg-type]
    cuts = np.linspace(0, len(poses), config.agents + 1).astype(int)
    overlap = POSES_OVERLAP if config.agents > 1 else 0
    return world, [poses[max(a - overlap, 0) : b + overlap] for a, b in pairwise(cuts.tolist())]


def _check_path(poses: Poses, config: RenderConfig) -> None:
    name = config.poses_file
    if len(poses) < 2 * config.agents:
        raise RenderError(f"{name}: {len(poses)} poses are too few for {config.agents} agents")
    step = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    if step.max() > 12.0:
        k = int(np.argmax(step))
        raise RenderError(f"{name}: poses {k} and {k + 1} are {step.max():.1f} m apart; at most 12 m can be driven")
    span = np.ptp(poses[:, :3, 3], axis=0)
    if max(span[0], span[2]) > 2500.0:
        raise RenderError(f"{name}: the path spans {max(span[0], span[2]):.0f} m; worlds are grown for at most 2500 m")
    lean = np.rad2deg(np.arccos(np.clip(poses[:, 1, 1], -1, 1)))
    if lean.max() > 35.0:
        raise RenderError(
            f"{name}: a camera leans {lean.max():.0f} degrees; a car on the ground X-Z is expected (+Y down)"
        )


def _drift(frames: int, config: RenderConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """Slow exposure changes: a sum of two sines of random phase."""
    t = np.arange(frames) / config.rate_hz
    phase = rng.uniform(0, 2 * np.pi, 2)
    return np.exp(config.sensor.exposure_drift * (np.sin(0.5 * t + phase[0]) + np.sin(1.3 * t + phase[1])))
