"""Pictures of an office: posters, doors, windows, books, screens. rng in, RGB image out."""

from __future__ import annotations

import numpy as np

from ..scene import textures
from ..town import facades


def poster(rng: np.random.Generator) -> textures.Image:
    """A poster: a sign's words over shapes of all sizes."""
    canvas = textures.splats(rng, (128, 96), 90, (2.0, 40.0), 0.5)[:, :, None] * rng.uniform(0.3, 1.0, 3)
    image = textures.to_image(rng.uniform(90, 200, 3) * (1 + canvas))
    top = facades.sign(rng, 96, 40)
    image[84:124, 4:92] = top[:, 4:92]
    image[:3] = image[-3:] = image[:, :3] = image[:, -3:] = 235
    return image


def door_picture(rng: np.random.Generator) -> textures.Image:
    """A wooden door with two panels, 256 x 128."""
    image = textures.coloured((142, 108, 74), 0.06 * textures.noise(rng, (256, 128), (4, 64)), 1.0)
    image[20:120, 20:108] *= 0.9
    image[140:236, 20:108] *= 0.9
    return textures.to_image(image)


def window_picture(rng: np.random.Generator) -> textures.Image:
    """Sky above greenery behind a frame with a bar, 128 x 160."""
    canvas = np.empty((128, 160, 3), np.float32)
    canvas[:] = np.linspace(1.0, 0.75, 128)[:, None, None] * np.array([205, 222, 240])
    canvas[80:] = np.array([120, 140, 96]) * (
        1 + 0.2 * textures.splats(rng, (128, 128), 300, (2, 12), 1.0)[:48, :1, None]
    )
    for k in (0, 78, 154):
        canvas[:, k : k + 6] = 225
    canvas[:6] = canvas[-6:] = 225
    return textures.to_image(canvas)


def book_picture(rng: np.random.Generator) -> textures.Image:
    """Backs of books in a row, 64 x 256."""
    canvas = np.full((64, 256, 3), 30, np.float32)
    x = 0
    while x < 252:
        w, h = int(rng.integers(4, 15)), int(rng.integers(40, 62))
        canvas[64 - h :, x : x + w - 1] = rng.uniform(40, 220, 3)
        y = int(rng.integers(64 - h + 2, 56))
        canvas[y : y + 4, x + 1 : x + w - 2] = rng.uniform(60, 250, 3)
        x += w
    return textures.to_image(canvas)


def screen_picture(rng: np.random.Generator) -> textures.Image:
    """Lines of text on a dark or a bright screen, 64 x 96."""
    canvas = np.full((64, 96, 3), rng.choice([28.0, 235.0]), np.float32)
    for y in range(6, 58, 5):
        x = 5 + int(rng.integers(0, 4)) * 4
        while x < 84:
            w = int(rng.integers(3, 14))
            canvas[y : y + 2, x : min(x + w, 90)] = rng.uniform(60, 200, 3)
            x += w + 3
    return textures.to_image(canvas)


def wall_picture(rng: np.random.Generator, colour: textures.Colour) -> textures.Image:
    """3.2 m of wall, seamless, foot at the bottom: tiles to elbow height, a rail, roughcast paint with specks above."""
    size = 512
    specks = textures.splats(rng, (size, size), 2600, (1.2, 6.0), 0.10) + 0.02 * textures.fractal(
        rng, (size, size), 8, 5
    )
    image = textures.coloured(colour, specks, 1.0)
    low = int(size - 1.05 / 3.2 * size)
    darker = (0.82 * colour[0], 0.82 * colour[1], 0.82 * colour[2])
    tiles = textures.paving(rng, 32, 16, darker, size, 1).astype(np.float32)
    image[low:] = tiles[low:] * (1 + 0.5 * specks[low:, :, None])
    image[low - 6 : low] = np.asarray(colour) * 0.55
    image[low - 7] = np.asarray(colour) * 1.1
    return textures.to_image(image)
