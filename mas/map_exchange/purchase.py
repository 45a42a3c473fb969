"""A purchase of maps: the tender, and the map copies that a delivery makes, completed where the seller left out what is
here, and placed in the buyer's coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from maslam.backend.geometry import Sim3

from ..protocol.ids import FrameId, MatchId
from ..protocol.map_messages import MapDelivery, Parcel, SubMap
from ..protocol.messages import Bid
from ..protocol.tensors import unpack_sim3, unpack_sim3s
from ..state.agent_state import AgentState
from .full_map_increments import completed
from .map_copy import MapCopy, copy_of_submap, copy_of_version
from .versions import version_of


@dataclass
class MapTender:
    """One call for maps until all have answered, or long enough has been waited for them."""

    called_ns: int
    pending: set[int]
    bids: dict[int, Bid] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SellerFrame:
    """A seller's coordinates ``frame``: ``T_mine_seller``, and the match that tells it (None: they are shared)."""

    seller: int
    frame: FrameId
    T_mine_seller: Sim3
    placed_by: MatchId | None


@dataclass(frozen=True, eq=False)
class ArrivedMap:
    """A map copy as it arrived, not yet checked; ``placed_by``: the match that it was placed by, if any."""

    copy: MapCopy
    placed_by: MatchId | None = None


def seller_frame(state: AgentState, seller: int, delivery: MapDelivery) -> SellerFrame | None:
    """Where the seller's coordinates stand in the buyer's: the same where they share them since an optimisation, else
    by the first accepted match between the two whose both key-frames are placed; None where there is none."""
    if delivery.frame == state.frame:
        return SellerFrame(seller, delivery.frame, Sim3.identity(), None)
    ties = dict(zip(delivery.ties, unpack_sim3s(delivery.tie_poses), strict=True))
    placed = set(state.placed())
    for match in state.accepted_matches():
        if set(match.id.agents) != {state.me, seller}:
            continue
        asked = match.id.query_agent == state.me
        mine, theirs = (match.id.query, match.id.match) if asked else (match.id.match, match.id.query)
        if mine in placed and theirs in ties:
            T_mine_theirs = match.T_M_Q.inverse() if asked else match.T_M_Q
            T_mine_seller = state.pose(mine) @ T_mine_theirs @ ties[theirs].inverse()
            return SellerFrame(seller, delivery.frame, T_mine_seller, match.id)
    return None


def of_submap(submap: SubMap, known: MapCopy | None, place: SellerFrame) -> ArrivedMap:
    """A copy in the thesis's form; :class:`MessageError` where it does not fit the ``known`` one."""
    whole = completed(submap, known)
    return ArrivedMap(copy_of_submap(whole, place.frame, place.T_mine_seller, place.seller), place.placed_by)


def of_parcel(parcel: Parcel, known: MapCopy | None, place: SellerFrame, buyer_frame: FrameId) -> ArrivedMap:
    """A copy made of patches; :class:`MessageError` where they do not fit the ``known`` one."""
    version = version_of(parcel.owner, None if known is None else known.map_version, parcel.patches)
    placement, placed_by = Sim3(np.eye(3), np.zeros(3), version.map.unit), place.placed_by
    if version.map.frame == buyer_frame:
        placed_by = None  # as the owner has it, whatever the seller has moved it by
    else:
        sent = placement if parcel.placement is None else unpack_sim3(parcel.placement)
        placement = place.T_mine_seller @ sent
    return ArrivedMap(copy_of_version(version, placement, (*parcel.route, place.seller)), placed_by)
