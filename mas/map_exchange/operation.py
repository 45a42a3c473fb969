"""Map merging (thesis section 3.7, Algorithm 1; 3.9.3): buying an agent's map and the copies of others' maps it holds.

Algorithm 1 walks from seller to sub-map to sub-map without end when two agents hold each other's maps. Here an offer
lists all that the seller holds, flat, each with its owner and version: the set of what was visited. The buyer orders
what is newer than what it has, each map once, never its own. So every purchase ends, and the newest version wins.
"""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np

from maslam.backend.geometry import Sim3

from ..contracts.context import AgentContext
from ..contracts.contract import Contract, ContractState
from ..contracts.effects import NOTHING, Effects, total
from ..contracts.operation import Answer, Operation
from ..contracts.retries import RetryBudget
from ..policies.utility import Worth, orders, utility
from ..protocol.ids import ContractId, OperationKind
from ..protocol.map_messages import MapDelivery, MapOrder, Parcel, SubMap
from ..protocol.messages import Award, Bid, Call, Confirmation, MapNotice, Offer, Refusal, Rejection, Result
from ..protocol.tensors import MessageError
from ..state.pose_graph import Adoption, UpdatedPoses
from .admission import admit, recheck
from .announcements import Announcements
from .full_map_increments import runs_of
from .map_copy import MapCopy, SoldVersion
from .purchase import ArrivedMap, MapTender, SellerFrame, of_parcel, of_submap, seller_frame
from .seller import Seller


class MapExchange(Operation[MapOrder, MapDelivery]):
    """Manager: the buyer; contractor: the seller."""

    kind = OperationKind.MAPMERGE

    def __init__(self, context: AgentContext, worth: Worth = utility) -> None:
        super().__init__(context)
        self._worth = worth
        self.copies: dict[int, MapCopy] = {}
        self.last_bought: dict[int, int] = {}
        self.stale: set[int] = set()
        self.seller = Seller(context.state)
        self.announcements = Announcements()
        self._again = RetryBudget(context.state.config.link.retries)
        self._tenders: dict[ContractId, MapTender] = {}
        self._ordered: dict[tuple[ContractId, int], frozenset[int]] = {}
        self._rejected: set[SoldVersion] = set()
        self._spoilt: set[int] = set()
        self._checked: dict[int, tuple[int, int]] = {}

    # -- buyer --------------------------------------------------------------------------------------------------------

    def buy(self, sellers: list[int]) -> Effects:
        """Call for the maps of these agents."""
        call = self.context.call(OperationKind.MAPMERGE, sellers)
        if call.contractors:
            self._tenders[call.identity] = MapTender(self.context.now_ns, set(call.contractors))
        for seller in call.contractors:
            self.stale.discard(seller)
            self.last_bought[seller] = len(self.state.keyframes)
        return call.effects

    def note_offers(self, seller: int, offers: tuple[Offer, ...]) -> None:
        """Somebody tells which maps are new there."""
        self.announcements.known_to(seller, offers)
        if any(self._wants(seller, offer) for offer in offers):
            self.stale.add(seller)

    @property
    def refused_owners(self) -> set[int]:
        """Agents of whose maps one was not kept."""
        return {sold.owner for sold in self._rejected}

    def on_bid(self, contract: Contract, bid: Bid) -> Effects:
        tender = self._tenders.get(contract.id)
        if tender is None:
            return self.context.send(contract, Rejection("no longer wanted"))
        tender.bids[contract.contractor] = bid
        self.announcements.known_to(contract.contractor, bid.offers)
        return self._answered(contract)

    def on_end(self, contract: Contract) -> Effects:
        """A sale that came to nothing is still wanted."""
        if contract.manager != self.state.me:
            return NOTHING
        self._ordered.pop((contract.id, contract.contractor), None)
        effects = self._answered(contract)
        if self._again.wanted(contract, OperationKind.MAPMERGE):
            self.stale.add(contract.contractor)
            self.last_bought.pop(contract.contractor, None)
        return effects

    def tick(self) -> Effects:
        """Half of a contract's time is enough to wait for those who do not answer; the others' bids would expire with
        them."""
        effects = NOTHING
        for identity, tender in sorted(self._tenders.items()):
            patience = (self.context.deadline_ns(self.kind, tender.pending) - self.context.now_ns) // 2
            if self.context.now_ns - tender.called_ns >= patience:
                silent = [c for c in self.context.ledger.managed(identity) if c.contractor in tender.pending]
                effects += self.context.cancel(silent, "no answer")
                tender.pending.clear()
                effects += self._award(identity)
        return effects

    def _answered(self, contract: Contract) -> Effects:
        tender = self._tenders.get(contract.id)
        if tender is None:
            return NOTHING
        tender.pending.discard(contract.contractor)
        return NOTHING if tender.pending else self._award(contract.id)

    def _award(self, identity: ContractId) -> Effects:
        """Once all have answered each wanted map is ordered from the one whose bid is worth most."""
        tender = self._tenders.pop(identity)
        for seller, bid in sorted(tender.bids.items()):
            for offer in bid.offers:
                self._confirm(seller, offer)
        contracts = self.context.ledger.managed(identity)
        reputation = {seller: self.context.reputation.of(seller).value for seller in tender.bids}
        deadline_ns = max((c.deadline_ns for c in contracts), default=0)
        wanted = orders(tender.bids, reputation, self._wants, deadline_ns, self._worth)
        bids = [c for c in contracts if c.state is ContractState.BID]
        return total(self._order(c, wanted.get(c.contractor, ())) for c in bids)

    def _order(self, contract: Contract, owners: tuple[int, ...]) -> Effects:
        if not owners:
            return self.context.send(contract, Rejection("nothing new"))
        copies = [None if o in self._spoilt else self.copies.get(o) for o in owners]
        versions = tuple(0 if c is None or c.map_version is None else c.version for c in copies)
        known = tuple(() if c is None or c.map_version is not None else runs_of(c.keyframes) for c in copies)
        order = MapOrder(owners, versions, self.state.frame, known if any(known) else ())
        self._ordered[contract.id, contract.contractor] = frozenset(owners)
        return self.context.send(contract, Award(order))

    def _wants(self, seller: int, offer: Offer) -> bool:
        """Whether an offer is of use."""
        return self._of_use(SoldVersion(seller, offer.owner, offer.version))

    def _of_use(self, sold: SoldVersion) -> bool:
        """Newer than the copy that is here. What the owner itself offers counts more than what another does: a copy
        that is newer than the owner's own map is a false one."""
        copy = self.copies.get(sold.owner)
        if sold.owner == self.state.me or sold in self._rejected:
            return False
        if copy is None or copy.version < sold.version:
            return True
        return sold.seller == sold.owner and copy.version > sold.version

    def _confirm(self, owner: int, offer: Offer) -> None:
        """At the end an owner that offers the version of this copy says that it has not moved since: in common
        coordinates the copy then stands where its owner has it, whatever it was moved by meanwhile."""
        copy = self.copies.get(owner)
        if copy is None or copy.map_version is None or not self.context.closing or offer.owner != owner:
            return
        if offer.version == copy.version and copy.frame == self.state.frame:
            placement = Sim3(np.eye(3), np.zeros(3), copy.map_version.map.unit)
            self.copies[owner] = replace(copy, placement=placement)

    def objection(self, contract: Contract, outcome: MapDelivery) -> str:
        """Only what was ordered is taken, each map once."""
        owners = [m.owner for m in outcome.maps] + [p.owner for p in outcome.parcels]
        ordered = self._ordered.get((contract.id, contract.contractor), frozenset())
        if not ordered.issuperset(owners) or len(set(owners)) != len(owners):
            return f"maps of agents {sorted(owners)[:8]}, ordered were {sorted(ordered)[:8]}"
        return ""

    def on_result(self, contract: Contract, outcome: MapDelivery) -> Effects:
        seller = contract.contractor
        place = seller_frame(self.state, seller, outcome)
        if place is None:
            return self.context.event("map_refused", seller=seller, reason="no common place to align it by")
        submaps = total(self._take_submap(submap, place) for submap in outcome.maps)
        return submaps + total(self._take_parcel(parcel, place) for parcel in outcome.parcels)

    def _take_submap(self, submap: SubMap, place: SellerFrame) -> Effects:
        """A map in the thesis's form."""
        try:
            arrived = of_submap(submap, self.copies.get(submap.owner), place)
        except MessageError as error:
            sold = SoldVersion(place.seller, submap.owner, submap.version)
            return self._misfit(sold, bool(submap.known), str(error))
        return self._take(arrived)

    def _take_parcel(self, parcel: Parcel, place: SellerFrame) -> Effects:
        """A map made of patches."""
        try:
            arrived = of_parcel(parcel, self.copies.get(parcel.owner), place, self.state.frame)
        except MessageError as error:
            sold = SoldVersion(place.seller, parcel.owner, parcel.patches[-1].version)
            return self._misfit(sold, bool(parcel.patches[0].base), str(error))
        return self._take(arrived)

    def _misfit(self, sold: SoldVersion, partial: bool, reason: str) -> Effects:
        """A delivery that makes no map: where it held only what is new, the whole is ordered next time."""
        if partial:
            self._spoilt.add(sold.owner)
            self.stale.add(sold.seller)
        else:
            self._rejected.add(sold)
        return self.context.event("map_refused", seller=sold.seller, owner=sold.owner, reason=reason)

    def _take(self, arrived: ArrivedMap) -> Effects:
        """Algorithm 1: update the copy or append a new one, if it passes the checks."""
        new = arrived.copy
        self._spoilt.discard(new.owner)
        if not self._of_use(new.sold):
            return NOTHING
        old = self.copies.get(new.owner)
        verdict = admit(arrived, old, self.state, self.copies)
        if verdict.copy is None:
            return self._refuse(new, verdict.reason)
        self.copies[new.owner] = verdict.copy
        known = 0 if old is None else len(old.keyframes)
        return self.context.event(
            "map_bought",
            **asdict(new.sold),
            keyframes=len(new.keyframes),
            new_keyframes=len(new.keyframes) - known,
            points=len(new.references),
            route=list(new.route),
            **verdict.remarks(),
        )

    def keep(self, copy: MapCopy) -> None:
        """A copy that was bought in an earlier run."""
        self.copies[copy.owner] = copy

    # -- holder -------------------------------------------------------------------------------------------------------

    def realign(self, adoption: Adoption | UpdatedPoses) -> Effects:
        """Move map copies along with the agent's own correction (3.9.3, map alignment), by the key-frame that was
        matched with the map's owner last, else with its seller, else the agent's last one; then check them. Whoever it
        has met may have a newer map since."""
        for owner in sorted(self.copies):
            copy = self.copies[owner]
            index = self._anchor(copy, adoption)
            self.copies[owner] = copy.moved(self.state.pose(index) @ adoption.before[index].inverse())
        checked = total(self._check(owner) for owner in sorted(self.copies))
        self.stale.update(self.state.partners())
        return checked

    def check_at_end(self) -> Effects:
        """The last consistency check: every copy that changed since its last event."""
        effects = NOTHING
        for owner in sorted(self.copies):
            state = (self.copies[owner].version, self.state.version)
            if self._checked.get(owner) != state:
                effects += self._check(owner, final=True)
                self._checked[owner] = state
        return effects

    def _check(self, owner: int, final: bool = False) -> Effects:
        """The checks of 3.9.3 for a map that is held: matches that came since it was bought may tell that it is wrong.
        Logged where it is given up or moved, and at the end in any case."""
        copy = self.copies[owner]
        verdict = recheck(copy, self.state, self.copies)
        if verdict.copy is None:
            del self.copies[owner]
            return self._refuse(copy, verdict.reason)
        self.copies[owner] = verdict.copy
        if verdict.evidence is None or not (verdict.aligned_by is not None or final):
            return NOTHING
        figures = verdict.remarks()
        return self.context.event("map_checked", owner=owner, version=copy.version, final=final, **figures)

    def _refuse(self, copy: MapCopy, reason: str) -> Effects:
        """Not kept, and not bought again from this seller."""
        self._rejected.add(copy.sold)
        own = copy.seller == copy.owner
        blamed = self.context.reputation.blame(copy.seller, self.context.now_ns) if own else ()
        return Effects(changes=blamed) + self.context.event("map_refused", **asdict(copy.sold), reason=reason)

    def _anchor(self, copy: MapCopy, adoption: Adoption | UpdatedPoses) -> int:
        me = self.state.me
        for other in (copy.owner, copy.seller):
            mine = [m.end_of(me)[0] for m in self.state.accepted if set(m.agents) == {me, other}]
            mine = [i for i in mine if i in adoption.before]
            if mine:
                return max(mine)
        return max(adoption.before)

    # -- seller -------------------------------------------------------------------------------------------------------

    def announce(self, partners: list[int]) -> Effects:
        """Tell these agents which of the maps here they do not know of."""
        offers, effects = self.seller.offers(self.copies, self.context.closing), NOTHING
        for partner in partners:
            new = self.announcements.new_for(partner, offers)
            if new:
                self.announcements.known_to(partner, new)
                effects += self.context.tell(partner, None, MapNotice(new))
        return effects

    def bid(self, contract: Contract, call: Call) -> Answer:
        offers = self.seller.offers(self.copies, self.context.closing)
        if not offers:
            return Answer(Refusal("nothing to sell yet"))
        self.announcements.known_to(contract.manager, offers)
        cost = self.seller.estimate(offers, self.copies)
        return Answer(Bid(cost_bytes=cost, ready_ns=self.context.now_ns, offers=offers))

    def work(self, contract: Contract, task: MapOrder) -> Effects:
        delivery = self.seller.delivery(contract.manager, task, self.copies, self.context.closing)
        return self.context.send(contract, Confirmation()) + self.context.send(contract, Result(delivery))
