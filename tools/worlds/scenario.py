"""Who drives where, when, in which light: everything of a rendering but the pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from tools.worlds.errors import RenderError
from tools.worlds.light import Light, random_light
from tools.worlds.mesh import Mesh
from tools.worlds.paths import Gait, drive
from tools.worlds.routes import lane_line, plan_routes
from tools.worlds.town import build_town
from tools.worlds.world import World

if TYPE_CHECKING:
    from tools.render import RenderConfig


@dataclass(frozen=True)
class AgentPlan:
    """``poses`` ``(F, 4, 4)`` T_W_C of the left camera; ``exposures`` ``(F,)`` factors about 1."""

    poses: NDArray[np.float64]
    light: Light
    exposures: NDArray[np.float64]


@dataclass(frozen=True)
class Scenario:
    world: World
    agents: tuple[AgentPlan, ...]

    def movers(self, time_s: float) -> Mesh | None:
        """The cars that drive, where they are at ``time_s``; None without any."""
        return None


def plan_scenario(config: RenderConfig) -> Scenario:
    """The world, the ways, the lights. Raises RenderError where they cannot be had."""
    if config.poses_file is not None or config.world != "town":
        raise RenderError("only the town is built yet")
    world, ways = _town(config)
    rng = np.random.default_rng([config.seed, 3])
    plans = []
    for poses in ways:
        light = random_light(rng, config.light_change, config.world == "indoor")
        plans.append(AgentPlan(poses, light, _drift(len(poses), config, rng)))
    return Scenario(world, tuple(plans))


def _town(config: RenderConfig) -> tuple[World, list[NDArray[np.float64]]]:
    quality = {"facade_count": 8, "ground_texel_m": 0.1} if config.cheap else {}
    world, network = build_town(config.seed, **quality)
    rng = np.random.default_rng([config.seed, 2])
    seconds = config.frames / config.rate_hz
    routes = plan_routes(network, config.agents, 6.5 * seconds, rng)
    ways = []
    for route in routes:
        gait = Gait(cruise_mps=float(rng.uniform(8.0, 10.0)), height_m=float(rng.uniform(1.55, 1.75)))
        line = lane_line(network, route, 10.5 * seconds + 60.0)
        ways.append(drive(line, config.frames, config.rate_hz, gait, rng, float(np.clip(rng.normal(0, 0.25), -0.5, 0.5))))
    return world, ways


def _drift(frames: int, config: RenderConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """Slow exposure changes: a sum of two sines of random phase."""
    t = np.arange(frames) / config.rate_hz
    phase = rng.uniform(0, 2 * np.pi, 2)
    return np.exp(config.sensor.exposure_drift * (np.sin(0.5 * t + phase[0]) + np.sin(1.3 * t + phase[1])))
