"""The coarse level at the root: all robots' knots, and the step that moves them best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, diags
from scipy.sparse.linalg import splu

from ...geometry import Array
from ..places import SCALED
from .knots import arms
from .springs import Knots, Springs, check

# Of springs: knots ``(m, c)`` and their signed weights, points ``(m, 3)`` and stiffness ``(m, w, w)`` there.
_Element = tuple[NDArray[np.intp], Array, Array, Array]
# What nothing ties still needs an equation.
_FLOOR = 1e-9


class CoarseLevel:
    """``knots`` of each robot in the order of ``members``, ``springs`` between them; ``grounds`` ``(k, w, w)``: what
    holds each of a robot's knots by itself.

    ``held``: (robot, knot) that stays; ``fixed``: robots whose unit is no variable.
    """

    def __init__(
        self,
        knots: Mapping[int, Knots],
        springs: Sequence[Springs],
        grounds: Mapping[int, Array],
        width: int,
        held: tuple[int, int] | None,
        fixed: frozenset[int],
    ) -> None:
        for s in springs:
            check(s, knots)
        self._width = width
        robots = sorted(knots)
        counts = [len(knots[r].centres) for r in robots]
        starts = np.concatenate([[0], np.cumsum(counts)]).astype(np.intp)
        self.start = dict(zip(robots, starts[:-1].tolist(), strict=True))
        self.count = dict(zip(robots, counts, strict=True))
        self.centres = np.concatenate([knots[r].centres for r in robots])
        free = np.ones((len(self.centres), width), dtype=bool)
        if held is not None and self.count.get(held[0], 0) > held[1]:
            free[self.start[held[0]] + held[1]] = False
        if width == SCALED:
            for r in fixed & set(robots):
                free[self.start[r] : self.start[r] + self.count[r], 6] = False
        self._free = np.flatnonzero(free.ravel())
        elements = [*self._tracks(knots), *self._edges(springs), *self._held(grounds)]
        matrix = self._assembled(elements)
        inner = csc_array(matrix[self._free][:, self._free])
        diagonal = inner.diagonal()
        inner = csc_array(inner + diags(_FLOOR * diagonal + np.where(diagonal > 0, 0.0, 1.0)))
        self._factor = splu(inner) if len(self._free) else None

    def step(self, forces: Array) -> Array:
        """The knots' moves ``(k, w)`` under ``forces`` ``(k, w)`` on them."""
        out = np.zeros(forces.size)
        if self._factor is not None:
            out[self._free] = self._factor.solve(forces.ravel()[self._free])
        return out.reshape(forces.shape)

    def _tracks(self, knots: Mapping[int, Knots]) -> list[_Element]:
        out = []
        for robot, own in sorted(knots.items()):
            at = self.start[robot] + own.linked
            pair = np.stack([at, at + 1], axis=1)
            middle = 0.5 * (self.centres[at] + self.centres[at + 1])
            out.append((pair, np.tile([-1.0, 1.0], (len(at), 1)), middle, own.links))
        return out

    def _edges(self, springs: Sequence[Springs]) -> list[_Element]:
        out = []
        for s in springs:
            index, weight = [], []
            for end, sign_ in zip(s.ends, (-1.0, 1.0), strict=True):
                base = np.array([self.start[r] for r in end.robot.tolist()], dtype=np.intp) + end.knot
                index += [base, np.where(end.weight > 0, base + 1, base)]
                weight += [sign_ * (1.0 - end.weight), sign_ * end.weight]
            out.append((np.stack(index, axis=1), np.stack(weight, axis=1), s.point, self._isotropic(s.stiffness)))
        return out

    def _held(self, grounds: Mapping[int, Array]) -> list[_Element]:
        out = []
        for robot, own in sorted(grounds.items()):
            at = self.start[robot] + np.arange(len(own), dtype=np.intp)
            out.append((at[:, None], np.ones((len(at), 1)), self.centres[at], own))
        return out

    def _isotropic(self, stiffness: Array) -> Array:
        """Matrices ``(m, w, w)`` of the stiffness of shift, turn and log unit ``(m, 3)``."""
        out = np.zeros((len(stiffness), self._width, self._width))
        out[:, range(self._width), range(self._width)] = np.repeat(stiffness, (3, 3, 1), axis=1)[:, : self._width]
        return out

    def _assembled(self, elements: list[_Element]) -> csc_array:
        width, n = self._width, len(self.centres) * self._width
        rows, columns, values = [], [], []
        for index, weight, point, stiffness in elements:
            if not len(index):
                continue
            sides = range(index.shape[1])
            jacobians = [weight[:, a, None, None] * arms(point, self.centres[index[:, a]], width) for a in sides]
            for a in sides:
                for b in sides:
                    block = np.swapaxes(jacobians[a], 1, 2) @ stiffness @ jacobians[b]
                    r = index[:, a, None, None] * width + np.arange(width)[None, :, None]
                    c = index[:, b, None, None] * width + np.arange(width)[None, None, :]
                    rows.append(np.broadcast_to(r, block.shape).ravel())
                    columns.append(np.broadcast_to(c, block.shape).ravel())
                    values.append(block.ravel())
        if not rows:
            return csc_array((n, n))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return coo_array(entries, shape=(n, n)).tocsc()
