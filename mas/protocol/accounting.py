"""What each message is counted for, and its payload as the published tables count it."""

from __future__ import annotations

from enum import StrEnum

from . import solver_messages
from .messages import Award, Begin, Message, Result
from .solver_messages import SolverBody
from .tasks import (
    EarlierAnswer,
    MapDelivery,
    MapOrder,
    OptimiseAnswer,
    OptimiseTask,
    OwnerQuery,
    PlaceAnswer,
    PlaceQuery,
    PlaceRedirect,
    VerifyAnswer,
    VerifyTask,
)


class Traffic(StrEnum):
    """What bytes are spent on; everything that is neither task nor outcome nor solver message is negotiation."""

    DVPR = "dvpr"
    RELPOSE = "relpose"
    DOPT = "dopt"
    MAPMERGE = "mapmerge"
    NEGOTIATION = "negotiation"


_OF_WORK = {
    PlaceQuery: Traffic.DVPR,
    PlaceAnswer: Traffic.DVPR,
    OwnerQuery: Traffic.DVPR,
    EarlierAnswer: Traffic.DVPR,
    PlaceRedirect: Traffic.DVPR,
    VerifyTask: Traffic.RELPOSE,
    VerifyAnswer: Traffic.RELPOSE,
    OptimiseTask: Traffic.DOPT,
    OptimiseAnswer: Traffic.DOPT,
    MapOrder: Traffic.MAPMERGE,
    MapDelivery: Traffic.MAPMERGE,
}


def account(message: Message) -> tuple[Traffic, str, int]:
    """What a message counts for, its kind in a word, and its payload in bytes as the published tables count it.

    DVPR: the coded vector (as float32: 4 a number, as there); back 8 + 4, and 4 where it names another query.
    Clustered: 1 + 4 more to the owner, back 8 + 4 + 1. RelPose: 1 + 4 + 4 and for each point 12 for
    its position and 32 for its descriptor or 2 for its word; back two vectors of 6 doubles. DOpt: 8 a number of a
    separator pose. Map merge: what the maps hold. The tables know no negotiation: its payload is 0, its wire bytes are
    not.
    """
    body = message.body
    if isinstance(body, SolverBody):
        return Traffic.DOPT, type(body).__name__, solver_messages.payload_bytes(body)
    if isinstance(body, Begin):
        return Traffic.DOPT, "Begin", 0
    if not isinstance(body, Award | Result):
        return Traffic.NEGOTIATION, type(body).__name__, 0
    work = body.task if isinstance(body, Award) else body.outcome
    payload = 0
    if isinstance(work, OwnerQuery):
        payload = len(work.vector) + 1 + 4
    elif isinstance(work, PlaceQuery):
        payload = len(work.vector)
    elif isinstance(work, PlaceAnswer):
        payload = 8 + 4
    elif isinstance(work, EarlierAnswer):
        payload = 8 + 4 + 4
    elif isinstance(work, PlaceRedirect):
        payload = 8 + 4 + 1
    elif isinstance(work, VerifyTask):
        payload = 1 + 4 + 4 + sum(part.nbytes for part in work.parts)
    elif isinstance(work, VerifyAnswer):
        payload = 2 * 6 * 8
    elif isinstance(work, MapDelivery):
        payload = work.payload_bytes
    return _OF_WORK[type(work)], type(work).__name__, payload
