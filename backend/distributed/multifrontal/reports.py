"""What robots tell each other between eliminations: contents and bytes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError
from ...geometry import Array
from ...pose_graph.graph import NodeId
from ..compact import CompactReader, CompactWriter, numbers_of, poses_of
from ..places import Places
from .boundary import Boundary, bounded
from .equations import Matrices, StepFrom, Unknowns, shape_of
from .shared_poses import read_function, write_function


@dataclass(frozen=True)
class Sums:
    """Over the robots eliminated so far: the present ``cost`` of their edges; ``gain``, by how much the problem would
    lower it; the largest weights of an edge; edges less poses; bytes of their matrices, and of all else in a pass;
    products of earlier moves (see :mod:`~maslam.backend.distributed.multifrontal.memory`)."""

    cost: float = 0.0
    gain: float = 0.0
    kappa: float = 0.0
    tau: float = 0.0
    freedom: int = 0
    matrices: int = 0
    others: int = 0
    products: tuple[float, ...] = ()

    def also(self, other: Sums) -> Sums:
        """These and another robot's."""
        return Sums(
            self.cost + other.cost,
            self.gain + other.gain,
            max(self.kappa, other.kappa),
            max(self.tau, other.tau),
            self.freedom + other.freedom,
            self.matrices + other.matrices,
            self.others + other.others,
            tuple(a + b for a, b in zip(self.products, other.products, strict=True)),
        )

    def write(self, out: CompactWriter) -> None:
        """Its bytes."""
        out.number(self.cost)
        for value in (self.gain, self.kappa, self.tau):
            out.rough(value)
        out.signed(self.freedom)
        out.count(self.matrices)
        out.count(self.others)
        out.count(len(self.products))
        out.array(np.array(self.products), "<f8")

    @classmethod
    def read(cls, source: CompactReader) -> Sums:
        """Inverse of :meth:`write`."""
        numbers = (source.number(), source.rough(), source.rough(), source.rough())
        counts = (source.signed(), source.count(), source.count())
        return cls(*numbers, *counts, tuple(source.array(bounded(source.count()), "<f8").tolist()))


@dataclass(frozen=True, eq=False)
class Update:
    """What a robot passes on: ``hessian`` ``(n, n)`` (None: as before) and ``b`` ``(n, c)`` of the problem left on its
    boundary, of whose numbers some are ``carried`` ``(n,)`` (see
    :class:`~maslam.backend.distributed.multifrontal.shared_poses.LocalCoordinates`); of a pass with nothing to solve
    the ``places`` of its own poses there."""

    sums: Sums
    hessian: Array | None
    b: Array
    carried: NDArray[np.bool_]
    boundary: Boundary | None = None
    places: Mapping[NodeId, Array] = field(default_factory=dict)

    def encode(self) -> bytes:
        """Its bytes."""
        out = CompactWriter()
        self.sums.write(out)
        if self.boundary is not None:
            self.boundary.write(out)
            out.count(len(self.places))
            for node, numbers in sorted(self.places.items()):
                out.count(node.robot)
                out.count(node.index)
                out.array(numbers, "<f8")
        out.array(self.b, "<f4")
        if self.hessian is not None:
            write_function(out, self.hessian, self.carried)
        return out.bytes()

    @classmethod
    def decode(
        cls, data: bytes, problem: Unknowns, carried: NDArray[np.bool_] | None, fresh: bool, scaled: bool
    ) -> Update:
        """Inverse of :meth:`encode`; ``carried`` None: the boundary comes with it."""
        source = CompactReader(data)
        sums = Sums.read(source)
        width, columns = shape_of(problem, scaled)
        boundary, places = None, {}
        if carried is None:
            boundary = Boundary.read(source)
            for _ in range(bounded(source.count())):
                node = NodeId(source.count(), source.count())
                places[node] = source.array(7, "<f8")
            carried = np.ones(len(boundary.nodes) * width, dtype=bool)
        b = source.array(len(carried) * columns, "<f4").reshape(len(carried), columns)
        hessian = read_function(source, carried) if fresh else None
        _whole(source)
        return cls(sums, hessian, b, carried, boundary, places)


@dataclass(frozen=True, eq=False)
class Step:
    """What a robot gets back: what follows, and the numbers of its boundary.

    ``next_problem``: None at the end. ``matrices``: which are passed on in it. ``place``: where it begins. ``cost``,
    ``cost_before`` and ``origin``, the anchor's own pose and log unit, come at the end. ``known`` ``(k,)``: poses that
    are tied to the anchor. ``grid``: sizes of whole steps, which begin at the mix of earlier passes by ``weights``.
    ``capped``: it ends because no more passes are allowed.
    """

    next_problem: Unknowns | None
    matrices: Matrices
    place: StepFrom
    cost: float
    cost_before: float
    origin: Array | None
    grid: tuple[float, float]
    known: NDArray[np.bool_]
    numbers: Array
    weights: tuple[float, ...] = ()
    capped: bool = False

    def encode(self, problem: Unknowns) -> bytes:
        """Its bytes; ``problem``: of the pass that it ends."""
        out = CompactWriter()
        code = 0 if self.next_problem is None else 1 + int(self.next_problem)
        out.count(code | self.matrices << 3 | self.place << 5 | (self.origin is not None) << 7)
        if self.next_problem is None:
            out.number(self.cost)
            out.number(self.cost_before)
            out.count(self.capped)
        if self.origin is not None:
            out.array(self.origin, "<f8")
        if self.next_problem is None or not self.place.moves:
            return out.bytes()
        lost = np.flatnonzero(~self.known).tolist()
        out.count(len(lost))
        for k in lost:
            out.count(k)
        if problem is Unknowns.POSE:
            for size in self.grid:
                out.rough(size)
            out.count(len(self.weights))
            out.array(np.array(self.weights), "<f4")
            out.steps(self.numbers.ravel().tolist())
        else:
            out.array(self.numbers, "<f8" if problem is Unknowns.KNOWN else "<f4")
        return out.bytes()

    @classmethod
    def decode(cls, data: bytes, problem: Unknowns, count: int, scaled: bool) -> Step:
        """Inverse of :meth:`encode`; ``count``: poses on the boundary."""
        source = CompactReader(data)
        code = source.count()
        if code >> 8 or code & 7 > 1 + max(Unknowns) or code >> 3 & 3 > max(Matrices):
            raise BackendError(f"an eliminating robot was sent a step of no kind: {code}")
        next_problem = None if not code & 7 else Unknowns((code & 7) - 1)
        matrices, place, sent = Matrices(code >> 3 & 3), StepFrom(code >> 5 & 3), bool(code >> 7 & 1)
        if matrices is Matrices.EXACT and next_problem is not Unknowns.POSE:
            raise BackendError("an eliminating robot was sent a step to second derivatives of what is linear")
        cost, before, capped = 0.0, 0.0, False
        if next_problem is None:
            cost, before, capped = source.number(), source.number(), bool(source.count())
        origin = source.array(7, "<f8") if sent else None
        known = np.ones(count, dtype=bool)
        numbers, grid, weights = np.zeros((0, 0)), (1.0, 1.0), np.zeros(0)
        if next_problem is not None and place.moves:
            lost = [source.count() for _ in range(bounded(source.count()))]
            if any(k >= count for k in lost):
                raise BackendError("an eliminating robot was sent a pose that it does not share")
            known[lost] = False
            width = columns_of(problem, scaled)
            if problem is Unknowns.POSE:
                grid = (source.rough(), source.rough())
                weights = source.array(bounded(source.count()), "<f4")
                numbers = np.array(source.steps(int(known.sum()) * width), dtype=np.float64).reshape(-1, width)
            else:
                numbers = source.array(int(known.sum()) * width, "<f8" if problem is Unknowns.KNOWN else "<f4")
                numbers = numbers.reshape(-1, width)
        _whole(source)
        mix = tuple(weights.tolist())
        return cls(next_problem, matrices, place, cost, before, origin, grid, known, numbers, mix, capped)


def columns_of(problem: Unknowns, scaled: bool) -> int:
    """Numbers of a pose that come back: of rotations and positions three."""
    match problem:
        case Unknowns.KNOWN:
            return 7
        case Unknowns.UNIT:
            return 1
        case Unknowns.POSE:
            return shape_of(problem, scaled)[0]
        case _:
            return 3


def sent(problem: Unknowns, places: Places, rows: NDArray[np.intp]) -> Array:
    """What comes back of ``rows`` in passes that look for places themselves: ``(k, columns)``."""
    match problem:
        case Unknowns.ROTATION:
            return numbers_of(places.poses[rows])[:, 3:]
        case Unknowns.UNIT:
            return places.log_units[rows][:, None]
        case Unknowns.POSITION:
            return places.poses[rows, :3, 3]
        case _:
            return places.at(rows).numbers(7)


def put_sent(problem: Unknowns, places: Places, rows: NDArray[np.intp], numbers: Array) -> None:
    """Inverse of :func:`sent`; in place."""
    match problem:
        case Unknowns.ROTATION:
            whole = np.concatenate([np.zeros((len(rows), 3)), numbers], axis=1)
            places.poses[rows, :3, :3] = poses_of(whole)[:, :3, :3]
        case Unknowns.UNIT:
            places.log_units[rows] = numbers[:, 0]
        case Unknowns.POSITION:
            places.poses[rows, :3, 3] = numbers
        case _:
            places.poses[rows] = poses_of(numbers[:, :6])
            places.log_units[rows] = numbers[:, 6]


def _whole(source: CompactReader) -> None:
    if not source.empty:
        raise BackendError("a message of an eliminating robot is longer than what it says")
