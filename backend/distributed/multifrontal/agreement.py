"""What robots must know to eliminate in one order: who shares poses with whom, and the order; as bytes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from ...errors import BackendError
from ..compact import CompactReader, CompactWriter
from ..share import Share


def write_pairs(pairs: Mapping[tuple[int, int], int]) -> bytes:
    """Robots that share poses, with the number of these, as bytes."""
    out = CompactWriter()
    for (a, b), count in sorted(pairs.items()):
        for number in (a, b, count):
            out.count(number)
    return out.bytes()


def read_pairs(data: bytes, members: Iterable[int]) -> dict[tuple[int, int], int]:
    """Inverse of :func:`write_pairs`; both robots of a pair must be ``members``."""
    source, out, known = CompactReader(data), {}, set(members)
    while not source.empty:
        a, b = source.count(), source.count()
        if a not in known or b not in known:
            raise BackendError(f"robots {a} and {b}, said to share poses, are not both in the group")
        out[a, b] = source.count()
    return out


def write_order(order: Iterable[int], megabytes: float) -> bytes:
    """The order, and, where it is not 0, what keeps the group from it."""
    out = CompactWriter()
    out.rough(megabytes)
    for robot in order:
        out.count(robot)
    return out.bytes()


def read_order(data: bytes, share: Share) -> tuple[tuple[int, ...], float]:
    """Inverse of :func:`write_order` for the group of ``share``."""
    source, order = CompactReader(data), []
    megabytes = source.rough()
    while not source.empty:
        order.append(source.count())
    if tuple(sorted(order)) != share.members or order[-1] != share.anchor:
        raise BackendError(f"robot {share.robot} was sent an order that is not of its group's members")
    return tuple(order), megabytes
