"""Pictures of the sides and the ends of cars, drawn in grey so that the paint's tint colours them."""

from __future__ import annotations

import numpy as np

from ..scene.textures import Image, to_image


def car_side(rng: np.random.Generator, w: int = 384, h: int = 128) -> Image:
    """4.5 m x 1.5 m from the tail (left) to the nose: windows, doors, wheels."""
    import cv2

    canvas = np.full((h, w, 3), 200, np.uint8)
    ramp = np.linspace(1.08, 0.8, h)[:, None, None]
    canvas = to_image(canvas * ramp)
    px = w / 4.5

    def at(x_m: float, height_m: float) -> tuple[int, int]:
        return int((x_m + 2.25) * px), int(h - height_m / 1.5 * h)

    windows = [(-1.55, 0.98), (-1.15, 1.34), (0.28, 1.36), (0.82, 1.0)]
    cv2.fillPoly(canvas, [np.array([at(*p) for p in windows], np.int32)], (34, 40, 48), cv2.LINE_AA)
    doors = sorted(rng.uniform((-0.75, 0.0), (-0.45, 0.2)).tolist())
    for x in doors:
        cv2.line(canvas, at(x, 1.38), at(x, 0.98), (150, 150, 150), 5, cv2.LINE_AA)
        cv2.line(canvas, at(x, 0.98), at(x, 0.35), (90, 90, 90), 1, cv2.LINE_AA)
        cv2.rectangle(canvas, at(x + 0.05, 0.84), at(x + 0.25, 0.80), (60, 60, 60), -1)
    cv2.line(canvas, at(-2.1, 0.68), at(2.1, 0.62), (140, 140, 140), 1, cv2.LINE_AA)
    cv2.rectangle(canvas, at(-2.3, 0.36), at(2.3, 0.0), (46, 46, 50), -1)
    cv2.rectangle(canvas, at(1.75, 0.74), at(2.1, 0.6), (250, 248, 230), -1)
    cv2.rectangle(canvas, at(-2.2, 0.86), at(-1.95, 0.66), (150, 20, 16), -1)
    for x in (-1.35, 1.35):
        centre, r = at(x, 0.34), int(0.34 * px)
        cv2.circle(canvas, centre, r + 4, (28, 28, 30), -1, cv2.LINE_AA)
        cv2.circle(canvas, centre, int(r * 0.66), (168, 168, 172), -1, cv2.LINE_AA)
        for k in range(5):
            a = 2 * np.pi * (k / 5 + rng.random() * 0.01)
            tip = (int(centre[0] + r * 0.6 * np.cos(a)), int(centre[1] + r * 0.6 * np.sin(a)))
            cv2.line(canvas, centre, tip, (70, 70, 74), 3, cv2.LINE_AA)
        cv2.circle(canvas, centre, int(r * 0.16), (60, 60, 62), -1, cv2.LINE_AA)
    return canvas


def car_end(rng: np.random.Generator, w: int = 128, h: int = 128) -> Image:
    """Front or back, 1.7 m wide, the lowest metre: lights, grille, number plate."""
    import cv2

    canvas = to_image(np.full((h, w, 3), 195) * np.linspace(1.1, 0.75, h)[:, None, None])
    front = bool(rng.random() < 0.5)
    lamp = (250, 248, 235) if front else (170, 24, 20)
    top = int(rng.integers(30, 44))
    for x in (4, w - 32):
        cv2.rectangle(canvas, (x, top), (x + 27, top + 14), lamp, -1)
        cv2.rectangle(canvas, (x, top), (x + 27, top + 14), (60, 60, 60), 1)
    if front:
        for k in range(4):
            cv2.line(canvas, (40, top + 2 + 4 * k), (w - 40, top + 2 + 4 * k), (40, 40, 44), 2)
    cv2.rectangle(canvas, (w // 2 - 20, top + 26), (w // 2 + 20, top + 37), (238, 236, 225), -1)
    text = "".join(chr(48 + int(k)) for k in rng.integers(0, 10, 5))
    cv2.putText(canvas, text, (w // 2 - 18, top + 36), cv2.FONT_HERSHEY_SIMPLEX, 0.4, (20, 20, 30), 1, cv2.LINE_AA)
    cv2.rectangle(canvas, (0, h - 26), (w, h), (44, 44, 48), -1)
    return canvas
