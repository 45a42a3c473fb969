"""The kernels that agents call, with their types: compiled before they meet."""

from __future__ import annotations

from numba import float64, int8, int64, uint8

from maslam._kernels import TypedKernel
from maslam.backend import refitting
from maslam.backend.relpose.kernels import VERIFICATION_KERNELS
from maslam.descriptors import search

from .map_exchange.coding import rice

_f, _f1, _f2, _f3 = float64, float64[::1], float64[:, ::1], float64[:, :, ::1]
_i, _i1, _i2 = int64, int64[::1], int64[:, ::1]

_EXCHANGE: tuple[TypedKernel, ...] = (
    (search._bounds, (int8[:, ::1], _f1, _f1, _f1, _f1, int8[::1], _f, _f, _f, _f, _f1)),
    (rice._encode, (_i1, _i1, _i2, uint8[::1])),
    (rice._decode, (uint8[::1], _i, _i1, _i2, _i1)),
)


_RESULTS: tuple[TypedKernel, ...] = ((refitting._refit, (_f2, _i1, _i1, _f2, _f3, _f2)),)


def agent_kernels(agents: int) -> list[TypedKernel]:
    """Of so many agents; a lone one verifies only its own loops, which may never come."""
    return [*VERIFICATION_KERNELS, *_EXCHANGE, *_RESULTS] if agents > 1 else [*_RESULTS]
