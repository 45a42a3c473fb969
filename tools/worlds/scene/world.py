"""A finished world: surfaces, textures, and where one may drive or walk."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from .mesh import Mesh
from .texture_atlas import Atlas


@dataclass(frozen=True)
class World:
    """``mesh`` and ``atlas`` say how it looks; ``lamps`` ``(l, 4)``: x, y, z, power, sorted by zone with
    ``zone_lamps`` the first of each (empty under the sky); ``sky_texture``: cloud map, -1 indoors; ``free``: the
    ground that a camera may use; ``movers``: the meshes of objects that may move, each about its own origin on the
    ground, +Z forward."""

    kind: str
    seed: int
    mesh: Mesh
    atlas: Atlas
    free: FreeSpace
    sky_texture: int = -1
    lamps: NDArray[np.float64] = field(default_factory=lambda: np.zeros((0, 4)))
    zone_lamps: NDArray[np.int64] = field(default_factory=lambda: np.zeros(1, np.int64))
    movers: tuple[Mesh, ...] = ()


@dataclass(frozen=True)
class FreeSpace:
    """A raster of the ground plane: ``clearance`` ``(h, w)`` metres from each cell to the nearest obstacle or edge of
    the path, 0 where one may not be; cell (row, col) lies at ``z = origin[1] + row * cell_m``, ``x = origin[0] + col *
    cell_m``."""

    clearance: NDArray[np.float32]
    origin: tuple[float, float]
    cell_m: float

    def at(self, xz: NDArray[np.float64]) -> NDArray[np.float32]:
        """Clearance of points ``(n, 2)`` (x, z), metres; 0 outside the raster."""
        col = np.rint((xz[..., 0] - self.origin[0]) / self.cell_m).astype(np.int64)
        row = np.rint((xz[..., 1] - self.origin[1]) / self.cell_m).astype(np.int64)
        h, w = self.clearance.shape
        inside = (row >= 0) & (row < h) & (col >= 0) & (col < w)
        return np.where(inside, self.clearance[np.clip(row, 0, h - 1), np.clip(col, 0, w - 1)], np.float32(0))
