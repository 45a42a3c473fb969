"""Facades and signs, drawn: 4 bays by 4 floors of 3.2 m at 2.5 cm a texel. Every window differs a little, every facade
a lot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..scene.textures import Colour, Image, fractal, noise, paving, splats, to_image

BAY_M = FLOOR_M = 3.2
BAYS = FLOORS = 4
SIZE = 512
CELL = SIZE // BAYS

WALLS: tuple[Colour, ...] = (
    (196, 178, 146),
    (172, 108, 84),
    (208, 200, 188),
    (150, 142, 134),
    (214, 186, 128),
    (150, 84, 68),
    (178, 188, 186),
    (222, 212, 196),
    (186, 150, 124),
    (128, 118, 112),
    (200, 160, 140),
    (164, 172, 150),
)


def facade(rng: np.random.Generator) -> Image:
    """One facade ``(512, 512, 3)``; rows from the top, the street is at the bottom; repeats sideways."""
    wall = np.asarray(WALLS[int(rng.integers(len(WALLS)))], np.float32) * rng.uniform(0.85, 1.08)
    canvas = _wall(rng, (float(wall[0]), float(wall[1]), float(wall[2])))
    r, g, b = (float(v) for v in np.clip(wall * rng.choice([0.6, 0.75, 1.25, 1.35]), 20, 245))
    trim = (r, g, b)
    for floor in range(1, FLOORS):
        _band(canvas, (FLOORS - floor) * CELL, trim, rng)
    style = _WindowStyle(rng, trim)
    for floor in range(FLOORS):
        top = (FLOORS - 1 - floor) * CELL
        for bay in range(BAYS):
            if floor == 0:
                _ground_floor(canvas, rng, bay * CELL, top, style)
            else:
                style.draw(canvas, rng, bay * CELL, top)
    if rng.random() < 0.6:
        x = int(rng.integers(BAYS)) * CELL + int(rng.integers(2, 8))
        canvas[:, x : x + 4] = canvas[:, x : x + 4] * 0.55 + 20
    drips = np.clip(noise(rng, (SIZE, SIZE), (4, 64)), -1.5, 1.5) * 0.045
    fade = np.linspace(1.04, 0.93, SIZE, dtype=np.float32)[:, None, None]
    return to_image(canvas * (1 + drips[:, :, None]) * fade)


def _wall(rng: np.random.Generator, base: Colour) -> NDArray[np.float32]:
    kind = rng.random()
    if kind < 0.4:  # brick: 8 cm courses
        return (
            paving(rng, 32, 16, base, SIZE, 1).astype(np.float32)
            if rng.random() < 0.5
            else paving(rng, 64, 32, base, SIZE, 1).astype(np.float32)
        )
    if kind < 0.6:  # ashlar
        return paving(rng, 16, 8, base, SIZE, 1).astype(np.float32)
    canvas = np.full((SIZE, SIZE, 3), base, np.float32)
    canvas *= (1 + 0.06 * fractal(rng, (SIZE, SIZE), 8, 5, 0.8) + splats(rng, (SIZE, SIZE), 260, (2.0, 50.0), 0.05))[
        :, :, None
    ]
    if kind < 0.75:  # panels with joints
        canvas[:: CELL // 2] *= 0.6
        canvas[:, :: CELL // 2] *= 0.6
    return canvas


def _band(canvas: NDArray[np.float32], y: int, colour: Colour, rng: np.random.Generator) -> None:
    depth = int(rng.integers(3, 9))
    canvas[y - depth : y] = canvas[y - depth : y] * 0.25 + 0.75 * np.asarray(colour, np.float32)
    canvas[y : y + 2] *= 0.55


class _WindowStyle:
    """What the windows of one facade have in common."""

    def __init__(self, rng: np.random.Generator, trim: Colour) -> None:
        self.w = int(rng.integers(36, 92)) if rng.random() < 0.8 else 108
        self.h = int(rng.integers(54, 96))
        self.sill = int(rng.integers(24, 40))
        self.split = (int(rng.integers(1, 4)), int(rng.integers(1, 4)))
        self.trim = trim
        frame = rng.choice([235.0, 220.0, 60.0, 90.0])
        self.frame = (frame, frame, frame * rng.uniform(0.85, 1.05))
        self.shutters = rng.random() < 0.3
        self.shutter_colour = dye(rng, 35, 150)
        self.balcony = rng.random() < 0.25

    def draw(self, canvas: NDArray[np.float32], rng: np.random.Generator, x0: int, y0: int) -> None:
        """One window in the cell whose top left corner is (x0, y0)."""
        w, h = self.w, min(self.h, CELL - self.sill - 6)
        x, y = x0 + (CELL - w) // 2, y0 + CELL - self.sill - h
        _rect(canvas, x - 4, y - 5, w + 8, h + 9, self.trim)
        _rect(canvas, x - 6, y + h + 2, w + 12, 4, tuple(v * 0.8 for v in self.trim))
        glass(canvas, rng, x, y, w, h, self.frame, self.split)
        canvas[y : y + 4, x : x + w] *= 0.5  # the reveal's shade
        if self.shutters:
            s = max(min(w // 2, (CELL - w) // 2 - 4), 3)
            for left in (x - s - 3, x + w + 3):
                _rect(canvas, left, y - 2, s, h + 4, self.shutter_colour)
                canvas[y : y + h : 4, left : left + s] *= 0.7
        if self.balcony and rng.random() < 0.7:
            top = y + h - 22
            for k in range(-8, w + 8, 5):
                _rect(canvas, x + k, top, 2, 30, (40, 40, 44))
            _rect(canvas, x - 10, top - 2, w + 20, 3, (40, 40, 44))
            _rect(canvas, x - 12, y + h + 8, w + 24, 5, (150, 148, 144))
        elif rng.random() < 0.2:  # flower box
            for k in range(0, w, 4):
                colour = (60, 100, 50) if rng.random() < 0.6 else tuple(rng.uniform(60, 230, 3))
                _rect(canvas, x + k, y + h - int(rng.integers(3, 9)), 5, 8, colour)


def glass(
    canvas: NDArray[np.float32],
    rng: np.random.Generator,
    x: int,
    y: int,
    w: int,
    h: int,
    frame: Colour,
    split: tuple[int, int],
) -> None:
    """Panes: dark, or with curtains, a blind, something behind; a gradient as of the sky's reflection; frames
    between."""
    dark = rng.uniform(28, 75)
    ramp = np.linspace(1.5, 0.8, h, dtype=np.float32)[:, None, None]
    pane = np.broadcast_to(np.array([dark, dark * 1.05, dark * 1.15], np.float32) * ramp, (h, w, 3)).copy()
    kind = rng.random()
    if kind < 0.35:  # curtains
        c = int(w * rng.uniform(0.15, 0.45))
        tone = rng.uniform(120, 220)
        folds = tone * (1 + 0.18 * np.sin(np.arange(w) * rng.uniform(0.7, 1.4)))
        for cols in (slice(0, c), slice(w - c, w)):
            pane[:, cols] = folds[None, cols, None]
    elif kind < 0.55:  # blind
        b = int(h * rng.uniform(0.2, 0.9))
        pane[:b] = rng.uniform(140, 215)
        pane[:b:4] *= 0.72
    elif kind < 0.75:  # a thing on the sill
        for _ in range(int(rng.integers(1, 4))):
            s = int(rng.integers(6, 18))
            _rect(pane, int(rng.integers(0, max(w - s, 1))), h - s, s, s, tuple(rng.uniform(50, 210, 3)))
    for k in range(split[0] + 1):
        _rect(pane, min(k * w // split[0], w - 3), 0, 3, h, frame)
    for k in range(split[1] + 1):
        _rect(pane, 0, min(k * h // split[1], h - 3), w, 3, frame)
    canvas[y : y + h, x : x + w] = pane


def _ground_floor(canvas: NDArray[np.float32], rng: np.random.Generator, x0: int, y0: int, style: _WindowStyle) -> None:
    kind = rng.random()
    foot = y0 + CELL
    canvas[foot - 14 : foot, x0 : x0 + CELL] *= 0.72  # plinth
    if kind < 0.3:  # door
        w, h = int(rng.integers(38, 56)), int(rng.integers(84, 96))
        x = x0 + (CELL - w) // 2
        colour = dye(rng, 35, 150)
        _rect(canvas, x - 5, foot - h - 6, w + 10, h + 6, style.trim)
        _rect(canvas, x, foot - h, w, h, colour)
        for k in range(2):
            for j in range(3):
                _rect(
                    canvas,
                    x + 4 + k * (w // 2),
                    foot - h + 5 + j * (h // 3),
                    w // 2 - 7,
                    h // 3 - 6,
                    tuple(v * 0.75 for v in colour),
                )
        _rect(canvas, x + w - 8, foot - h // 2, 4, 4, (210, 200, 150))
        canvas[foot - 5 : foot, x - 6 : x + w + 6] = 140
    elif kind < 0.6:  # shop with a name
        h = 84
        glass(canvas, rng, x0 + 6, foot - h - 6, CELL - 12, h, (70, 70, 74), (int(rng.integers(2, 4)), 1))
        board = dye(rng, 25, 215, 0.4)
        _rect(canvas, x0 + 3, foot - h - 30, CELL - 6, 22, board)
        ink = (240.0, 238.0, 225.0) if sum(board) < 380 else (25.0, 25.0, 30.0)
        letters(canvas, rng, x0 + 8, foot - h - 28, CELL - 16, 18, ink)
    else:
        style.draw(canvas, rng, x0, y0)
    if rng.random() < 0.35:  # posters, meters, house numbers
        for _ in range(int(rng.integers(1, 4))):
            w, h = int(rng.integers(8, 22)), int(rng.integers(8, 28))
            x, y = x0 + int(rng.integers(0, CELL - w)), foot - int(rng.integers(40, 80))
            _rect(canvas, x, y, w, h, dye(rng, 60, 240, 0.4))
            _rect(canvas, x + 2, y + 2, max(w - 8, 2), 3, tuple(rng.uniform(20, 120, 3)))
            _rect(canvas, x + 2, y + h // 2, w - 4, 2, tuple(rng.uniform(20, 120, 3)))


def letters(canvas: NDArray[np.float32], rng: np.random.Generator, x: int, y: int, w: int, h: int, ink: Colour) -> None:
    """A word of random letters filling the box."""
    import cv2

    count = max(3, min(9, int(w / h * 1.1)))
    word = "".join(chr(65 + int(k)) for k in rng.integers(0, 26, count))
    font = int(rng.choice([cv2.FONT_HERSHEY_SIMPLEX, cv2.FONT_HERSHEY_DUPLEX, cv2.FONT_HERSHEY_TRIPLEX]))
    (tw, th), _ = cv2.getTextSize(word, font, 1.0, 2)
    scale = min(w / tw, h / (th * 1.3))
    thickness = max(1, round(scale * 2))
    box = canvas[y : y + h, x : x + w]
    mask = np.zeros(box.shape[:2], np.uint8)  # OpenCV 5 writes on 8-bit images only
    cv2.putText(
        mask,
        word,
        (max(int((w - tw * scale) / 2), 0), int((h + th * scale) / 2)),
        font,
        scale,
        255,
        thickness,
        cv2.LINE_AA,
    )
    box += (mask[:, :, None] / np.float32(255)) * (np.asarray(ink, np.float32) - box)


def sign(rng: np.random.Generator, w: int = 128, h: int = 64) -> Image:
    """A board: border, a word or two, an emblem."""
    import cv2

    ground = np.asarray(dye(rng, 15, 240, 0.35), np.float32)
    canvas = np.full((h, w, 3), ground, np.float32)
    ink = (245.0, 245.0, 240.0) if ground.sum() < 380 else (20.0, 20.0, 30.0)
    cv2.rectangle(canvas, (2, 2), (w - 3, h - 3), ink, 2)
    cut = h if w >= 1.5 * h else w
    if rng.random() < 0.6:
        corners = int(rng.integers(3, 7))
        angle = 2 * np.pi * (np.arange(corners) / corners + rng.random())
        centre, reach = np.array([cut / 2, cut / 2]), cut * 0.32
        shape = np.rint(centre + reach * np.stack([np.cos(angle), np.sin(angle)], 1)).astype(np.int32)
        cv2.fillPoly(canvas, [shape], dye(rng, 10, 250, 0.3), cv2.LINE_AA)
    if w >= 1.5 * h:
        letters(canvas, rng, cut, h // 6, w - cut - 5, h // 3, ink)
        letters(canvas, rng, cut, h // 2 + 2, w - cut - 5, h // 4, ink)
    elif h < 1.3 * w:
        letters(canvas, rng, 6, int(h * 0.7), w - 12, int(h * 0.24), ink)
    else:
        for k in range(4):
            y = cut + 4 + k * (h - cut - 8) // 4
            letters(canvas, rng, 6, y, w - 12, max((h - cut - 8) // 4 - 3, 6), ink)
    return to_image(canvas)


def dye(rng: np.random.Generator, low: float, high: float, grey: float = 0.55) -> Colour:
    """A random colour, mixed with ``grey`` parts of its own grey: paint is rarely as bright as random numbers."""
    rgb = rng.uniform(low, high, 3)
    r, g, b = (float(v) for v in grey * rgb.mean() + (1 - grey) * rgb)
    return r, g, b


def _rect(canvas: NDArray[np.float32], x: int, y: int, w: int, h: int, colour: object) -> None:
    canvas[max(y, 0) : max(y + h, 0), max(x, 0) : max(x + w, 0)] = np.asarray(colour, np.float32)
