"""What a message may say, and who may say it: agents that there are, and statements from their owners only.

A bid lists the own ends of the bidder's matches, never a match between others; coordinates, owners of maps and members
of groups are agents that there are. All of it is asked before a message changes anything.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Set

from .ids import MatchId
from .map_messages import MapDelivery, MapOrder
from .messages import Award, Bid, Body, Call, GroupNotice, MapNotice, Result
from .tasks import OptimiseTask


def false_claim(sender: int, body: Body, everyone: Set[int] | None) -> str:
    """Why ``sender`` may not say this, empty where it may. ``everyone``: the agents that there are; None:
    nobody has a list of them, and a name alone proves no lie."""
    strangers = set(_named(body)) - everyone if everyone is not None else set()
    if strangers:
        return f"there is no agent {min(strangers)}"
    if isinstance(body, Bid) and body.links is not None:
        for match, query in zip(body.links.matches, body.links.query, strict=True):
            if sender != (match.query_agent if query else match.match_agent):
                return f"agent {sender} lists an end of match {match} that is not its own"
    if isinstance(body, Result) and isinstance(body.outcome, MapDelivery):
        for submap in body.outcome.maps:
            foreign = [m for m in submap.matches if submap.owner not in m.agents]
            if foreign:
                return f"a map of agent {submap.owner} with a match of others: {foreign[0]}"
    return ""


def _named(body: Body) -> Iterator[int]:
    """Agents that a message names, beside sender and recipient."""
    match body:
        case Call() | GroupNotice():
            yield from body.members
        case MapNotice():
            yield from (offer.owner for offer in body.offers)
        case Bid():
            yield from (offer.owner for offer in body.offers)
            yield from (piece.frame.agent for piece in body.pieces)
            if body.links is not None:
                yield from _of_matches(body.links.matches)
        case Award(task=OptimiseTask() as task):
            yield from task.members
            yield from (frame.agent for frame in (task.frame, *task.present))
            yield from _of_matches(task.matches)
        case Award(task=MapOrder() as order):
            yield from order.owners
            if order.frame is not None:
                yield order.frame.agent
        case Result(outcome=MapDelivery() as delivery):
            yield from _of_delivery(delivery)


def _of_matches(matches: Iterable[MatchId]) -> Iterator[int]:
    for match in matches:
        yield from match.agents


def _of_delivery(delivery: MapDelivery) -> Iterator[int]:
    yield delivery.frame.agent
    for submap in delivery.maps:
        yield submap.owner
        yield from submap.route
        yield from _of_matches(submap.matches)
    for parcel in delivery.parcels:
        yield parcel.owner
        yield from parcel.route
        yield from (patch.frame.agent for patch in parcel.patches)
