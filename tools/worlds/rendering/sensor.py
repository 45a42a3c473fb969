"""From radiance to the picture a camera stores: lens shading, exposure, photon and read noise, tone curve; and to a
depth sensor's map."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from maslam._kernels import kernel
from maslam._settings import Settings

DEPTH_UNIT_M = 0.001
"""Metres a unit of a 16-bit depth map."""


class SensorConfig(Settings):
    """A camera's imperfections; all zero gives the ideal picture."""

    full_well: float = Field(
        12000.0, gt=0, description="electrons at full brightness: sets the photon noise; larger is cleaner"
    )
    read_noise: float = Field(9.0, ge=0, description="electrons, deviation")
    vignetting: float = Field(0.22, ge=0, le=1, description="loss of light in the corners, part of 1")
    gamma: float = Field(2.2, gt=0, description="exponent of the tone curve")
    exposure_drift: float = Field(
        0.04, ge=0, description="slow change of the exposure over a sequence, part of 1, deviation"
    )
    depth_noise: float = Field(
        0.0015, ge=0, description="RGB-D: deviation of the depth at 1 m, metres; grows with the square of depth"
    )
    depth_max_m: float = Field(10.0, gt=0, description="RGB-D: farther is unknown")
    depth_quantum: float = Field(
        0.0004, ge=0, description="RGB-D: step of the depth at 1 m, metres; grows with the square of depth"
    )

    @classmethod
    def ideal(cls) -> SensorConfig:
        """No noise, no vignetting, no drift; the tone curve stays."""
        return cls(full_well=1e12, read_noise=0, vignetting=0, exposure_drift=0, depth_noise=0, depth_quantum=0)


def develop(
    radiance: NDArray[np.float32], config: SensorConfig, exposure: float, rng: np.random.Generator | None
) -> NDArray[np.uint8]:
    """The 8-bit RGB picture ``(H, W, 3)`` of a radiance; ``rng`` None leaves the noise out."""
    shape = (0, 0, 0) if rng is None else radiance.shape
    noise = np.zeros(shape, np.uint16) if rng is None else rng.integers(0, 65536, shape, dtype=np.uint16)
    curve = 255.0 * _tone(np.arange(4097) / 4096.0, config.gamma)
    out = np.empty(radiance.shape, np.uint8)
    _develop(
        radiance,
        noise,
        _normal_quantiles(),
        np.float32(exposure),
        np.float32(1 / config.full_well),
        np.float32(config.read_noise / config.full_well),
        np.float32(config.vignetting),
        curve.astype(np.float32),
        out,
    )
    return out


@lru_cache(maxsize=1)
def _normal_quantiles() -> NDArray[np.float32]:
    """The normal distribution's 65536 quantiles: drawing one by 16 random bits is a fifth of the work of drawing a
    normal number."""
    from scipy.special import ndtri

    return ndtri((np.arange(65536) + 0.5) / 65536).astype(np.float32)


def _tone(x: NDArray[np.float64], gamma: float) -> NDArray[np.float64]:
    """Gamma with a soft shoulder: the top fifth of the range holds twice as much light."""
    knee = 0.75
    y = np.where(x * 1.6 < knee, x * 1.6, 1 - (1 - knee) * np.exp(-(x * 1.6 - knee) / (1 - knee)))
    return np.clip(y / y[-1], 0, 1) ** (1 / gamma)


@kernel(fastmath=True, error_model="numpy")
def _develop(
    radiance: NDArray,
    noise: NDArray,
    quantiles: NDArray,
    exposure: np.float32,
    gain: np.float32,
    read: np.float32,
    vignetting: np.float32,
    curve: NDArray,
    out: NDArray,
) -> None:
    h, w, _ = radiance.shape
    reach = 4.0 / (w * w + h * h)
    for y in range(h):
        for x in range(w):
            r2 = ((x - 0.5 * w + 0.5) ** 2 + (y - 0.5 * h + 0.5) ** 2) * reach
            fall = exposure * (1.0 - vignetting * r2)
            for c in range(3):
                v = radiance[y, x, c] * fall * 0.625
                if noise.size:
                    v += np.sqrt(max(v, 0.0) * gain + read * read) * quantiles[noise[y, x, c]]
                k = min(max(v, 0.0), 0.99999) * 4096.0
                i = int(k)
                out[y, x, c] = np.uint8(curve[i] + (k - i) * (curve[i + 1] - curve[i]) + 0.5)


def depth_map(
    depth_m: NDArray[np.float64], config: SensorConfig, rng: np.random.Generator | None
) -> NDArray[np.uint16]:
    """16-bit depth ``(H, W)`` in ``DEPTH_UNIT_M``, 0 = unknown: beyond the range, and at jumps where real sensors
    fail; noise and quantisation as of a structured-light sensor unless they are set to zero."""
    z = depth_m.copy()
    if rng is not None and config.depth_noise > 0:
        z += config.depth_noise * z * z * rng.standard_normal(z.shape)
    if config.depth_quantum > 0:
        step = config.depth_quantum * np.maximum(depth_m, 0.3) ** 2
        z = np.rint(z / step) * step
    if rng is not None and config.depth_noise > 0:
        jump = np.zeros(z.shape, np.bool_)
        for axis in (0, 1):
            inverse = 1 / np.maximum(depth_m, 1e-3)
            broken = np.abs(np.diff(inverse, axis=axis)) * np.minimum(*_neighbours(depth_m, axis)) > 0.05
            first, second = _neighbours(jump, axis)
            first |= broken
            second |= broken
        z[jump] = 0
    z[(depth_m <= 0) | (depth_m > config.depth_max_m)] = 0
    return np.clip(np.rint(z / DEPTH_UNIT_M), 0, 65535).astype(np.uint16)


def _neighbours(a: NDArray, axis: int) -> tuple[NDArray, NDArray]:
    return (a[:-1], a[1:]) if axis == 0 else (a[:, :-1], a[:, 1:])
