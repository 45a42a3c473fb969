"""The settings of a rendering."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np
from pydantic import Field

from maslam._settings import Settings
from maslam.frontend.cameras.models import PinholeCamera, RigKind

from .rendering.sensor import SensorConfig


class RenderConfig(Settings):
    """Settings of a rendering. The same configuration gives the same bytes.

    Defaults are named (``default=``): type checkers without pydantic's plug-in see them only so.
    """

    world: Literal["town", "indoor"] = Field(default="town", description="streets of a town, or an office floor")
    seed: int = Field(default=0, ge=0, description="seed of the world, the paths, the lights and the noise")
    agents: int = Field(default=4, ge=1, le=100, description="agents, each with its own path and light")
    frames: int = Field(default=120, ge=1, description="frames of each agent; of all together with a pose file")
    width: int = Field(default=640, ge=32, le=4096, description="image width, pixels")
    height: int = Field(default=360, ge=32, le=4096, description="image height, pixels")
    fov_deg: float = Field(default=84.0, gt=20, lt=140, description="horizontal field of view, degrees")
    rig: RigKind = Field(default=RigKind.STEREO, description="cameras of each agent: mono, stereo or rgbd")
    baseline_m: float | None = Field(
        default=None, gt=0, description="stereo: distance of the cameras, metres; default 0.54 in town, 0.12 indoors"
    )
    rate_hz: float = Field(default=10.0, gt=0, description="frames per second")
    poses_file: Path | None = Field(
        default=None, description="KITTI pose file to drive instead of generated paths; the world grows around it"
    )
    poses_step: int = Field(default=1, ge=1, description="use every n-th pose of the pose file")
    moving_cars: int = Field(default=0, ge=0, le=200, description="cars that drive through the town")
    light_change: float = Field(default=1.0, ge=0, le=1, description="difference of light between the agents, 0 to 1")
    sensor: SensorConfig = SensorConfig()
    cheap: bool = Field(default=False, description="fewer facades and a coarser ground: for tests")

    def camera(self) -> PinholeCamera:
        """The pinhole camera of all agents: square pixels, its centre in the middle of the image."""
        f = 0.5 * self.width / float(np.tan(np.deg2rad(self.fov_deg) / 2))
        return PinholeCamera(self.width, self.height, f, f, (self.width - 1) / 2, (self.height - 1) / 2)

    def baseline(self) -> float:
        """Metres between the cameras of a stereo pair."""
        return self.baseline_m if self.baseline_m is not None else (0.54 if self.world == "town" else 0.12)
