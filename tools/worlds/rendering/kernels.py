"""The kernels that drawing calls, with their types: compiled before the workers that share them begin."""

from __future__ import annotations

from numba import boolean, float32, float64, int32, int64, types, uint8, uint16

from maslam._kernels import TypedKernel

from . import ray_kernels, sensor
from .shading_kernels import LightArrays, SceneArrays, shade

_f, _f1, _f2 = float64, float64[::1], float64[:, ::1]
_i, _i1, _ids, _flags = int64, int64[::1], int32[::1], boolean[::1]
_rays, _image = float32[:, ::1], float32[:, :, ::1]
_scene = types.NamedTuple(
    (_f2, _ids, _ids, _ids, uint8[::1], int64[:, :, ::1], _f2, _flags, int32[:, ::1], _f1, _f2, _i1, _i), SceneArrays
)
_light = types.NamedTuple((*(_f1,) * 8, _f), LightArrays)

RENDERING_KERNELS: tuple[TypedKernel, ...] = (
    (ray_kernels.pack_rays, (_f2, _i1, _f2, _rays)),
    (ray_kernels.odd_pixels, (_ids, _flags, _i, _i)),
    (ray_kernels.odd_pixels, (_flags, _ids, _i, _i)),
    (ray_kernels.hit_points, (_scene, _i, _f2, _f2, _ids, _light, _f1, _ids, _flags)),
    (ray_kernels.pack_shadow_rays, (_rays, _f1, _i1, _f1, _rays)),
    (shade, (_scene, _i, _light, _f2, _f, _f2, _ids, _f1, _flags, _rays)),
    (ray_kernels.edge_pixels, (_ids, _f1, _flags, _rays, _i, _i)),
    (sensor._develop, (_image, uint16[:, :, ::1], float32[::1], *(float32,) * 4, float32[::1], uint8[:, :, ::1])),
)
