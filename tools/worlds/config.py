"""The settings of a rendering."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from maslam.frontend.cameras.models import PinholeCamera, RigKind

from .rendering.sensor import SensorConfig


class RenderConfig(BaseModel):
    """What to render. The same configuration gives the same bytes."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    world: Literal["town", "indoor"] = "town"
    seed: int = Field(0, ge=0, description="of the world, the ways, the lights and the noise")
    agents: int = Field(4, ge=1, le=100)
    frames: int = Field(120, ge=1, description="of each agent; of all agents together with a pose file")
    width: int = Field(640, ge=32, le=4096, description="pixels")
    height: int = Field(360, ge=32, le=4096, description="pixels")
    fov_deg: float = Field(84.0, gt=20, lt=140, description="horizontal field of view")
    rig: RigKind = RigKind.STEREO
    baseline_m: float | None = Field(None, gt=0, description="stereo; default 0.54 m in town, 0.12 m indoors")
    rate_hz: float = Field(10.0, gt=0)
    poses_file: Path | None = Field(
        None, description="KITTI poses to drive instead of ways of our own; the world grows around them"
    )
    poses_step: int = Field(1, ge=1, description="take every so many poses of the file")
    moving_cars: int = Field(0, ge=0, le=200, description="cars that drive through the town")
    light_change: float = Field(1.0, ge=0, le=1, description="how far the light differs between the agents")
    sensor: SensorConfig = SensorConfig()
    cheap: bool = Field(False, description="fewer facades and a coarser ground: for tests")

    def camera(self) -> PinholeCamera:
        f = 0.5 * self.width / float(np.tan(np.deg2rad(self.fov_deg) / 2))
        return PinholeCamera(self.width, self.height, f, f, (self.width - 1) / 2, (self.height - 1) / 2)

    def baseline(self) -> float:
        """Metres between the cameras of a stereo pair."""
        return self.baseline_m if self.baseline_m is not None else (0.54 if self.world == "town" else 0.12)
