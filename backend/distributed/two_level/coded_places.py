"""Places of the poses that robots share, as whole steps: each from the one before, as they follow one another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader, CompactWriter
from ..local import LocalProblem
from ..places import Places, places_of
from .codes import Steps, read_steps, write_steps

# Steps of one deviation.
_FINENESS = 16.0
# Share of the others' stiffness below which an edge hardly holds.
_FIRM = 0.01
# An edge that costs less may well be as it should be.
_FAR = 1e4
# Whole steps beyond this do not travel; coarser ones do.
_LARGEST = 2.0**28


def stiffness_of(problem: LocalProblem) -> Array:
    """Of shift, turn and log unit ``(m, 3)`` of each edge."""
    e = problem.edges
    tau = e.tau * np.exp(-2.0 * np.nan_to_num(problem.places.log_units[e.ends[:, 0]]))
    return np.stack([tau, 2.0 * e.kappa, e.precision], axis=1)


def deviations_of(problem: LocalProblem) -> Array:
    """``(3,)``: of a shift, a turn and a log unit, as most of a robot's edges have them, as they are sent."""
    weights = stiffness_of(problem)
    weights = weights[(weights > 0).all(axis=1) & ~problem.outside]
    if not len(weights):
        return np.ones(3)
    return np.asarray((np.median(weights, axis=0) ** -0.5).astype(np.float32), dtype=np.float64)


def firm_edges(problem: LocalProblem) -> NDArray[np.bool_]:
    """Edges ``(m,)`` that hold as most do: others join no track, as poses on both sides of them move by themselves."""
    weights = stiffness_of(problem)
    if problem.outside.all():
        return np.zeros(len(weights), dtype=bool)
    firm = weights >= _FIRM * np.median(weights[~problem.outside], axis=0)
    return np.asarray(firm.all(axis=1) & ~problem.outside, dtype=bool)


def close_to(problem: LocalProblem, neighbour: int) -> bool:
    """Whether edges with a neighbour may not be violated so much that their cost says all as it is."""
    theirs = np.asarray(np.isin(problem.edges.ends, problem.received_rows[neighbour]).any(axis=1), dtype=bool)
    costs = problem.edges.only(theirs).costs(problem.places.poses, problem.places.log_units)
    return bool((costs < _FAR).any())


def by_number(sigmas: Array, width: int) -> Array:
    """``(w,)``: the deviation of each number of a move, from those of shift, turn and log unit."""
    return np.repeat(sigmas, (3, 3, 1))[:width]


@dataclass(frozen=True, eq=False)
class CodedPlaces:
    """``steps`` ``(n, w)`` of places of which ``known`` ``(n,)`` are; ``sizes`` ``(3,)`` of steps of a shift, a turn
    and a log unit."""

    steps: Steps
    known: NDArray[np.bool_]
    sizes: Array

    @classmethod
    def of(cls, places: Places, known: NDArray[np.bool_], sigmas: Array, width: int) -> CodedPlaces:
        """The steps nearest to ``places``."""
        numbers = np.where(known[:, None], np.nan_to_num(places.numbers(width)), 0.0)
        sizes = np.asarray((sigmas / _FINENESS).astype(np.float32), dtype=np.float64)
        while np.abs(numbers / by_number(sizes, width)).max(initial=0.0) > _LARGEST:
            sizes = 2.0 * sizes
        return cls(np.rint(numbers / by_number(sizes, width)).astype(np.int64), known, sizes)

    def at(self, rows: NDArray[np.intp]) -> CodedPlaces:
        """Some of them."""
        return CodedPlaces(self.steps[rows], self.known[rows], self.sizes)

    @property
    def places(self) -> Places:
        """Where the steps lead, of those that are known."""
        return places_of(self.steps[self.known] * by_number(self.sizes, self.steps.shape[1]))

    def encode(self) -> bytes:
        """Bytes; none where none is known."""
        if not self.known.any():
            return b""
        out = CompactWriter()
        out.array(np.packbits(self.known).astype(np.float64), "u1")
        out.array(self.sizes, "<f4")
        steps = self.steps[self.known]
        out.steps(steps[0].tolist())
        return out.bytes() + write_steps(np.diff(steps, axis=0), by_column=True)

    @classmethod
    def decode(cls, data: bytes, count: int, width: int) -> CodedPlaces:
        """Inverse of :meth:`encode` for ``count`` places."""
        steps, known = np.zeros((count, width), dtype=np.int64), np.zeros(count, dtype=bool)
        if not data:
            return cls(steps, known, np.ones(3))
        source = CompactReader(data)
        bits = source.array(-(-count // 8), "u1").astype(np.uint8)
        known = np.unpackbits(bits, count=count).astype(bool)
        sizes = source.array(3, "<f4")
        if not known.any() or not (sizes > 0).all():
            raise BackendError("places in steps that are none")
        first = np.array([source.steps(width)], dtype=np.int64)
        rest = read_steps(source.rest(), int(known.sum()) - 1, width, by_column=True)
        steps[known] = np.cumsum(np.concatenate([first, rest]), axis=0)
        return cls(steps, known, sizes)
