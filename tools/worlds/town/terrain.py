"""The height of the ground: flat in the town, up and down hill along a driven path."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..scene.mesh import MeshBuilder
from .streets import GroundPlan

CELL_M = 4.0
CAMERA_HEIGHT_M = 1.65
LOWEST_CAMERA_M = 1.2


@dataclass(frozen=True)
class Terrain:
    """``heights`` ``(h, w)`` metres above y = 0 on a grid of ``CELL_M`` whose first point is ``origin`` (x, z); linear
    between."""

    heights: NDArray[np.float64]
    origin: tuple[float, float]

    def height(self, xz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Heights of points ``(..., 2)``."""
        h, w = self.heights.shape
        at = (np.asarray(xz, np.float64) - self.origin) / CELL_M
        x, z = np.clip(at[..., 0], 0, w - 1), np.clip(at[..., 1], 0, h - 1)
        c, r = np.minimum(x.astype(np.int64), max(w - 2, 0)), np.minimum(z.astype(np.int64), max(h - 2, 0))
        c1, r1 = np.minimum(c + 1, w - 1), np.minimum(r + 1, h - 1)
        fx, fz = x - c, z - r
        near = self.heights[r, c] * (1 - fx) + self.heights[r, c1] * fx
        return near * (1 - fz) + (self.heights[r1, c] * (1 - fx) + self.heights[r1, c1] * fx) * fz

    @property
    def flat(self) -> bool:
        """Whether the ground has one height everywhere."""
        return self.heights.size == 1


FLAT = Terrain(np.zeros((1, 1)), (0.0, 0.0))


def terrain_along(centres: NDArray[np.float64], margin_m: float) -> Terrain:
    """Ground 1.65 m under the camera ``centres`` ``(n, 3)``, smooth between and beyond. Where the path meets itself at
    two heights, the ground lies between them, but at least ``LOWEST_CAMERA_M`` under either."""
    from scipy.spatial import cKDTree

    xz, wanted = centres[:, [0, 2]], -centres[:, 1] - CAMERA_HEIGHT_M
    low = np.floor(xz.min(axis=0) - margin_m)
    w, h = (np.ceil((xz.max(axis=0) + margin_m - low) / CELL_M) + 1).astype(int)
    grid = np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1) * CELL_M + low
    distance, index = cKDTree(xz).query(grid.reshape(-1, 2), k=min(24, len(xz)))
    distance, index = distance.reshape(h * w, -1), index.reshape(h * w, -1)
    reach = np.maximum(distance[:, :1], 3.0)
    weight = np.exp(-0.5 * (distance / reach) ** 2)
    weight /= weight.sum(axis=1, keepdims=True)
    ground = Terrain((weight * wanted[index]).sum(axis=1).reshape(h, w), (float(low[0]), float(low[1])))
    for _ in range(8):
        error = wanted - ground.height(xz)
        ground = Terrain(ground.heights + (weight * error[index]).sum(axis=1).reshape(h, w), ground.origin)
    for _ in range(20):
        excess = np.maximum(ground.height(xz) - (wanted + CAMERA_HEIGHT_M - LOWEST_CAMERA_M), 0.0)
        if excess.max() < 1e-3:
            break
        ground = Terrain(
            ground.heights - np.where(distance < 2 * CELL_M, excess[index], 0).max(axis=1).reshape(h, w), ground.origin
        )
    return ground


def add_ground(mesh: MeshBuilder, plan: GroundPlan, terrain: Terrain, material: int, forest: int) -> None:
    """The ground under everything, and a ring of wooded hills round it so that no street ends in the void."""
    h, w = plan.distance.shape
    x0, z0 = plan.origin
    x1, z1 = x0 + w * plan.cell_m, z0 + h * plan.cell_m
    if terrain.flat:
        xs, zs = (x0 - 500, x1 + 500), (z0 - 500, z1 + 500)
        quad = [(xs[0], 0, zs[0]), (xs[1], 0, zs[0]), (xs[1], 0, zs[1]), (xs[0], 0, zs[1])]
        mesh.quads(np.array([quad], float), np.array([[(x - x0, z - z0) for x, _, z in quad]]), material)
    else:
        rows, cols = terrain.heights.shape
        x, z = np.arange(cols) * CELL_M + terrain.origin[0], np.arange(rows) * CELL_M + terrain.origin[1]
        x[0], x[-1], z[0], z[-1] = x[0] - 500, x[-1] + 500, z[0] - 500, z[-1] + 500
        gx, gz = np.meshgrid(x, z)
        vertices = np.stack([gx, -terrain.heights, gz], axis=-1).reshape(-1, 3)
        r, c = np.meshgrid(np.arange(rows - 1), np.arange(cols - 1), indexing="ij")
        a = (r * cols + c).ravel()
        faces = np.concatenate([np.stack([a, a + 1, a + cols + 1], 1), np.stack([a, a + cols + 1, a + cols], 1)])
        mesh.surface(vertices, faces, vertices[:, [0, 2]] - (x0, z0), material)
    _hills(
        mesh,
        np.array([(x0 + x1) / 2, (z0 + z1) / 2]),
        0.75 * max(x1 - x0, z1 - z0) + 120,
        float(terrain.heights.mean()),
        forest,
    )


def _hills(mesh: MeshBuilder, centre: NDArray[np.float64], radius: float, foot: float, material: int) -> None:
    angle = np.linspace(0, 2 * np.pi, 97)
    height = foot + 26 + 9 * np.sin(3 * angle + 1) + 6 * np.sin(7 * angle) + 3 * np.sin(17 * angle + 2)
    ring = radius * np.stack([np.cos(angle), np.sin(angle)], 1)
    low = np.stack([centre[0] + ring[:, 0], np.full(97, 40.0 - foot), centre[1] + ring[:, 1]], 1)
    high = np.stack([centre[0] + 1.15 * ring[:, 0], -height, centre[1] + 1.15 * ring[:, 1]], 1)
    k = np.arange(96)
    faces = np.concatenate([np.stack([k, k + 1, k + 98], 1), np.stack([k, k + 98, k + 97], 1)])
    uv = np.concatenate([np.stack([angle * radius, np.zeros(97)], 1), np.stack([angle * radius, -height - 60], 1)])
    mesh.surface(np.concatenate([low, high]), faces, uv, material)
