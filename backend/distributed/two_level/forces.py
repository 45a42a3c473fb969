"""Forces on a robot's knots, as it sends them to the root."""

from __future__ import annotations

import numpy as np

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader, CompactWriter
from ..places import SCALED
from .coded_places import by_number
from .codes import Steps, read_steps, write_steps

# Forces are whole steps of this share of a robot's largest at first; later by what is left to gain.
_FORCE_LEVELS = 2047
_WHOLE_ROBOT = 1.0 / 16.0


def write_forces(cost: float, forces: Array, centres: Array, sigmas: Array, resolution: float) -> bytes:
    """A robot's part of the cost, and the forces ``(k, w)`` on its knots at ``centres``, in whole steps.

    Each number is the force on all knots from one on, about that one's centre: what rounding adds is then a pull
    between two knots, not a push of the robot through the city, which little resists. ``resolution`` in the forces that
    move by a deviation; 0: a share of the largest.
    """
    unit = 1.0 / by_number(sigmas, forces.shape[1])
    whole = _summed_forces(forces, centres) / unit
    if resolution <= 0:
        resolution = float(np.abs(whole).max(initial=0.0)) / _FORCE_LEVELS
    out = CompactWriter()
    out.number(cost)
    scale = float(np.float32(resolution))
    out.rough(scale)
    steps = np.rint(whole / (scale * _finer(whole))) if scale > 0 else np.zeros(whole.shape)
    return out.bytes() + write_steps(steps.astype(np.int64), by_column=True)


def read_forces(data: bytes, centres: Array, sigmas: Array, width: int) -> tuple[float, Array]:
    """Inverse of :func:`write_forces`."""
    source = CompactReader(data)
    cost, scale = source.number(), source.rough()
    if not np.isfinite([cost, scale]).all() or scale < 0:
        raise BackendError("forces on knots, or their cost, that are not finite")
    steps = read_steps(source.rest(), len(centres), width, by_column=True)
    whole = scale * steps * _finer(steps) / by_number(sigmas, width)
    return cost, whole - _on_the_one_before(whole, centres)


def _finer(values: Array | Steps) -> Array:
    """``(k, 1)``: steps of the first knot, that is of the force on the whole robot, are finer."""
    out = np.ones((len(values), 1))
    out[:1] = _WHOLE_ROBOT
    return out


def _summed_forces(forces: Array, centres: Array) -> Array:
    out = forces.copy()
    for k in range(len(out) - 2, -1, -1):
        out[k] += _on_the_one_before(out[k : k + 2], centres[k : k + 2])[0]
    return out


def _on_the_one_before(forces: Array, centres: Array) -> Array:
    """Each knot's force about the centre of the one before; of the last knot there is none after it: 0."""
    out = np.zeros(forces.shape)
    arm = centres[1:] - centres[:-1]
    out[:-1] = forces[1:]
    out[:-1, 3:6] += np.cross(arm, forces[1:, :3])
    if forces.shape[1] == SCALED:
        out[:-1, 6] += (arm * forces[1:, :3]).sum(axis=1)
    return out
