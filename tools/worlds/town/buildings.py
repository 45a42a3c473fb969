"""Houses along a street: where they fit, and their walls, cornices, roofs and boards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.mesh import MeshBuilder
from .facades import BAY_M, FLOOR_M
from .streets import PAVEMENT_M, ROAD_HALF_M, GroundPlan, Line

SOLID = 3
"""A house in the raster of taken ground (1: street)."""
SETBACK_M = ROAD_HALF_M + PAVEMENT_M + 0.3


@dataclass(frozen=True)
class BuildingPlot:
    """A rectangle of ground: ``corner`` (x, z) front left as seen from the street, ``along`` and ``inward`` unit
    vectors, metres."""

    corner: NDArray[np.float64]
    along: NDArray[np.float64]
    inward: NDArray[np.float64]
    width: float
    depth: float

    def outline(self, grow: float = 0.0) -> NDArray[np.float64]:
        """Corners ``(4, 2)``: front left, front right, back right, back left."""
        a, i = self.along * grow, self.inward * grow
        f, w, d = self.corner, self.along * self.width, self.inward * self.depth
        return np.array([f - a - i, f + w + a - i, f + w + d + a + i, f + d - a + i])


def plots_along(
    lines: tuple[Line, ...], plan: GroundPlan, taken: NDArray[np.uint8], rng: np.random.Generator
) -> list[BuildingPlot]:
    """Plots on both sides of all lines, as many as fit; ``taken`` (raster of the plan, 0 = free) is filled as they are
    placed."""
    plots = []
    for line in lines:
        for side in (1.0, -1.0):
            path = line if side > 0 else line[::-1]
            k = 0
            while k < len(path) - 8:
                plot = _fit(path, k, plan, taken, rng)
                if plot is None:
                    k += 2
                    continue
                plots.append(plot)
                k += int(np.ceil(plot.width + (rng.uniform(0.2, 5.0) if rng.random() < 0.45 else 0.0)))
    return plots


def _fit(
    path: Line, k: int, plan: GroundPlan, taken: NDArray[np.uint8], rng: np.random.Generator
) -> BuildingPlot | None:
    """The widest of three random houses that starts at point ``k`` on the right of ``path`` and stands on free
    ground."""
    import cv2

    for bays in sorted(rng.integers(2, 7, 3).tolist(), reverse=True):
        width = bays * BAY_M
        end = min(k + int(width), len(path) - 1)
        along = path[end] - path[k]
        along = along / np.linalg.norm(along)
        right = np.array([along[1], -along[0]])  # +Z forward, +X right: the right of (x, z) is (z, -x)
        depth = float(rng.choice([8.0, 9.6, 11.2, 12.8]))
        # Seen from the street, the house on the right begins on the left where the path goes on.
        plot = BuildingPlot(path[k] + width * along + SETBACK_M * right, -along, right, width, depth)
        cells = (plot.outline(-0.2) - plan.origin) / plan.cell_m
        x, y, w, h = cv2.boundingRect(np.floor(cells).astype(np.int32))
        if x < 0 or y < 0 or x + w >= taken.shape[1] or y + h >= taken.shape[0]:
            continue
        mask = np.zeros((h + 1, w + 1), np.uint8)
        cv2.fillConvexPoly(mask, np.rint(cells - (x, y)).astype(np.int32), 1)
        window = taken[y : y + h + 1, x : x + w + 1]
        if window[mask > 0].any():
            continue
        window[mask > 0] = SOLID
        return plot
    return None


@dataclass(frozen=True)
class Masonry:
    """Materials of houses: numbers of the world's material table."""

    facades: tuple[int, ...]
    roofs: tuple[int, ...]
    trim: int
    boards: tuple[int, ...]
    awnings: tuple[int, ...]


def add_house(mesh: MeshBuilder, plot: BuildingPlot, m: Masonry, foot: float, rng: np.random.Generator) -> None:
    """A house on ``plot``; ``foot``: height of the ground there above y = 0, metres."""
    floors = int(rng.choice([2, 3, 3, 4]))
    top = foot + floors * FLOOR_M
    tint = np.clip(rng.normal(1.0, 0.10, 3) * 0.5 + rng.normal(1.0, 0.12) * 0.5, 0.7, 1.25)
    facade = int(rng.choice(m.facades))
    corners = plot.outline()
    for i in range(4):
        a, b = corners[i], corners[(i + 1) % 4]
        mesh.wall(a, b, foot - 4.0, top, facade, tint, (BAY_M * int(rng.integers(0, 4)), 4.0))
    axes = np.stack([[plot.along[0], 0, plot.along[1]], [0, 1, 0], [-plot.inward[0], 0, -plot.inward[1]]], axis=1)
    middle = corners.mean(axis=0)
    depth = float(rng.uniform(0.25, 0.5))
    mesh.box(
        np.array([middle[0], -(top + 0.05), middle[1]]),
        axes,
        np.array([plot.width + depth, 0.35, plot.depth + depth]),
        m.trim,
        tint * 0.9,
        open_bottom=False,
    )
    roof, roof_tint = int(rng.choice(m.roofs)), np.full(3, rng.uniform(0.75, 1.15))
    if rng.random() < 0.7:
        _gable(mesh, plot, top + 0.2, float(rng.uniform(1.8, 3.4)), roof, facade, tint, roof_tint)
        chimney = middle + plot.along * rng.uniform(-0.3, 0.3) * plot.width
        mesh.box(np.array([chimney[0], -(top + 2.2), chimney[1]]), axes, np.array([0.8, 4.4, 0.8]), m.trim, tint * 0.7)
    else:
        for _ in range(int(rng.integers(1, 4))):
            p = (
                middle
                + plot.along * rng.uniform(-0.35, 0.35) * plot.width
                + plot.inward * rng.uniform(-0.3, 0.3) * plot.depth
            )
            size = np.array([rng.uniform(0.8, 2.5), rng.uniform(0.6, 1.8), rng.uniform(0.8, 2.0)])
            mesh.box(np.array([p[0], -(top + 0.2 + size[1] / 2), p[1]]), axes, size, m.trim, rng.uniform(0.6, 1.0))
    _boards(mesh, plot, m, foot, floors, axes, rng)


def _gable(
    mesh: MeshBuilder,
    plot: BuildingPlot,
    base: float,
    rise: float,
    roof: int,
    wall: int,
    tint: object,
    roof_tint: object,
) -> None:
    """A ridge along the street with its two slopes and two triangles of wall."""
    c = plot.outline(0.35)
    left, right = (c[0] + c[3]) / 2, (c[1] + c[2]) / 2

    def up(p: NDArray, height: float) -> list[float]:
        return [p[0], -height, p[1]]

    run = float(np.hypot(np.linalg.norm(c[3] - c[0]) / 2, rise))
    length = float(np.linalg.norm(right - left))
    for a, b, l, r in ((c[0], c[1], left, right), (c[2], c[3], right, left)):
        quad = [up(a, base), up(b, base), up(r, base + rise), up(l, base + rise)]
        mesh.quads(np.array([quad]), np.array([[(0, 0), (length, 0), (length, -run), (0, -run)]]), roof, roof_tint)
    for a, b, ridge in ((c[3], c[0], left), (c[1], c[2], right)):
        half = float(np.linalg.norm(b - a)) / 2
        quad = [up(a, base), up(b, base), up(ridge, base + rise), up(ridge, base + rise)]
        mesh.quads(np.array([quad]), np.array([[(0, 0), (2 * half, 0), (half, -rise), (half, -rise)]]), roof, roof_tint)


def _boards(
    mesh: MeshBuilder, plot: BuildingPlot, m: Masonry, foot: float, floors: int, axes: NDArray, rng: np.random.Generator
) -> None:
    """Boards on the wall and hanging over the pavement, awnings."""
    out = -plot.inward
    for bay in range(round(plot.width / BAY_M)):
        centre = plot.corner + plot.along * (bay + 0.5) * BAY_M
        kind = rng.random()
        if kind < 0.16:  # flat board between the floors
            w = float(rng.uniform(1.4, 2.6))
            a, b = centre - plot.along * w / 2 + out * 0.06, centre + plot.along * w / 2 + out * 0.06
            y = foot + FLOOR_M * int(rng.integers(1, floors)) - 0.1
            board(mesh, a, b, y, y + w / 2, int(rng.choice(m.boards)))
        elif kind < 0.30:  # hanging sign, seen along the street
            a, b = centre + out * 0.25, centre + out * 1.15
            y = foot + rng.uniform(2.5, 3.0)
            sign = int(rng.choice(m.boards))
            board(mesh, a, b, y, y + 0.45, sign)
            board(mesh, b - 1e-3 * plot.along, a - 1e-3 * plot.along, y, y + 0.45, sign)
        elif kind < 0.40:  # awning
            w, reach, y = 2.9, float(rng.uniform(0.9, 1.5)), foot + 2.75
            a, b = centre - plot.along * w / 2, centre + plot.along * w / 2
            quad = [
                (*_xz(a + out * reach, y - 0.55),),
                (*_xz(b + out * reach, y - 0.55),),
                (*_xz(b, y),),
                (*_xz(a, y),),
            ]
            uv = [(0, 0), (w, 0), (w, -reach), (0, -reach)]
            cloth = int(rng.choice(m.awnings))
            mesh.quads(np.array([quad]), np.array([uv]), cloth)
            drop = [(*_xz(a + out * reach, y - 0.8),), (*_xz(b + out * reach, y - 0.8),), quad[1], quad[0]]
            mesh.quads(np.array([drop]), np.array([[(0, 0), (w, 0), (w, -0.25), (0, -0.25)]]), cloth)


def board(mesh: MeshBuilder, a: NDArray, b: NDArray, bottom: float, top: float, material: int) -> None:
    """A whole picture of unit size (uv 0..1) on a vertical rectangle from ``a`` (left) to ``b`` (right)."""
    quad = [_xz(a, bottom), _xz(b, bottom), _xz(b, top), _xz(a, top)]
    mesh.quads(np.array([quad]), np.array([[(0, 1), (1, 1), (1, 0), (0, 0)]]), material)


def _xz(p: NDArray, height: float) -> tuple[float, float, float]:
    return float(p[0]), -float(height), float(p[1])
