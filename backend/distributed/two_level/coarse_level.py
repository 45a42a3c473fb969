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

# What nothing ties still needs an equation.
_FLOOR = 1e-9


class CoarseLevel:
    """``knots`` of each robot in the order of ``members``, ``springs`` between them.

    ``held``: (robot, knot) that stays; ``fixed``: robots whose unit is no variable.
    """

    def __init__(
        self,
        knots: Mapping[int, Knots],
        springs: Sequence[Springs],
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
        matrix = self._assembled(self._elements(knots, springs))
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

    def _elements(
        self, knots: Mapping[int, Knots], springs: Sequence[Springs]
    ) -> list[tuple[NDArray[np.intp], Array, Array, Array]]:
        """Knots ``(m, 4)`` and their signed weights ``(m, 4)``, points ``(m, 3)``, stiffness ``(m, 3)``."""
        out = []
        for robot, own in sorted(knots.items()):
            linked = np.flatnonzero(own.links.any(axis=1)[:-1]) if len(own.centres) else np.zeros(0, dtype=np.intp)
            at = self.start[robot] + linked
            pair = np.stack([at, at + 1, at, at], axis=1)
            sign = np.tile([-1.0, 1.0, 0.0, 0.0], (len(at), 1))
            # The track is taken as straight, its mass at both ends and in the middle.
            for share in (0.0, 0.5, 1.0):
                point = (1.0 - share) * own.centres[linked] + share * own.centres[linked + 1]
                out.append((pair, sign, point, own.links[linked] / 3.0))
        for s in springs:
            index, weight = [], []
            for end, sign_ in zip(s.ends, (-1.0, 1.0), strict=True):
                base = np.array([self.start[r] for r in end.robot.tolist()], dtype=np.intp) + end.knot
                index += [base, np.where(end.weight > 0, base + 1, base)]
                weight += [sign_ * (1.0 - end.weight), sign_ * end.weight]
            out.append((np.stack(index, axis=1), np.stack(weight, axis=1), s.point, s.stiffness))
        return out

    def _assembled(self, elements: list[tuple[NDArray[np.intp], Array, Array, Array]]) -> csc_array:
        width, n = self._width, len(self.centres) * self._width
        rows, columns, values = [], [], []
        for index, weight, point, stiffness in elements:
            if not len(index):
                continue
            scale = np.repeat(stiffness, (3, 3, 1), axis=1)[:, :width]
            jacobians = [
                weight[:, a, None, None] * arms(point, self.centres[index[:, a]], width) for a in range(4)
            ]
            for a in range(4):
                for b in range(4):
                    block = np.swapaxes(jacobians[a], 1, 2) @ (scale[:, :, None] * jacobians[b])
                    r = index[:, a, None, None] * width + np.arange(width)[None, :, None]
                    c = index[:, b, None, None] * width + np.arange(width)[None, None, :]
                    rows.append(np.broadcast_to(r, block.shape).ravel())
                    columns.append(np.broadcast_to(c, block.shape).ravel())
                    values.append(block.ravel())
        if not rows:
            return csc_array((n, n))
        entries = (np.concatenate(values), (np.concatenate(rows), np.concatenate(columns)))
        return coo_array(entries, shape=(n, n)).tocsc()
