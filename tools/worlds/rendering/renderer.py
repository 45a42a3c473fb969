"""Views of a world: rays by open3d (Embree), shading by compiled kernels, anti-aliased where surfaces break."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from maslam.frontend.cameras.models import PinholeCamera

from ..errors import RenderError
from ..scene.mesh import Mesh
from ..scene.world import World
from .light import Light
from .ray_kernels import edge_pixels, hit_points, odd_pixels, pack_rays, pack_shadow_rays
from .shading_kernels import LightArrays, SceneArrays, shade

SAMPLES = ((0.0, -0.36), (0.312, 0.18), (-0.312, 0.18))
"""Where a pixel on an edge is sampled besides its centre, pixels from it."""


@dataclass(frozen=True)
class View:
    """``radiance`` ``(H, W, 3)`` float32, linear RGB, before the sensor; ``depth_m`` ``(H, W)`` float64 metres along
    +Z at the pixel centres, exact, 0 = sky."""

    radiance: NDArray[np.float32]
    depth_m: NDArray[np.float64]


def load_open3d() -> Any:
    """The library that casts the rays; ``RenderError`` where it is not installed. What renders calls this before long
    work: everything else of maslam does without open3d."""
    try:
        import open3d
    except ModuleNotFoundError as error:
        raise RenderError("rendering needs open3d: pip install 'maslam[worlds]'") from error
    return open3d


class Renderer:
    """Ray casting of one world. Construction loads open3d and sorts the triangles; ``render`` may be called from
    several threads."""

    def __init__(self, world: World) -> None:
        self._o3d = load_open3d()
        self.world = world
        self._layers = [self._layer(world.mesh)]

    def render(
        self, T_W_C: NDArray[np.float64], camera: PinholeCamera, light: Light, movers: Mesh | None = None
    ) -> View:
        """The view of ``camera`` at pose ``T_W_C`` ``(4, 4)``; ``movers``: further surfaces of this moment, such as
        driving cars, in the world's materials. The same arguments give the same bytes."""
        h, w = camera.height, camera.width
        cast = _Cast(self._o3d, self._layers + ([self._layer(movers)] if movers is not None and len(movers) else []))
        view = _view(T_W_C, camera)
        lights = light.arrays()
        pixels, even = _grid(h, w)

        triangle = np.zeros(h * w, np.int32)
        triangle[even] = cast.triangles(pixels, even, view)
        rest = odd_pixels(triangle, np.zeros(h * w, np.bool_), h, w)
        triangle[rest] = cast.triangles(pixels, rest, view)
        depth, group, facing = cast.hits(pixels, triangle, view, lights)
        lit = facing.copy()
        sunny = even[facing[even]]
        lit[sunny] = cast.sunlit(pixels, depth, sunny, view, lights)
        unsure = odd_pixels(lit, triangle, h, w)
        unsure = unsure[facing[unsure]]
        lit[unsure] = cast.sunlit(pixels, depth, unsure, view, lights)
        lit &= facing
        radiance = cast.shaded(pixels, triangle, depth, lit, view, lights, 1.0)

        edges = edge_pixels(group, depth, lit, radiance, h, w)
        if len(edges):
            fine = (pixels[edges][:, None] + np.array(SAMPLES)).reshape(-1, 2)
            around = cast.samples(fine, view, lights).reshape(len(edges), len(SAMPLES), 3).sum(axis=1)
            radiance[edges] = (radiance[edges] + around) / np.float32(len(SAMPLES) + 1)
        return View(radiance.reshape(h, w, 3), depth.reshape(h, w))

    def _layer(self, mesh: Mesh) -> _Layer:
        scene = self._o3d.t.geometry.RaycastingScene(1)
        faces = np.arange(3 * len(mesh), dtype=np.uint32).reshape(-1, 3)
        vertices = np.ascontiguousarray(mesh.vertices.reshape(-1, 3), np.float32)
        tensor: Any = self._o3d.core.Tensor  # its stubs know fewer ways to make one than it does
        scene.add_triangles(tensor(vertices), tensor(faces))
        return _Layer(scene, scene_arrays(self.world, mesh))


@dataclass(frozen=True)
class _Layer:
    """Surfaces with a ray casting scene of their own."""

    scene: Any
    arrays: SceneArrays


class _Cast:
    """Rays through one or two layers; the triangles of the second are numbered on from those of the first."""

    def __init__(self, o3d: Any, layers: list[_Layer]) -> None:
        self._tensor, self._layers = o3d.core.Tensor, layers
        self._first = [0, *np.cumsum([len(layer.arrays.row) for layer in layers]).tolist()]

    def triangles(self, pixels: NDArray, which: NDArray, view: NDArray) -> NDArray[np.int32]:
        """The nearest triangle seen at each of ``pixels[which]``, -1 = none."""
        rays = np.empty((len(which), 6), np.float32)
        pack_rays(pixels, which, view, rays)
        if len(self._layers) == 1:  # the invalid id, all bits set, becomes -1
            answer = self._layers[0].scene.cast_rays(self._tensor(rays), nthreads=1)
            return answer["primitive_ids"].numpy().view(np.int32)
        best, nearest = np.full(len(which), -1, np.int32), np.full(len(which), np.inf, np.float32)
        for layer, first in zip(self._layers, self._first, strict=False):
            answer = layer.scene.cast_rays(self._tensor(rays), nthreads=1)
            distance = answer["t_hit"].numpy()
            nearer = distance < nearest
            best[nearer] = answer["primitive_ids"].numpy()[nearer].astype(np.int32) + np.int32(first)
            nearest[nearer] = distance[nearer]
        return best

    def hits(
        self, pixels: NDArray, triangle: NDArray, view: NDArray, light: LightArrays
    ) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.bool_]]:
        n = len(pixels)
        depth, group, facing = np.zeros(n), np.full(n, -1, np.int32), np.zeros(n, np.bool_)
        for layer, first in zip(self._layers, self._first, strict=False):
            hit_points(layer.arrays, first, view, pixels, triangle, light, depth, group, facing)
        return depth, group, facing

    def sunlit(
        self, pixels: NDArray, depth: NDArray, which: NDArray, view: NDArray, light: LightArrays
    ) -> NDArray[np.bool_]:
        """Whether nothing stands between the sun and the points seen at ``pixels[which]``."""
        rays = np.empty((len(which), 6), np.float32)
        pack_rays(pixels, which, view, rays)
        pack_shadow_rays(rays, depth, which, light.sun, rays)
        blocked = np.zeros(len(which), np.bool_)
        for layer in self._layers:
            if len(which):
                blocked |= layer.scene.test_occlusions(self._tensor(rays), nthreads=1).numpy()
        return ~blocked

    def shaded(
        self,
        pixels: NDArray,
        triangle: NDArray,
        depth: NDArray,
        lit: NDArray,
        view: NDArray,
        light: LightArrays,
        footprint: float,
    ) -> NDArray[np.float32]:
        radiance = np.empty((len(pixels), 3), np.float32)
        for layer, first in zip(self._layers, self._first, strict=False):
            shade(layer.arrays, first, light, view, footprint, pixels, triangle, depth, lit, radiance)
        return radiance

    def samples(self, pixels: NDArray, view: NDArray, light: LightArrays) -> NDArray[np.float32]:
        """Radiance at single points of the image, each half a pixel wide."""
        every = np.arange(len(pixels))
        triangle = self.triangles(pixels, every, view)
        depth, _, lit = self.hits(pixels, triangle, view, light)
        sunny = np.flatnonzero(lit)
        lit[sunny] = self.sunlit(pixels, depth, sunny, view, light)
        return self.shaded(pixels, triangle, depth, lit, view, light, 0.5)


@lru_cache(maxsize=4)
def _grid(h: int, w: int) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(u, v) of all pixels ``(h * w, 2)``, and the indices of the even squares of the chessboard. Not to be written
    to."""
    y, x = np.divmod(np.arange(h * w), w)
    return np.stack([x, y], axis=1).astype(np.float64), np.flatnonzero((x + y) % 2 == 0)


def _view(T_W_C: NDArray[np.float64], camera: PinholeCamera) -> NDArray[np.float64]:
    """``(4, 3)``, world axes: the camera's centre, the ray of pixel (0, 0), its change from one column and one row to
    the next. Rays have length 1 along the optical axis, so that a ray's parameter is the depth."""
    R = T_W_C[:3, :3]
    across, down = R[:, 0] / camera.fx, R[:, 1] / camera.fy
    return np.stack([T_W_C[:3, 3], R[:, 2] - camera.cx * across - camera.cy * down, across, down])


def scene_arrays(world: World, mesh: Mesh) -> SceneArrays:
    """Per-triangle gradients of uv and normals over each triangle's plane, by its dual basis."""
    p = mesh.vertices[:, 0]
    e1, e2 = mesh.vertices[:, 1] - p, mesh.vertices[:, 2] - p
    cross = np.cross(e1, e2)
    square = np.maximum((cross**2).sum(axis=1, keepdims=True), 1e-24)
    dual1, dual2 = np.cross(e2, cross) / square, np.cross(cross, e1) / square

    def gradient(values: NDArray) -> NDArray:
        d1, d2 = values[:, 1] - values[:, 0], values[:, 2] - values[:, 0]
        return d1[:, :, None] * dual1[:, None] + d2[:, :, None] * dual2[:, None]

    n = len(mesh)
    row = np.concatenate(
        [
            p,
            cross / np.sqrt(square),
            mesh.uv[:, 0],
            gradient(mesh.uv).reshape(n, 6),
            mesh.normals[:, 0],
            gradient(mesh.normals).reshape(n, 9),
            mesh.tint,
        ],
        axis=1,
    )
    atlas = world.atlas
    return SceneArrays(
        row,
        mesh.material,
        mesh.group,
        mesh.zone,
        atlas.texels,
        atlas.table,
        atlas.texel_m,
        atlas.clamped,
        atlas.materials,
        (np.arange(257) / 255.0) ** 2.2,
        world.lamps,
        world.zone_lamps,
        world.sky_texture,
    )
