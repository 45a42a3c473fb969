"""Contents of a map and the memory they take."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .map import Map, MapKeyFrame

_ROW = 1000  # as large as a row of a key-frame: an integer object of its own


@dataclass(frozen=True)
class Footprint:
    """``keyframes`` that stand, ``culled`` ones of which the pose is left, ``points`` alive, ``numbers`` of points
    given so far, ``observations``; all of it together in ``bytes``."""

    keyframes: int
    culled: int
    points: int
    numbers: int
    observations: int
    bytes: int

    def __add__(self, other: Footprint) -> Footprint:
        return Footprint(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))


EMPTY = Footprint(0, 0, 0, 0, 0, 0)


def footprint(map_: Map) -> Footprint:
    """Counts of ``map_`` and its bytes in memory: those of its arrays and lists as Python keeps them, spare room
    included."""
    observations = sum(map(len, map_.observers))
    size = sum(value.nbytes for value in vars(map_).values() if isinstance(value, np.ndarray))
    size += sys.getsizeof(map_.observers) + sum(map(sys.getsizeof, map_.observers))
    size += observations * (sys.getsizeof((0, 0)) + sys.getsizeof(_ROW))
    size += sys.getsizeof(map_.keyframes) + sys.getsizeof(map_.culled)
    size += sum(map(_keyframe_bytes, map_.keyframes.values()))
    size += sum(sys.getsizeof(gone) + _array_bytes(gone.T_C_P) for gone in map_.culled.values())
    return Footprint(len(map_.keyframes), len(map_.culled), int(map_.alive.sum()), len(map_), observations, size)


def _keyframe_bytes(keyframe: MapKeyFrame) -> int:
    values = vars(keyframe)
    arrays = sum(_array_bytes(value) for value in values.values() if isinstance(value, np.ndarray))
    return sys.getsizeof(keyframe) + sys.getsizeof(values) + arrays


def _array_bytes(value: NDArray[Any]) -> int:
    """With its header, and with all of what it is a view of."""
    whole = value if value.base is None else value.base
    return sys.getsizeof(value) + (whole.nbytes if value.base is not None else 0)
