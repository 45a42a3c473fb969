"""Utility of a bid for the agent that called: "evaluates all the bids and decides the best" (thesis section 3.8.2).

    utility = reputation * benefit / cost_bytes, and nothing for a bid that would be ready after the deadline

Benefit is counted in what the operation is for, so only bids to one call are compared. Where bids are rivals (several
sellers of one map), the best is awarded; where they complement each other (each agent knows its own places; all whom
matches join belong into an optimisation) all that are worth anything are.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from ..protocol.messages import Bid, Offer

# What a result brings beside its figures: header, names, lengths.
ENVELOPE_BYTES = 20
PLACE_ANSWER_BYTES = 22
VERIFY_ANSWER_BYTES = 260
# Until an agent has paid for an optimisation: about 20 sweeps with 6 or 9 numbers for each end of a match.
SOLVER_BYTES_A_ROW = 1200.0


def utility(reputation: float, benefit: float, bid: Bid, deadline_ns: int) -> float:
    """Expected benefit for each byte; 0 for what comes too late."""
    if bid.ready_ns > deadline_ns:
        return 0.0
    return reputation * benefit / max(bid.cost_bytes, 1)


Worth = Callable[[float, float, Bid, int], float]
"""Of a bid, from reputation, benefit, the bid and the deadline, as :func:`utility`."""


def orders(
    bids: Mapping[int, Bid],
    reputation: Mapping[int, float],
    wants: Callable[[int, Offer], bool],
    deadline_ns: int,
    worth_of: Worth = utility,
) -> dict[int, tuple[int, ...]]:
    """Which owners' maps to order from which seller; ``wants(seller, offer)``: whether an offer is of use at all.

    Each map is bought once: from its owner, where it bids and is worth anything (nobody knows better where its
    key-frames are), else the newest version on offer, of equal ones from the seller of the highest utility (benefit:
    key-frames that are new), then of the lowest number.
    """
    best: dict[int, tuple[bool, int, float, int]] = {}
    for seller, bid in sorted(bids.items()):
        wanted = [offer for offer in bid.offers if wants(seller, offer)]
        worth = worth_of(reputation[seller], sum(o.keyframes for o in wanted), bid, deadline_ns)
        for offer in wanted if worth > 0 else []:
            key = (offer.owner == seller, offer.version, worth, -seller)
            if offer.owner not in best or key > best[offer.owner]:
                best[offer.owner] = key
    sellers = {owner: -key[3] for owner, key in best.items()}
    return {s: tuple(sorted(o for o, by in sellers.items() if by == s)) for s in sorted(set(sellers.values()))}
