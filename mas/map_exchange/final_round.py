"""The end of a run: maps are exchanged until no agent knows of anything new (final purchases, thesis section 4.3)."""

from __future__ import annotations

from dataclasses import dataclass

from ..contracts.context import AgentContext
from ..contracts.effects import NOTHING, Effects
from ..protocol.ids import OperationKind
from .operation import MapExchange

# An agent that lacks maps of its group asks for them after so many looks without anything new, and then waits no more.
_ASKS_AFTER = (4, 8, 16)


@dataclass(frozen=True)
class Purchase:
    """Agents to buy maps from now, and the effects of choosing them."""

    sellers: tuple[int, ...]
    effects: Effects


class FinalRound:
    """Each agent asks its partners once, then announces to them what else it gets, and buys from those that announce
    something new: a map is passed on along any chain of partners, and an agent that has everything is not asked again.

    A notice may get lost: who lacks the map of a member of its group for long asks again.
    """

    def __init__(self, context: AgentContext, maps: MapExchange) -> None:
        self.context, self.maps = context, maps
        self._searching = True
        self._rounds = 0
        self._idle = 0

    @property
    def over(self) -> bool:
        """Whether there is nothing to buy, as far as the agent knows."""
        return not self._searching and not self.maps.stale.intersection(self._open(self.context.state.partners()))

    def _open(self, sellers: list[int]) -> list[int]:
        """Sellers among them from which it may still buy."""
        config = self.context.state.config.merge
        allowed = config.enabled and self._rounds < config.closing_rounds
        return [a for a in sellers if self.context.may_call(a, OperationKind.MAPMERGE)] if allowed else []

    def reopen(self) -> None:
        """An optimisation was adopted: others may have newer maps."""
        self._searching = True

    def buy(self, sellers: list[int]) -> Effects:
        """Buy from those of these that may have something new, unless a purchase goes on."""
        if self.context.calling(OperationKind.MAPMERGE):
            return NOTHING
        chosen = self.choose(sellers)
        return chosen.effects + (self.maps.buy(list(chosen.sellers)) if chosen.sellers else NOTHING)

    def choose(self, sellers: list[int]) -> Purchase:
        """Agents of these to buy from now, and announcements to the others."""
        sellers = self._open(sellers)
        wanted = [a for a in sellers if self._rounds == 0 or a in self.maps.stale]
        lacking = bool(
            self.context.state.group - {self.context.me} - self.maps.copies.keys() - self.maps.refused_owners
        )
        self._idle = 0 if wanted else self._idle + 1
        if lacking and self._idle in _ASKS_AFTER:
            wanted = sellers
        self._searching = bool(wanted) or (bool(sellers) and lacking and self._idle < _ASKS_AFTER[-1])
        effects = self.maps.announce(sellers) if self._rounds else NOTHING
        self._rounds += 1
        if not self._searching:
            effects += self.maps.check_at_end()
        return Purchase(tuple(wanted), effects)
