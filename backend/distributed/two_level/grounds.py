"""How firmly held priors hold a robot's knots: the coarse level's springs to what stands still."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader, CompactWriter
from .coded_places import by_number
from .knots import Hats, arms


def grounds_of(hats: Hats, centres: Array, points: Array, stiffness: Array, width: int) -> Array:
    """Stiffness ``(k, w, w)`` of each knot's motion about its centre by priors at ``points`` ``(m, 3)``, which go with
    knots as their ``hats`` ``(m,)`` say; ``stiffness`` ``(m, 3)`` of shift, turn and log unit.

    What a prior holds is shared out between the knots on both sides of it, so that of a motion of all together nothing
    is lost.
    """
    out = np.zeros((len(centres), width, width))
    moved = hats.first >= 0
    diagonal = np.repeat(stiffness[moved], (3, 3, 1), axis=1)[:, :width]
    for knot, weight in hats.sides():
        k, w = knot[moved], weight[moved]
        arm = arms(points[moved], centres[k], width)
        np.add.at(out, k, w[:, None, None] * (np.swapaxes(arm, 1, 2) @ (diagonal[:, :, None] * arm)))
    return out


def write_grounds(out: CompactWriter, grounds: Array, sigmas: Array) -> None:
    """Append the knots that are held at all, and the lower triangles of these in deviations, single precision."""
    width = grounds.shape[1]
    held = np.asarray(grounds.any(axis=(1, 2)))
    out.array(np.packbits(held).astype(np.float64), "u1")
    unit = by_number(sigmas, width)
    rows, columns = np.tril_indices(width)
    out.array((grounds[held] * np.outer(unit, unit))[:, rows, columns], "<f4")


def read_grounds(source: CompactReader, count: int, sigmas: Array, width: int) -> Array:
    """Inverse of :func:`write_grounds`, of ``count`` knots."""
    held: NDArray[np.bool_] = np.unpackbits(source.array(-(-count // 8), "u1").astype(np.uint8), count=count) > 0
    rows, columns = np.tril_indices(width)
    numbers = source.array(int(held.sum()) * len(rows), "<f4").reshape(-1, len(rows))
    if not np.isfinite(numbers).all() or (numbers[:, rows == columns] < 0).any():
        raise BackendError("what holds a knot is no stiffness")
    lower = np.zeros((len(numbers), width, width))
    lower[:, rows, columns] = numbers
    unit = by_number(sigmas, width)
    out = np.zeros((count, width, width))
    out[held] = (lower + np.swapaxes(np.tril(lower, -1), 1, 2)) / np.outer(unit, unit)
    return out
