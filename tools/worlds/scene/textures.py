"""Tiles that repeat without a seam: noise, stone, asphalt, grass, leaves, clouds. Arrays of display values, rng in,
image out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]
Plane = NDArray[np.float32]
Colour = tuple[float, float, float]


def noise(rng: np.random.Generator, size: tuple[int, int], cells: tuple[int, int]) -> Plane:
    """Smooth periodic noise ``(h, w)``, zero mean, unit deviation, with ``cells`` (rows, columns) random knots in a
    period, rounded down to powers of two, as the sides must be."""
    import cv2

    h, w = size
    rows, cols = (1 << min(c.bit_length() - 1, s.bit_length() - 1) for c, s in zip(cells, size, strict=True))
    pad = 4
    knots = np.pad(rng.standard_normal((rows, cols), dtype=np.float32), pad, mode="wrap")
    y, x = h // rows, w // cols
    full = cv2.resize(knots, ((cols + 2 * pad) * x, (rows + 2 * pad) * y), interpolation=cv2.INTER_CUBIC)
    full = full[pad * y : pad * y + h, pad * x : pad * x + w]
    return (full - full.mean()) / max(float(full.std()), 1e-6)


def fractal(rng: np.random.Generator, size: tuple[int, int], first: int, octaves: int, gain: float = 0.6) -> Plane:
    """Sum of ``octaves`` of :func:`noise`, the first with ``first`` knots a side; zero mean, unit deviation."""
    total = np.zeros(size, np.float32)
    for k in range(octaves):
        total += gain**k * noise(rng, size, (first << k, first << k))
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def coloured(base: Colour, modulation: Plane, strength: float) -> Plane:
    """``(h, w, 3)``: ``base`` (display values 0-255) times ``1 + strength * modulation``."""
    return np.asarray(base, np.float32) * (1.0 + strength * modulation[:, :, None])


def to_image(values: NDArray) -> Image:
    """Values 0 to 255, rounded and clipped, as uint8."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


def splats(
    rng: np.random.Generator, size: tuple[int, int], count: int, radius: tuple[float, float], contrast: float
) -> Plane:
    """Dead leaves: ``count`` blots of power-law size, each of one brightness, covering each other; periodic, about
    zero.

    Occluding shapes of all sizes are what gives natural images their corners at every scale.
    """
    import cv2

    h, w = size
    canvas = np.zeros((h, w), np.float32)
    u = rng.random(count)
    radii = np.sort(radius[1] * (u * ((radius[1] / radius[0]) ** 2 - 1) + 1) ** -0.5)[::-1]
    corners = rng.integers(4, 8, count)
    centres = rng.uniform((0, 0), (w, h), (count, 2))
    values = contrast * rng.standard_normal(count)
    angles = np.sort(rng.uniform(0, 2 * np.pi, (count, 7)), axis=1)
    reach = radii[:, None] * rng.uniform(0.6, 1.2, (count, 7))
    shapes = centres[:, None] + np.stack([reach * np.cos(angles), reach * np.sin(angles)], axis=2)
    low, high = shapes.min(axis=1), shapes.max(axis=1)
    for k in range(count):
        for ox in _copies(low[k, 0], high[k, 0], w):
            for oy in _copies(low[k, 1], high[k, 1], h):
                points = np.rint((shapes[k, : corners[k]] + (ox, oy)) * 8).astype(np.int32)
                cv2.fillPoly(canvas, [points], float(values[k]), cv2.LINE_8, 3)
    return canvas


def _copies(low: float, high: float, period: int) -> tuple[int, ...]:
    """Shifts at which an interval shows within [0, period)."""
    if low < 0:
        return (0, period)
    return (0, -period) if high >= period - 1 else (0,)


def grain(rng: np.random.Generator, size: int = 256, strength: float = 0.14) -> Image:
    """Grey (three equal channels) detail about 128: sand and grit, corners at the finest scales."""
    blots = splats(rng, (size, size), size * 5, (1.2, 9.0), 1.0)
    mix = (
        0.5 * noise(rng, (size, size), (size // 2, size // 2))
        + 0.35 * fractal(rng, (size, size), size // 16, 3)
        + 0.7 * blots
    )
    return _about_128(mix, strength)


def weathering(rng: np.random.Generator, size: int = 512, strength: float = 0.16) -> Image:
    """Grey macro variation about 128: stains and repairs at scales of decimetres to many metres."""
    mix = 0.7 * fractal(rng, (size, size), 4, 6, 0.75) + 0.5 * splats(rng, (size, size), 500, (3.0, 60.0), 1.0)
    return _about_128(mix, strength)


def asphalt(rng: np.random.Generator, size: int = 512) -> Image:
    """Dark grey with speckles and small stones."""
    speckle = noise(rng, (size, size), (size, size)) * 0.12 + fractal(rng, (size, size), 8, 5, 0.8) * 0.06
    speckle += splats(rng, (size, size), 2500, (1.0, 4.0), 0.16)
    return to_image(coloured((104, 104, 108), speckle, 1.0))


def paving(
    rng: np.random.Generator, rows: int, cols: int, base: Colour, size: int = 512, joint: int = 2, stagger: bool = True
) -> Image:
    """Stones in ``rows`` x ``cols`` a tile, each of its own shade, with dark joints."""
    h, w = size // rows, size // cols
    shade = np.repeat(np.repeat(rng.normal(0, 0.10, (rows, cols)).astype(np.float32), h, 0), w, 1)
    stone = np.ones((h, w), np.float32)
    stone[:joint] = stone[:, :joint] = 0.62
    stone[joint] *= 1.08
    mortar = np.tile(stone, (rows, cols))
    out = np.zeros((size, size), np.float32)
    out[: h * rows, : w * cols] = (1 + shade) * mortar
    out[h * rows :], out[:, w * cols :] = 0.62, 0.62
    if stagger:
        for r in range(1, rows, 2):
            out[r * h : (r + 1) * h] = np.roll(out[r * h : (r + 1) * h], w // 2, axis=1)
    out *= 1 + 0.05 * fractal(rng, (size, size), 16, 4, 0.8)
    return to_image(np.asarray(base, np.float32) * out[:, :, None])


def grass(rng: np.random.Generator, size: int = 512, base: Colour = (92, 118, 58)) -> Image:
    """Blades of many lengths, in patches that are more or less yellow."""
    blades = splats(rng, (size, size), 7000, (1.5, 7.0), 0.22)
    mix = blades + 0.12 * fractal(rng, (size, size), 4, 6, 0.7)
    image = coloured(base, mix, 1.0)
    image[:, :, 0] *= 1 + 0.10 * noise(rng, (size, size), (12, 12))
    return to_image(image)


def leaves(rng: np.random.Generator, size: int = 512, base: Colour = (74, 104, 44)) -> Image:
    """Foliage: overlapping leaves over deep shade."""
    mix = -0.45 + splats(rng, (size, size), 5200, (3.0, 14.0), 0.42)
    image = coloured(base, np.clip(mix, -0.85, 1.2), 1.0)
    image[:, :, 0] *= 1 + 0.25 * noise(rng, (size, size), (24, 24))
    return to_image(image)


def bark(rng: np.random.Generator, size: int = 128) -> Image:
    """Brown with furrows along the trunk."""
    lines = noise(rng, (size, size), (size // 8, size // 2)) * 0.22 + noise(rng, (size, size), (4, 8)) * 0.1
    return to_image(coloured((92, 76, 60), lines, 1.0))


def clouds(rng: np.random.Generator, size: int = 512) -> Image:
    """Grey: the thicker the cloud, the brighter."""
    f = fractal(rng, (size, size), 3, 7, 0.58)
    order = np.argsort(np.argsort(f.ravel())).reshape(size, size)  # uniform histogram, so that a cover is a quantile
    return _rgb(to_image(order * (255.0 / order.size)))


def _rgb(grey: Image) -> Image:
    return np.repeat(grey[:, :, None], 3, axis=2)


def _about_128(mix: Plane, strength: float) -> Image:
    mix = (mix - mix.mean()) / max(float(mix.std()), 1e-6)
    return _rgb(to_image(128.0 * (1.0 + strength * mix)))
