"""Single views of worlds for training and testing place descriptors: any pose, any light, small and fast."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.cameras.models import PinholeCamera

from .errors import RenderError
from .rendering.light import Light
from .rendering.renderer import Renderer
from .rendering.sensor import SensorConfig, develop
from .scene.world import World


@dataclass(frozen=True)
class SampledView:
    """``image`` ``(H, W, 3)`` uint8 RGB after the sensor; ``depth_m`` ``(H, W)`` metres along +Z, exact, 0 = sky."""

    image: NDArray[np.uint8]
    depth_m: NDArray[np.float64]


ViewSampler = Callable[[NDArray[np.float64], Light, np.random.Generator], SampledView]


def view_sampler(
    kind: str, seed: int, camera: PinholeCamera | None = None, sensor: SensorConfig | None = None
) -> tuple[World, ViewSampler]:
    """A world (``kind`` "town" or "indoor") and a function that photographs it: ``sample(T_W_C, light, rng)``.

    ``camera``: default 320x240, 84 degrees wide; ``world.free.at(xz)`` tells where a camera may stand (metres to the
    next obstacle); lights come from :func:`maslam.tools.worlds.rendering.light.random_light`. Facades and ground are
    coarser than for driving, which thumbnails do not show.
    """
    if kind == "town":
        from .town.town import build_town

        world = build_town(seed, facade_count=24, ground_texel_m=0.1)[0]
    elif kind == "indoor":
        from .indoor.floor import build_indoor

        world = build_indoor(seed)[0]
    else:
        raise RenderError(f"no world of kind {kind!r}; there are town and indoor")
    renderer = Renderer(world)
    lens = camera or PinholeCamera(320, 240, 177.7, 177.7, 159.5, 119.5)
    config = sensor or SensorConfig()

    def sample(T_W_C: NDArray[np.float64], light: Light, rng: np.random.Generator) -> SampledView:
        view = renderer.render(T_W_C, lens, light)
        return SampledView(develop(view.radiance, config, light.metered() * light.exposure, rng), view.depth_m)

    return world, sample
