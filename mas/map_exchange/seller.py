"""The seller's side: an agent's own map and its copies, for a buyer that states what it has already."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..contracts.operation import WorkError
from ..protocol.map_messages import MapDelivery, MapOrder, Parcel, Runs, SubMap
from ..protocol.messages import Offer
from ..protocol.tensors import pack_sim3, pack_sim3s
from ..state.agent_state import AgentState
from .coding.quantised_map import QuantisedMap
from .full_map import fresh_rows, own_submap
from .full_map_increments import without
from .map_copy import MapCopy, submap_of
from .publisher import Publisher
from .versions import MapVersion

# What a key-frame's pose and a point take in a compact map, roughly: for the estimate in a bid.
_POSE_BYTES, _POINT_BYTES = 8, 2
# Likewise in full: a key-frame's index, time and pose, a point with reference and descriptor, a match, all the rest.
_FULL_POSE_BYTES, _FULL_POINT_BYTES, _FULL_MATCH_BYTES, _FULL_MAP_BYTES = 68, 48, 74, 150


class Seller:
    """The seller's side of map merging, without contracts."""

    def __init__(self, state: AgentState) -> None:
        self.state = state
        self._publisher = Publisher(state)
        self._full: SubMap | None = None
        self._points: list[int] = []

    @property
    def sold(self) -> dict[int, QuantisedMap]:
        """The last versions of the agent's own map, in the compact form."""
        return self._publisher.recent

    @property
    def published(self) -> MapVersion | None:
        """The latest version of the agent's own map, in the compact form; None before the first."""
        return self._publisher.published

    def count_on(self, version: MapVersion) -> None:
        """The next version counts on from this one of an earlier run."""
        self._publisher.count_on(version)

    @property
    def _compact(self) -> bool:
        return self.state.config.merge.form == "compact"

    def offers(self, copies: Mapping[int, MapCopy], closing: bool) -> tuple[Offer, ...]:
        """All maps for sale, by owner: flat, so that no buyer has to walk from sub-map to sub-map."""
        offers = [Offer(h.owner, h.version, len(h.keyframes)) for _, h in sorted(copies.items())]
        mine = self._own_offer(closing)
        return tuple(sorted(offers if mine is None else [*offers, mine], key=lambda o: o.owner))

    def _own_offer(self, closing: bool) -> Offer | None:
        if self._compact:
            map_version = self._publisher.latest(closing)
            return (
                None
                if map_version is None
                else Offer(self.state.me, map_version.map.version, len(map_version.map.keyframes))
            )
        placed = len(self.state.placed())
        return Offer(self.state.me, self.state.version, placed) if placed else None

    def estimate(self, offers: Sequence[Offer], copies: Mapping[int, MapCopy]) -> int:
        """Bytes that all of it would take, roughly, for a buyer who has nothing: a bid does not know what that is."""
        if self._compact:
            each = _POSE_BYTES + _POINT_BYTES * self.state.config.merge.max_points
            return sum(each * o.keyframes for o in offers)
        total = 0
        for offer in offers:
            copy = copies.get(offer.owner)
            points = self._own_points() if copy is None else len(copy.references)
            matches = len(self.state.accepted) if copy is None else len(copy.matches)
            total += _FULL_POSE_BYTES * offer.keyframes + _FULL_POINT_BYTES * points
            total += _FULL_MATCH_BYTES * matches + _FULL_MAP_BYTES
        return total

    def _own_points(self) -> int:
        """Number of points of the agent's own map now."""
        limit = self.state.config.merge.max_points
        self._points += [len(fresh_rows(k, limit)) for k in self.state.keyframes[len(self._points) :]]
        return sum(self._points[i] for i in self.state.placed())

    def delivery(self, buyer: int, order: MapOrder, copies: Mapping[int, MapCopy], closing: bool) -> MapDelivery:
        """The maps ordered, in the agent's coordinates; where the buyer has others, with ties to place them by.
        :class:`WorkError` where something ordered is not here."""
        for owner in order.owners:
            if owner not in copies and not (owner == self.state.me and self.state.placed()):
                raise WorkError(f"no map of agent {owner} here")
        maps: list[SubMap] = []
        parcels: list[Parcel] = []
        versions = order.versions or (0,) * len(order.owners)
        nothing: tuple[Runs, ...] = ((),) * len(order.owners)
        for owner, version, runs in zip(order.owners, versions, order.known or nothing, strict=True):
            item = self._own(version, closing) if owner == self.state.me else self._resold(copies[owner], version)
            if isinstance(item, Parcel):
                parcels.append(item)
            else:
                maps.append(without(item, runs))
        needed = bool(maps) or order.frame != self.state.frame
        ties = self._ties(buyer) if needed else ()
        poses = pack_sim3s([self.state.pose(i) for i in ties])
        return MapDelivery(self.state.frame, ties, poses, tuple(maps), tuple(parcels))

    def _own(self, version: int, closing: bool) -> SubMap | Parcel:
        """The agent's own map for a buyer who has this version of it (0: none)."""
        if self._compact:
            map_version = self._publisher.latest(closing)
            assert map_version is not None
            return Parcel(self.state.me, None, (), map_version.since(version))
        if self._full is None or self._full.version != self.state.version:
            self._full = own_submap(self.state, self.state.config.merge.max_points)
        return self._full

    def _resold(self, copy: MapCopy, version: int) -> SubMap | Parcel:
        if copy.map_version is None:
            return submap_of(copy)
        placement = None if self._in_place(copy) else pack_sim3(copy.placement)
        return Parcel(copy.owner, placement, copy.route, copy.map_version.since(version))

    def _in_place(self, copy: MapCopy) -> bool:
        """Whether a copy stands in its owner's coordinates, which are mine, as its owner had it."""
        p = copy.placement
        unmoved = not p.translation.any() and np.array_equal(p.rotation, np.eye(3))
        return copy.frame == self.state.frame and bool(unmoved)

    def _ties(self, buyer: int) -> tuple[int, ...]:
        """Own key-frames that the buyer can place the maps by."""
        placed = set(self.state.placed())
        mine = {m.end_of(self.state.me)[0] for m in self.state.accepted if set(m.agents) == {self.state.me, buyer}}
        return tuple(sorted(mine & placed))
