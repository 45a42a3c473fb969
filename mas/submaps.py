"""Map merging (thesis section 3.7, Algorithm 1; 3.9.3): buying an agent's map and the copies of others' maps it holds.

Algorithm 1 walks from seller to sub-map to sub-map without end when two agents hold each other's maps. Here an offer
lists all that the seller holds, flat, each with its owner and version; the buyer orders what is newer than what it
has, never its own map. So every purchase ends, and the newest version wins.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from backend.geometry import Array, Sim3
from mas.contract import Contract, State
from mas.desk import Desk, Trade, WorkError
from mas.identities import ContractId, MatchId, Operation
from mas.messages import Award, Bid, Call, Confirmation, Offer, Refusal, Rejection, Result
from mas.policy.utility import ENVELOPE_BYTES, orders
from mas.posegraph import Adoption
from mas.retender import Retender
from mas.state import AgentState, thinned
from mas.tasks import MapDelivery, MapOrder, Outcome, SubMap, Task
from mas.tensors import Tensor, pack_poses, pack_sim3s, unpack_poses, unpack_sim3s


@dataclass(frozen=True, eq=False)
class HeldMap:
    """A copy of another agent's map in the holder's coordinates: poses ``(K, 4, 4)`` ``T_F_C``, and what the owner's
    unit is worth there; ``wire``: the rest as it came. ``seller``: from whom; ``now_ns``: when."""

    owner: int
    version: int
    seller: int
    now_ns: int
    poses: Array
    unit: float
    wire: SubMap

    @property
    def keyframes(self) -> NDArray[Any]:
        """``(K,)`` indices of the owner's key-frames."""
        return self.wire.keyframes.array()

    def points(self) -> Array:
        """``(P, 3)`` map points in the holder's coordinates."""
        rows = self.wire.references.array()
        local = self.wire.points.array().astype(np.float64) * self.unit
        poses = self.poses[rows]
        return np.einsum("pij,pj->pi", poses[:, :3, :3], local) + poses[:, :3, 3]


class MapTrade(Trade):
    """Manager: the buyer; contractor: the seller."""

    def __init__(self, desk: Desk) -> None:
        super().__init__(desk)
        self.held: dict[int, HeldMap] = {}
        self.last_bought: dict[int, int] = {}
        self.stale: set[int] = set()
        self._bids: dict[ContractId, dict[int, Bid]] = {}
        self.something_new = False
        self.rounds = 0
        self._again = Retender(desk.state.config.link.retries)
        self._sold: tuple[int, SubMap] | None = None

    # -- buyer --------------------------------------------------------------------------------------------------------

    def buy(self, sellers: list[int]) -> None:
        """Call for the maps of these agents."""
        _, called = self.desk.call(Operation.MAPMERGE, sellers)
        for seller in called:
            self.stale.discard(seller)
            self.last_bought[seller] = len(self.state.keyframes)

    def on_bid(self, contract: Contract, bid: Bid) -> None:
        self._bids.setdefault(contract.id, {})[contract.contractor] = bid
        self._judge(contract.id)

    def _judge(self, call: ContractId) -> None:
        """Once everyone has answered: each map from the seller whose bid is worth most."""
        contracts = self.desk.ledger.managed(call)
        if call not in self._bids or any(c.state is State.CALLED for c in contracts):
            return
        bids = self._bids.pop(call)
        standing = {seller: self.desk.standing.of(seller).value for seller in bids}
        held = {owner: h.version for owner, h in self.held.items()}
        deadline_ns = max((c.deadline_ns for c in contracts), default=0)
        wanted = orders(bids, standing, held, self.state.me, deadline_ns)
        for contract in contracts:
            if contract.state is State.BID and contract.contractor in wanted:
                self.desk.say(contract, Award(MapOrder(wanted[contract.contractor])))
            elif contract.state is State.BID:
                self.desk.say(contract, Rejection("nothing new, or better offers"))

    def _wants(self, offer: Offer) -> bool:
        held = self.held.get(offer.owner)
        return offer.owner != self.state.me and (held is None or held.version < offer.version)

    def on_result(self, contract: Contract, outcome: Outcome) -> None:
        if not isinstance(outcome, MapDelivery):
            raise WorkError("not a delivery of maps")
        T_mine_seller = self._seller_frame(contract.contractor, outcome)
        if T_mine_seller is None:
            self.desk.note("map_refused", seller=contract.contractor, reason="no common place to align it by")
            return
        for submap in outcome.maps:
            offer = Offer(submap.owner, submap.version, len(submap.keyframes.array()))
            if not self._wants(offer):
                continue
            poses = T_mine_seller.transform_poses(unpack_poses(submap.poses.array()))
            unit = submap.unit * T_mine_seller.scale
            seller = contract.contractor
            self.held[submap.owner] = HeldMap(
                submap.owner, submap.version, seller, self.desk.now_ns, poses, unit, submap
            )
            self.something_new = True
            self.desk.note(
                "map_bought", seller=seller, owner=submap.owner, version=submap.version, keyframes=offer.keyframes,
                points=len(submap.references.array()),
            )  # fmt: skip

    def _seller_frame(self, seller: int, delivery: MapDelivery) -> Sim3 | None:
        """``T_mine_seller`` between the two agents' coordinates: the identity where they share them since an
        optimisation, else by the first accepted match between the two whose both key-frames are placed."""
        if delivery.frame == self.state.frame:
            return Sim3.identity()
        ties = dict(zip(delivery.ties, unpack_sim3s(delivery.tie_poses), strict=True))
        placed = set(self.state.placed())
        for match in self.state.accepted_matches():
            if set(match.id.agents) != {self.state.me, seller}:
                continue
            asked = match.id.query_agent == self.state.me
            mine, theirs = (match.id.query, match.id.match) if asked else (match.id.match, match.id.query)
            if mine in placed and theirs in ties:
                T_mine_theirs = match.T_M_Q.inverse() if asked else match.T_M_Q
                return self.state.pose(mine) @ T_mine_theirs @ ties[theirs].inverse()
        return None

    def realign(self, adoption: Adoption) -> None:
        """Move held maps along with the agent's own correction (3.9.3, map alignment), by the key-frame that was
        matched with the map's owner last, else with its seller, else the agent's last one."""
        for owner in sorted(self.held):
            held = self.held[owner]
            index = self._anchor(held, adoption)
            motion = self.state.pose(index) @ adoption.before[index].inverse()
            self.held[owner] = replace(held, poses=motion.transform_poses(held.poses), unit=held.unit * motion.scale)

    def _anchor(self, held: HeldMap, adoption: Adoption) -> int:
        me = self.state.me
        for other in (held.owner, held.seller):
            mine = [_mine(m, me) for m in self.state.accepted if set(m.agents) == {me, other}]
            mine = [i for i in mine if i in adoption.before]
            if mine:
                return max(mine)
        return max(adoption.before)

    def on_end(self, contract: Contract) -> None:
        """A sale that came to nothing is still wanted."""
        self._judge(contract.id)
        if contract.manager == self.state.me and self._again.wanted(contract, Operation.MAPMERGE):
            self.stale.add(contract.contractor)
            self.last_bought.pop(contract.contractor, None)
            self.something_new = True

    # -- seller -------------------------------------------------------------------------------------------------------

    def bid(self, contract: Contract, call: Call) -> Bid | Refusal:
        offers = [Offer(h.owner, h.version, len(h.poses)) for _, h in sorted(self.held.items())]
        placed = len(self.state.placed())
        if placed:
            offers.append(Offer(self.state.me, self.state.version, placed))
        if not offers:
            return Refusal("nothing to sell yet")
        cost = ENVELOPE_BYTES + _own_bytes(self.state) + sum(h.wire.payload_bytes for h in self.held.values())
        return Bid(cost_bytes=cost, ready_ns=self.desk.now_ns, offers=tuple(sorted(offers, key=lambda o: o.owner)))

    def work(self, contract: Contract, task: Task) -> None:
        if not isinstance(task, MapOrder):
            raise WorkError("not an order for maps")
        missing = [o for o in task.owners if o != self.state.me and o not in self.held]
        if missing:
            raise WorkError(f"no map of agent {missing[0]} here")
        self.desk.say(contract, Confirmation())
        maps = tuple(self.own_map() if o == self.state.me else _resold(self.held[o]) for o in task.owners)
        ties = self._ties(contract.manager)
        poses = pack_sim3s([self.state.pose(i) for i in ties])
        self.desk.say(contract, Result(MapDelivery(self.state.frame, ties, poses, maps)))

    def own_map(self) -> SubMap:
        """The agent's own map as it stands: key-frames in its reference frame, each point once, where it was first
        seen."""
        if self._sold is None or self._sold[0] != self.state.version:
            self._sold = (self.state.version, _own_map(self.state))
        return self._sold[1]

    def _ties(self, buyer: int) -> tuple[int, ...]:
        """Own key-frames that the buyer can place the maps by."""
        placed = set(self.state.placed())
        mine = {_mine(m, self.state.me) for m in self.state.accepted if set(m.agents) == {self.state.me, buyer}}
        return tuple(sorted(mine & placed))


def _mine(match: MatchId, me: int) -> int:
    return match.query if match.query_agent == me else match.match


def _resold(held: HeldMap) -> SubMap:
    return SubMap(
        owner=held.owner, version=held.version, unit=held.unit, keyframes=held.wire.keyframes,
        stamps_ns=held.wire.stamps_ns, poses=pack_poses(held.poses), references=held.wire.references,
        points=held.wire.points, descriptors=held.wire.descriptors, matches=held.wire.matches,
        transforms=held.wire.transforms,
    )  # fmt: skip


def _own_map(state: AgentState) -> SubMap:
    indices = state.placed()
    keyframes = [state.keyframes[i] for i in indices]
    fresh = [
        thinned(np.flatnonzero(k.first_seen & (k.points_C[:, 2] > 0)), state.config.merge.max_points) for k in keyframes
    ]
    counts = [len(rows) for rows in fresh]
    stack = [k.points_C[rows] for k, rows in zip(keyframes, fresh, strict=True)]
    descriptors = [k.descriptors[rows] for k, rows in zip(keyframes, fresh, strict=True)]
    main = next(p for p in state.pieces if p.frame == state.frame)
    return SubMap(
        owner=state.me,
        version=state.version,
        unit=main.unit,
        keyframes=Tensor.of(indices, "<i4"),
        stamps_ns=Tensor.of([k.stamp_ns for k in keyframes], "<i8"),
        poses=pack_poses(np.array([state.poses[i] for i in indices]).reshape(-1, 4, 4)),
        references=Tensor.of(np.repeat(np.arange(len(indices)), counts), "<i4"),
        points=Tensor.of(np.concatenate([np.zeros((0, 3)), *stack]), "<f4"),
        descriptors=Tensor.of(np.concatenate([np.zeros((0, 32), dtype=np.uint8), *descriptors]), "|u1"),
        matches=tuple(m.id for m in state.accepted_matches()),
        transforms=pack_sim3s([m.T_M_Q for m in state.accepted_matches()]),
    )


def _own_bytes(state: AgentState) -> int:
    """About what the whole own map takes on the air: 68 bytes a key-frame, 48 a point, 80 a match."""
    limit = state.config.merge.max_points
    points = sum(min(int(state.keyframes[i].first_seen.sum()), limit) for i in state.placed())
    return 68 * len(state.placed()) + 48 * points + 80 * len(state.accepted)


def held_from_wire(state: AgentState, submap: SubMap) -> HeldMap:
    """The agent's own map seen like a held one: for export."""
    return HeldMap(state.me, submap.version, state.me, 0, unpack_poses(submap.poses.array()), submap.unit, submap)
