"""Landmarks of a file: kept beside the poses, not optimised, written again where the poses that see them have gone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from ..geometry import Array, se3_inverse, transform_points
from .node import NodeId


@dataclass(frozen=True)
class Sighting:
    """A measurement of a landmark: its line's ``tag``, the ``node`` that made it, and the ``rest`` of the line behind
    both ids, as it stands in the file."""

    tag: str
    node: NodeId
    rest: str


@dataclass(frozen=True, eq=False)
class Landmark:
    """``name``: its id in the file; ``tag`` of its line. It hangs on ``node``, the first that sees it, at ``place``
    ``(3,)`` in that one's frame; where nobody sees it (None) in the file's."""

    name: int
    tag: str
    node: NodeId | None
    place: Array
    sightings: tuple[Sighting, ...] = ()

    def position(self, poses: Mapping[NodeId, Array]) -> Array:
        """Where it is ``(3,)``, its node at one of ``poses``."""
        if self.node is None:
            return self.place
        return np.asarray(transform_points(poses[self.node], self.place[None])[0])

    def seen_by(self, nodes: Iterable[NodeId], poses: Mapping[NodeId, Array]) -> Landmark | None:
        """As these ``nodes`` see it; None where none of them does."""
        known = set(nodes)
        sightings = tuple(s for s in self.sightings if s.node in known)
        if not sightings:
            return None
        node = sightings[0].node
        place = transform_points(se3_inverse(poses[node]), self.position(poses)[None])[0]
        return replace(self, node=node, place=np.asarray(place), sightings=sightings)

    def renamed(self, new: Mapping[NodeId, NodeId]) -> Landmark:
        """With the nodes under other names."""
        sightings = tuple(replace(s, node=new[s.node]) for s in self.sightings)
        return replace(self, node=None if self.node is None else new[self.node], sightings=sightings)


def hung(
    name: int, tag: str, position: Array, sightings: Iterable[Sighting], poses: Mapping[NodeId, Array]
) -> Landmark:
    """A landmark at ``position`` ``(3,)``, hung on the first pose that sees it."""
    seen = tuple(sightings)
    free = Landmark(name, tag, None, position, seen)
    return free.seen_by(poses, poses) or free
