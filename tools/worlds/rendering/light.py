"""The light of one agent: time of day, weather, colour temperature. Places stay recognisable, pixels do not stay the
same."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from .shading_kernels import LightArrays

RGB = tuple[float, float, float]


@dataclass(frozen=True)
class Light:
    """Linear factors; ``sun_azimuth_deg`` from +Z towards +X, ``sun_elevation_deg`` above the horizon; ``cloud_cover``
    0 to 1; ``haze_m``: distance at which 63 % of the contrast is gone; ``exposure``: brightness of the whole image, 1
    = normal."""

    sun_azimuth_deg: float = 40.0
    sun_elevation_deg: float = 42.0
    sun_rgb: RGB = (1.75, 1.65, 1.45)
    sky_rgb: RGB = (0.55, 0.62, 0.75)
    ground_rgb: RGB = (0.30, 0.28, 0.25)
    horizon_rgb: RGB = (0.85, 0.90, 0.98)
    zenith_rgb: RGB = (0.22, 0.40, 0.80)
    lamp_rgb: RGB = (1.0, 0.95, 0.85)
    cloud_offset_m: tuple[float, float] = (0.0, 0.0)
    cloud_cover: float = 0.45
    cloud_brightness: float = 1.0
    haze_m: float = 1800.0
    exposure: float = 1.0

    def arrays(self) -> LightArrays:
        """For the compiled kernels."""
        a, e = np.deg2rad(self.sun_azimuth_deg), np.deg2rad(self.sun_elevation_deg)
        sun = np.array([np.sin(a) * np.cos(e), -np.sin(e), np.cos(a) * np.cos(e)])
        cloud = np.array([*self.cloud_offset_m, self.cloud_cover, self.cloud_brightness])
        colours = (self.sun_rgb, self.sky_rgb, self.ground_rgb, self.horizon_rgb, self.zenith_rgb, self.lamp_rgb)
        sun_rgb, sky, ground, horizon, zenith, lamp = (np.array(c, np.float64) for c in colours)
        return LightArrays(sun, sun_rgb, sky, ground, horizon, zenith, lamp, cloud, float(self.haze_m))

    def metered(self) -> float:
        """The exposure at which a grey wall comes out the same in every light."""
        up = float(np.sin(np.deg2rad(max(self.sun_elevation_deg, 5.0))))
        return 1.45 / (0.35 * float(np.mean(self.sun_rgb)) * (0.5 + 0.5 * up) + float(np.mean(self.sky_rgb)))

    def to_dict(self) -> dict[str, object]:
        """Plain values, for the description of a data set."""
        return asdict(self)


def random_light(rng: np.random.Generator, strength: float = 1.0, indoors: bool = False) -> Light:
    """A light drawn from ``rng``; ``strength`` 0 gives the normal light, 1 the spread from clear noon to dull
    evening."""
    warm = strength * rng.normal(0.0, 0.10)
    tone = np.clip([1 + warm, 1.0, 1 - warm], 0.7, 1.3)
    cover = float(np.clip(0.45 + strength * rng.uniform(-0.25, 0.35), 0.0, 0.9))
    direct = float(np.clip(1.0 - strength * rng.uniform(0.0, 0.75) * (cover > 0.5), 0.15, 1.0))
    ambient = 1.0 + 0.9 * (1.0 - direct) + strength * rng.uniform(-0.15, 0.2)
    azimuth, elevation = 40.0 + strength * rng.uniform(-180, 180), 42.0 + strength * rng.uniform(-22, 20)
    exposure = float(np.exp(strength * rng.uniform(-0.22, 0.22)))
    offset = rng.uniform(0, 2000, 2) * strength
    base = Light()
    scale = 0.55 if indoors else 1.0

    def rgb(colour: RGB, factor: float) -> RGB:
        r, g, b = (float(round(v, 4)) for v in np.array(colour) * tone * factor)
        return r, g, b

    return Light(
        sun_azimuth_deg=round(float(azimuth), 3),
        sun_elevation_deg=round(float(elevation), 3),
        sun_rgb=rgb(base.sun_rgb, direct),
        sky_rgb=rgb(base.sky_rgb, ambient * scale),
        ground_rgb=rgb(base.ground_rgb, ambient * scale),
        horizon_rgb=rgb(base.horizon_rgb, 0.6 + 0.4 * direct),
        zenith_rgb=rgb(base.zenith_rgb, 0.6 + 0.4 * direct),
        lamp_rgb=rgb(base.lamp_rgb, 1.0 + strength * rng.uniform(-0.3, 0.3)),
        cloud_offset_m=(round(float(offset[0]), 2), round(float(offset[1]), 2)),
        cloud_cover=round(cover, 3),
        cloud_brightness=round(0.7 + 0.3 * direct, 3),
        haze_m=float(round(1800 * np.exp(-strength * rng.uniform(0, 0.8)), 1)),
        exposure=round(exposure, 4),
    )
