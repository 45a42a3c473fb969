"""What a robot tells of its part of the coarse level: its knots, the track between them, and edges that tie them to
others.

Everything is a spring between points that go with knots. Root and robots use the same rounded centres and weights, so
rounding changes no motion of all robots together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError
from ...geometry import Array
from ..compact import CompactReader, CompactWriter
from .coded_places import by_number
from .knots import weight_bytes, weights_from

_LARGEST = 6e4
_LARGEST_BYTE = 127.0
# A factor's diagonal is at least so many steps of a byte.
_FEWEST_STEPS = 12.0


def rounded(points: Array) -> Array:
    """Points ``(n, 3)`` as they are sent, in half precision."""
    return np.asarray(np.clip(points, -_LARGEST, _LARGEST).astype(np.float16), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SpringEnd:
    """One end of a spring: ``robot`` ``(m,)``, ``knot`` ``(m,)`` before it, ``weight`` ``(m,)`` of the one after."""

    robot: NDArray[np.intp]
    knot: NDArray[np.intp]
    weight: Array


@dataclass(frozen=True, eq=False)
class Springs:
    """Edges between two ends that go with knots, at a point between them ``(m, 3)``; ``stiffness`` ``(m, 3)`` of
    shift, turn and log unit."""

    ends: tuple[SpringEnd, SpringEnd]
    point: Array
    stiffness: Array


@dataclass(frozen=True, eq=False)
class Knots:
    """A robot's knots: ``centres`` ``(k, 3)``; ``sigmas`` ``(3,)``: deviations of a shift, a turn and a log unit;
    ``shared``: poses that neighbours know.

    ``linked`` ``(l,)``: knots from which a track leads to the next one, ``links`` ``(l, w, w)``: the stiffness of that
    track, of the difference of both knots' motions about the point between them.
    """

    centres: Array
    linked: NDArray[np.intp]
    links: Array
    sigmas: Array
    shared: int


def write_knots(out: CompactWriter, knots: Knots) -> None:
    """Append them; the factors of the tracks' stiffness, of motions in deviations, in bytes where these are fine enough
    for all, else in half precision."""
    out.count(len(knots.centres))
    out.count(knots.shared)
    out.array(knots.sigmas, "<f4")
    out.array(knots.centres, "<f2")
    has = np.zeros(len(knots.centres), dtype=bool)
    has[knots.linked] = True
    out.array(np.packbits(has).astype(np.float64), "u1")
    size, lower, in_bytes = _factors(knots)
    out.count(in_bytes)
    out.array(size, "<f4")
    out.array(np.rint(_LARGEST_BYTE * lower) if in_bytes else lower, "<i1" if in_bytes else "<f2")


def read_knots(source: CompactReader, width: int) -> Knots:
    """Inverse of :func:`write_knots`."""
    count, shared = source.count(), source.count()
    sigmas = source.array(3, "<f4")
    if not (sigmas > 0).all():
        raise BackendError("a robot's deviations are not positive")
    centres = source.array(3 * count, "<f2").reshape(-1, 3)
    has = np.unpackbits(source.array(-(-count // 8), "u1").astype(np.uint8), count=count)
    linked = np.flatnonzero(has)
    if len(linked) and linked[-1] + 1 >= count:
        raise BackendError("a track leads from a robot's last knot to none")
    in_bytes = source.count()
    size = source.array(len(linked), "<f4")
    rows, columns = np.tril_indices(width)
    numbers = source.array(len(linked) * len(rows), "<i1" if in_bytes else "<f2").reshape(-1, len(rows))
    lower = np.zeros((len(linked), width, width))
    lower[:, rows, columns] = numbers / (_LARGEST_BYTE if in_bytes else 1.0) * size[:, None]
    lower /= by_number(sigmas, width)[:, None]
    return Knots(centres, linked, lower @ np.swapaxes(lower, 1, 2), sigmas, shared)


def _factors(knots: Knots) -> tuple[Array, Array, bool]:
    """Of tracks' stiffnesses ``(l, w, w)`` in deviations: the largest number of each factor, its lower triangle over
    that, and whether bytes say it well enough."""
    width = knots.links.shape[1]
    sigma = by_number(knots.sigmas, width)
    links = knots.links * np.outer(sigma, sigma)
    lower = np.linalg.cholesky(links) if len(links) else links
    rows, columns = np.tril_indices(width)
    found = lower[:, rows, columns]
    size = np.abs(found).max(axis=1, initial=1e-30).astype(np.float32)
    smallest = (np.diagonal(lower, axis1=1, axis2=2) / size[:, None]).min(initial=1.0)
    return size, found / size[:, None], bool(smallest * _LARGEST_BYTE > _FEWEST_STEPS)


def write_springs(out: CompactWriter, springs: Springs, me: int, members: Sequence[int]) -> None:
    """Append those of robot ``me``, whose end is the first."""
    kinds, kind = np.unique(springs.stiffness.astype("<f4"), axis=0, return_inverse=True)
    out.count(len(springs.point))
    out.count(len(kinds))
    out.array(kinds, "<f4")
    a, b = springs.ends
    rank = {robot: k for k, robot in enumerate(members)}
    for k in range(len(springs.point)):
        out.count(int(kind[k]))
        out.count(int(a.knot[k]))
        out.count(rank[int(b.robot[k])])
        out.count(int(b.knot[k]))
    out.array(weight_bytes(a.weight).astype(np.float64), "u1")
    out.array(weight_bytes(b.weight).astype(np.float64), "u1")
    out.array(springs.point, "<f2")


def read_springs(source: CompactReader, sender: int, members: Sequence[int]) -> Springs:
    """Inverse of :func:`write_springs`."""
    count, kinds = source.count(), source.count()
    stiffness = source.array(3 * kinds, "<f4").reshape(-1, 3)
    if (stiffness < 0).any():
        raise BackendError("an edge's stiffness is negative")
    rows = [(source.count(), source.count(), source.count(), source.count()) for _ in range(count)]
    numbers = np.array(rows, dtype=np.intp).reshape(-1, 4)
    if count and (numbers[:, 0].max() >= kinds or numbers[:, 2].max() >= len(members)):
        raise BackendError("an edge of the coarse level names what is not there")
    mine, theirs = (weights_from(source.array(count, "u1").astype(np.uint8)) for _ in range(2))
    point = source.array(3 * count, "<f2").reshape(-1, 3)
    a = SpringEnd(np.full(count, sender, dtype=np.intp), numbers[:, 1], mine)
    b = SpringEnd(np.array(members, dtype=np.intp)[numbers[:, 2]], numbers[:, 3], theirs)
    return Springs((a, b), point, stiffness[numbers[:, 0]])


def needed(springs: Sequence[Springs]) -> dict[int, list[tuple[int, int]]]:
    """For each robot the knots ``(robot, knot)`` of others that move poses it shares edges with, in order."""
    out: dict[int, set[tuple[int, int]]] = {}
    for s in springs:
        for mine, theirs in (s.ends, s.ends[::-1]):
            for me, robot, knot, weight in zip(
                mine.robot.tolist(), theirs.robot.tolist(), theirs.knot.tolist(), theirs.weight.tolist(), strict=True
            ):
                if me != robot:
                    wanted = out.setdefault(me, set())
                    if weight < 1:
                        wanted.add((robot, knot))
                    if weight > 0:
                        wanted.add((robot, knot + 1))
    return {robot: sorted(found) for robot, found in out.items()}


def check(springs: Springs, knots: Mapping[int, Knots]) -> None:
    """:class:`BackendError` where an end goes with a knot that its robot has not."""
    for end in springs.ends:
        for robot, knot, weight in zip(end.robot.tolist(), end.knot.tolist(), end.weight.tolist(), strict=True):
            if robot not in knots or knot + (weight > 0) >= len(knots[robot].centres):
                raise BackendError(
                    f"an edge of the coarse level goes with knot {knot} of robot {robot}, which has none"
                )
