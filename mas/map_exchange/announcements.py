"""Offers that each other agent knows of: at the end a new map is announced once, and no agent has to ask for it.

Smith's contract net has announcements of idle nodes beside those of tasks (1980, section "node available"); this is one
of who has something to sell.
"""

from __future__ import annotations

from collections.abc import Iterable

from ..protocol.messages import Offer


class Announcements:
    """For each other agent the newest version of each map that it knows to be here, or has offered itself."""

    def __init__(self) -> None:
        self._known: dict[int, dict[int, int]] = {}

    def known_to(self, other: int, offers: Iterable[Offer]) -> None:
        """The other knows of these maps: it has got or made an offer of them."""
        known = self._known.setdefault(other, {})
        for offer in offers:
            known[offer.owner] = max(offer.version, known.get(offer.owner, 0))

    def new_for(self, other: int, offers: Iterable[Offer]) -> tuple[Offer, ...]:
        """Those of the offers that the other does not know of; never its own map."""
        known = self._known.get(other, {})
        return tuple(o for o in offers if o.owner != other and o.version > known.get(o.owner, 0))
