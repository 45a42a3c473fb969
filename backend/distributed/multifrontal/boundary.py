"""What robots that eliminate must know of the poses that one of them leaves to the others; as bytes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import BackendError
from ...pose_graph.graph import NodeId
from ..compact import CompactReader, CompactWriter

_MOST = 1 << 20


@dataclass(frozen=True, eq=False)
class Boundary:
    """Poses that a robot does not eliminate, sorted, and what those who do must know.

    ``touching``: of each, the robots that still have edges with it. ``label`` ``(k,)``: equal for those that are joined
    by what is eliminated. ``robots``: how many are eliminated so far; ``below``: with how many of these each robot to
    come shares edges. ``grounded``: labels of what held priors hold.
    """

    nodes: tuple[NodeId, ...]
    touching: tuple[frozenset[int], ...]
    label: NDArray[np.intp]
    below: Mapping[int, int]
    robots: int
    grounded: frozenset[int] = frozenset()

    def write(self, out: CompactWriter) -> None:
        """Its bytes."""
        out.count(self.robots)
        out.count(len(self.nodes))
        robot = index = 0
        for node, touching, label in zip(self.nodes, self.touching, self.label.tolist(), strict=True):
            index = index if node.robot == robot else 0
            out.signed(node.robot - robot)
            out.signed(node.index - index)
            robot, index = node.robot, node.index
            out.count(label)
            out.count(len(touching))
            for other in sorted(touching):
                out.count(other)
        out.count(len(self.below))
        for other, count in sorted(self.below.items()):
            out.count(other)
            out.count(count)
        out.count(len(self.grounded))
        for part in sorted(self.grounded):
            out.count(part)

    @classmethod
    def read(cls, source: CompactReader) -> Boundary:
        """Inverse of :meth:`write`."""
        robots = source.count()
        nodes, touching, label = [], [], []
        robot = index = 0
        for _ in range(bounded(source.count())):
            other = robot + source.signed()
            index = source.signed() + (index if other == robot else 0)
            robot = other
            nodes.append(NodeId(robot, index))
            label.append(bounded(source.count()))
            touching.append(frozenset(source.count() for _ in range(bounded(source.count()))))
        pairs = [(source.count(), source.count()) for _ in range(bounded(source.count()))]
        if nodes != sorted(set(nodes)):
            raise BackendError("an eliminating robot sent its poses twice or in disorder")
        held = frozenset(source.count() for _ in range(bounded(source.count())))
        return cls(tuple(nodes), tuple(touching), np.array(label, dtype=np.intp), dict(pairs), robots, held)


def bounded(count: int) -> int:
    """The ``count`` of parts that a message says it has, if that can be."""
    if count > _MOST:
        raise BackendError(f"a message says that it has {count} parts")
    return count


def complete(me: int, order: Sequence[int], neighbours: Iterable[int], boundaries: Sequence[Boundary]) -> bool:
    """Whether every robot before ``me`` in the ``order`` that shares edges with it is among those that the
    ``boundaries`` that came are about."""
    rank = {robot: k for k, robot in enumerate(order)}
    if me == order[-1]:
        return 1 + sum(b.robots for b in boundaries) == len(order)
    return sum(b.below.get(me, 0) for b in boundaries) == sum(rank[r] < rank[me] for r in neighbours)
