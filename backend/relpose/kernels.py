"""The kernels of geometric verification with their types: compiled before the first match, not at it."""

from __future__ import annotations

from numba import boolean, float64, int16, int64, uint64

from maslam._kernels import TypedKernel

from . import alignment, evidence, matching, ransac

_f, _f1, _f2, _f3 = float64, float64[::1], float64[:, ::1], float64[:, :, ::1]
_i, _i1, _i2 = int64, int64[::1], int64[:, ::1]
_words, _distances = uint64[:, ::1], int16[:, ::1]

VERIFICATION_KERNELS: tuple[TypedKernel, ...] = (
    (matching._hamming, (_words, _words)),
    (matching._nearest, (_distances,)),
    (matching._within, (_distances, _i)),
    (matching._mutual, (_i1, _i1, int16[::1], _i, _i)),
    (ransac._unlikeness, (_f2, _f2, _i2, boolean)),
    (ransac._agreeing, (_f3, _f2, _f1, _f2, _f2, _f1, _f1, _f, _f)),
    (alignment._gauss_newton, (_f2, _f2, _f2, _f1, _f, _i, _f, _f, _i)),
    (evidence._count, (_f2, _f2, _distances, boolean, _f1, _f, _f, _i, _f, _i, _f, _f, _f)),
)
