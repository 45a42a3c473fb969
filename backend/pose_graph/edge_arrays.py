"""A graph as arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import Array
from .node import NodeId


@dataclass(frozen=True, eq=False)
class EdgeArrays:
    """A graph as arrays: ``poses`` ``(n, 4, 4)``; for each edge ``ends`` ``(m, 2)`` rows into them, ``measured``
    ``(m, 4, 4)``, weighted ``information`` ``(m, 6, 6)`` and the ``weight`` ``(m,)`` itself.

    Priors are edges from the origin frame, after the others; the origin is then a node of its own: the identity in
    row ``origin``, the last one, which has no name in ``nodes``. ``fixed``: rows of nodes that keep their poses.
    """

    nodes: list[NodeId]
    poses: Array
    ends: NDArray[np.intp]
    measured: Array
    information: Array
    weight: Array
    origin: int | None = None
    fixed: tuple[int, ...] = ()

    def named(self, poses: Array) -> dict[NodeId, Array]:
        """Rows of ``poses`` by node, the origin left out."""
        return dict(zip(self.nodes, poses[: len(self.nodes)], strict=True))
