"""Who knows that what is for sale here: so that at the end news of maps is told once, and nobody has to ask for it.

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

    def told(self, other: int, offers: Iterable[Offer]) -> None:
        """The other knows of these maps: it was told, or told me."""
        known = self._known.setdefault(other, {})
        for offer in offers:
            known[offer.owner] = max(offer.version, known.get(offer.owner, 0))

    def news(self, other: int, offers: Iterable[Offer]) -> tuple[Offer, ...]:
        """What of these the other does not know of; never its own map."""
        known = self._known.get(other, {})
        return tuple(o for o in offers if o.owner != other and o.version > known.get(o.owner, 0))
