"""The kernels that the odometry of each rig calls, with their types: compiled before the first image, not at it."""

from __future__ import annotations

from collections.abc import Iterable

from numba import float32, float64, int8, int32, int64, types, uint8, uint64

from maslam._kernels import TypedKernel

from .cameras.models import RigKind
from .estimation import bundle_adjustment, depth_alignment, linear_algebra, schur, self_calibration
from .estimation.pose_refinement import SeenPoints, refine_pose
from .estimation.schur import Estimate, NormalEquations, Observations, Window
from .estimation.triangulation import triangulate
from .image import guided_matching, orb_features, patch_alignment
from .mapping import range_sensor
from .vocabulary import vocabulary

_f, _f1, _f2, _f3 = float64, float64[::1], float64[:, ::1], float64[:, :, ::1]
_i, _i1, _i2 = int64, int64[::1], int64[:, ::1]
_grey, _patches, _words = uint8[:, ::1], uint8[:, :, :, ::1], uint64[:, ::1]
_depth, _places = float32[:, ::1], float32[:, :, ::1]
_seen_points = types.NamedTuple((_f2, _f2, _f1, _f1, _f1), SeenPoints)
_observations = types.NamedTuple((_i1, _i1, _i1, _f2, _f1, _f1, _f1), Observations)
_window = types.NamedTuple((_i1, _observations, _f1, _f3, _f1, _f2), Window)
_estimate = types.NamedTuple((_f3, _f2, _f1), Estimate)
_equations = types.NamedTuple((_f2, _f1, _f3, _f2, _f3, _f3, _f3), NormalEquations)

_COMMON: tuple[TypedKernel, ...] = (
    (orb_features._spread, (_f2, _i1, _f2, _i, _i, _f, _i, _f)),
    (orb_features._orientation, (_grey, _f2)),
    (vocabulary._descend, (_words, int32[::1], int32[::1], _words, _i1)),
    (guided_matching._guided, (_f2, _f1, _words, _f2, int8[::1], _words, _f1, _i1, _i1, _i1, _f, _i, _f)),
    (patch_alignment._cut, (_grey, _f2, _i, _patches)),
    (patch_alignment._align_level, (_patches, _f2, _i, _grey, _f3, _f2, _f, _f)),
    (linear_algebra.solve_symmetric, (_f2, _f2)),
    (linear_algebra.weighted_gram, (_f2, _f1, _f2)),
    (self_calibration.basis, (_f2, _f1, _f1, _i)),
    (self_calibration.lens_shift, (_f2, _f1, _f1)),
    (refine_pose, (_f2, _seen_points, _f1, _f, _i)),
    (bundle_adjustment.window_residuals, (_f3, _f2, _i1, _i1, _f2, _f1, _f1)),
    (bundle_adjustment._residuals_and_cost, (_estimate, _window)),
    (bundle_adjustment._updated, (_f3, _i1, _f1)),
    (schur.assemble, (_estimate, _window, _f2, _equations)),
    (schur.reduce_points, (_i1, _i1, _i1, _equations, _f)),
    (schur.back_substitute, (_i1, _i1, _i1, _equations, _f1, _f2)),
)
_OF_RIG: dict[RigKind, tuple[TypedKernel, ...]] = {
    RigKind.MONO: ((triangulate, (_f3, _i1, _i1, _f2)),),
    RigKind.STEREO: ((range_sensor._search_rows, (_grey, _grey, _depth, _depth, _f2, _i, _i)),),
    RigKind.RGBD: (
        (range_sensor.depth_at, (_depth, _f2, _f)),
        (depth_alignment._average, (_depth, _f1, _i, _f, _places)),
        (depth_alignment._normals, (_places,)),
        (depth_alignment._point_to_plane, (_places, _places, _f2, _f1, _i, _f)),
        (depth_alignment._alignment_cost, (_f3, _i2, _f3, _f3, _f2, _f1)),
        (depth_alignment._add_alignment, (_f3, _i1, _i2, _f3, _f3, _f2, _f2, _f1)),
    ),
}


def odometry_kernels(rigs: Iterable[RigKind]) -> list[TypedKernel]:
    """Kernels of the odometry of these rigs, with the types that they are called with; what only a lost camera needs is
    compiled where that happens."""
    wanted = set(rigs)
    return [*(_COMMON if wanted else ()), *(kernel for rig in RigKind if rig in wanted for kernel in _OF_RIG[rig])]
