"""Views of a world: rays by open3d (Embree), shading by compiled kernels, anti-aliased where surfaces break."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from frontend.cameras import PinholeCamera
from tools.worlds.kernels import LightArrays, SceneArrays, edge_pixels, hit_points, shade
from tools.worlds.light import Light
from tools.worlds.mesh import Mesh
from tools.worlds.world import World

SAMPLES = ((-0.375, -0.125), (0.125, -0.375), (0.375, 0.125), (-0.125, 0.375))
"""Rotated grid of the samples taken of a pixel on an edge, pixels from its centre."""


@dataclass(frozen=True)
class View:
    """``radiance`` ``(H, W, 3)`` float32, linear RGB, before the sensor; ``depth_m`` ``(H, W)`` float64 metres along +Z at the pixel
    centres, exact, 0 = sky; ``triangle`` ``(H, W)`` int32 of the mesh, -1 = sky."""

    radiance: NDArray[np.float32]
    depth_m: NDArray[np.float64]
    triangle: NDArray[np.int32]


class Renderer:
    """Ray casting of one world. Construction loads open3d and sorts the triangles; ``render`` may be called from several threads."""

    def __init__(self, world: World) -> None:
        import open3d as o3d

        self._o3d = o3d
        self.world = world
        mesh = world.mesh
        self._scene = o3d.t.geometry.RaycastingScene(1)
        faces = np.arange(3 * len(mesh), dtype=np.uint32).reshape(-1, 3)
        vertices = np.ascontiguousarray(mesh.vertices.reshape(-1, 3), np.float32)
        self._scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
        self._arrays = scene_arrays(world, mesh)

    def render(self, T_W_C: NDArray[np.float64], camera: PinholeCamera, light: Light, movers: Mesh | None = None) -> View:
        """The view of ``camera`` at pose ``T_W_C`` ``(4, 4)``. The same arguments give the same bytes."""
        h, w = camera.height, camera.width
        R, origin = np.ascontiguousarray(T_W_C[:3, :3]), np.ascontiguousarray(T_W_C[:3, 3])
        step_x, step_y = np.ascontiguousarray(R[:, 0] / camera.fx), np.ascontiguousarray(R[:, 1] / camera.fy)
        u, v = np.meshgrid(np.arange(w, dtype=np.float64), np.arange(h, dtype=np.float64))
        rays = _rays(u.ravel(), v.ravel(), camera, R)
        lights = light.arrays()
        radiance, depth, triangle, lit = self._trace(origin, rays, lights, step_x, step_y)
        edges = edge_pixels(self._arrays.group, triangle, depth, lit, h, w)
        if len(edges):
            offsets = np.array(SAMPLES)
            eu = ((edges % w)[:, None] + offsets[:, 0]).ravel()
            ev = ((edges // w)[:, None] + offsets[:, 1]).ravel()
            fine, *_ = self._trace(origin, _rays(eu, ev, camera, R), lights, step_x / 2, step_y / 2)
            radiance[edges] = fine.reshape(len(edges), len(offsets), 3).mean(axis=1)
        return View(radiance.reshape(h, w, 3), depth.reshape(h, w), triangle.reshape(h, w))

    def _trace(self, origin: NDArray, rays: NDArray, light: LightArrays, step_x: NDArray, step_y: NDArray
               ) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.int32], NDArray[np.bool_]]:  # fmt: skip
        n = len(rays)
        packed = np.empty((n, 6), np.float32)
        packed[:, :3], packed[:, 3:] = origin, rays
        ids = self._scene.cast_rays(self._o3d.core.Tensor(packed), nthreads=1)["primitive_ids"].numpy()
        triangle = ids.astype(np.int32)  # the invalid id, all bits set, becomes -1
        depth, lit = np.empty(n), np.zeros(n, np.bool_)
        shadow_of = np.empty(n, np.int64)
        count = hit_points(self._arrays, origin, rays, triangle, light, depth, packed, shadow_of)
        if count:
            blocked = self._scene.test_occlusions(self._o3d.core.Tensor(packed[:count]), nthreads=1).numpy()
            lit[shadow_of[:count]] = ~blocked
        radiance = np.empty((n, 3), np.float32)
        shade(self._arrays, light, origin, rays, triangle, depth, lit, step_x, step_y, radiance)
        return radiance, depth, triangle, lit


def _rays(u: NDArray[np.float64], v: NDArray[np.float64], camera: PinholeCamera, R: NDArray[np.float64]) -> NDArray[np.float64]:
    """World directions of pixels, of length 1 along the optical axis, so that a ray's parameter is the depth."""
    d = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=1)
    return d @ R.T


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

    atlas = world.atlas
    linear = (np.arange(257) / 255.0) ** 2.2
    return SceneArrays(
        np.ascontiguousarray(p), cross / np.sqrt(square), np.ascontiguousarray(mesh.uv[:, 0]), gradient(mesh.uv),
        np.ascontiguousarray(mesh.normals[:, 0], np.float32), gradient(mesh.normals).astype(np.float32),
        mesh.material, mesh.tint.astype(np.float32), mesh.group, mesh.zone,
        atlas.texels, atlas.table, atlas.texel_m, atlas.clamped, atlas.materials, linear.astype(np.float32),
        world.lamps, world.zone_lamps, world.sky_texture,
    )  # fmt: skip
