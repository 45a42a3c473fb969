"""The end of a run: maps change hands until nobody knows of anything new (final purchases, thesis section 4.3)."""

from __future__ import annotations

from ..contracts.context import AgentContext
from ..protocol.ids import OperationKind
from ..protocol.messages import MapNotice
from .operation import MapExchange

# An agent that lacks maps of its group asks for them after so many looks without anything new, and then waits no more.
_ASKS_AFTER = (4, 8, 16)


class FinalRound:
    """Each agent asks its partners once, then tells them what else it gets, and buys from who tells it something new:
    a map travels on through all who have met, however long the chain, and who has everything is not asked again.

    A notice may get lost: who lacks the map of a member of its group for long asks again.
    """

    def __init__(self, context: AgentContext, maps: MapExchange) -> None:
        self.context, self.maps = context, maps
        self.searching = True
        self._rounds = 0
        self._idle = 0

    @property
    def over(self) -> bool:
        """Whether there is nothing to buy, as far as the agent knows."""
        return not self.searching and not self.maps.stale.intersection(self._open(self.context.state.partners()))

    def _open(self, sellers: list[int]) -> list[int]:
        """Those of them from whom it may still buy."""
        config = self.context.state.config.merge
        allowed = config.enabled and self._rounds < config.closing_rounds
        return [a for a in sellers if self.context.may_call(a, OperationKind.MAPMERGE)] if allowed else []

    def choose(self, sellers: list[int]) -> list[int]:
        """Whom of these to buy from now."""
        sellers = self._open(sellers)
        wanted = [a for a in sellers if self._rounds == 0 or a in self.maps.stale]
        lacking = bool(self.context.state.group - {self.context.me} - self.maps.held.keys() - self.maps.refused_owners)
        self._idle = 0 if wanted else self._idle + 1
        if lacking and self._idle in _ASKS_AFTER:
            wanted = sellers
        self.searching = bool(wanted) or (bool(sellers) and lacking and self._idle < _ASKS_AFTER[-1])
        if self._rounds:
            self._announce(sellers)
        self._rounds += 1
        if not self.searching:
            self.maps.final_round()
        return wanted

    def _announce(self, partners: list[int]) -> None:
        """Tell them what they do not know to be here."""
        offers = self.maps.shop.offers(self.maps.held, self.context.closing)
        for partner in partners:
            news = self.maps.announcements.news(partner, offers)
            if news:
                self.maps.announcements.told(partner, news)
                self.context.tell(partner, None, MapNotice(news))
