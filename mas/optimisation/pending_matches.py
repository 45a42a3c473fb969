"""Pending matches: accepted and not yet used by an optimisation, or used by one that did not reach all members."""

from __future__ import annotations

from collections.abc import Iterable

from ..protocol.ids import MatchId
from ..state.agent_state import AgentState


class PendingMatches:
    """``optimised_at``: how many key-frames there were at the last optimisation."""

    def __init__(self, state: AgentState) -> None:
        self.state = state
        self.optimised_at = 0
        self._used: set[MatchId] = set()
        self._once_used: set[MatchId] = set()
        self._offered: set[MatchId] = set()
        self._called_again = 0
        self._refused = 0

    @property
    def matches(self) -> set[MatchId]:
        """Matches accepted or withdrawn since the last optimisation."""
        return self.state.accepted ^ self._used

    def offered(self, members: Iterable[int]) -> None:
        """Matches accepted now among these agents go into an optimisation: they count as used afterwards, even if
        others lack it."""
        among = {self.state.me, *members}
        self._offered = {m for m in self.state.accepted if among.issuperset(m.agents)}

    def used(self, matches: frozenset[MatchId], elsewhere: frozenset[MatchId] = frozenset()) -> None:
        """An optimisation was adopted; matches ``elsewhere`` join other tracks, and stay what they were."""
        self._refused = 0
        if matches - self._once_used:
            self._called_again = 0
        self._once_used |= matches
        before = self._used & elsewhere
        self._used = set(matches) | ((self._offered - elsewhere | before) & self.state.accepted)
        self.optimised_at = len(self.state.keyframes)

    def refused(self, most: int) -> None:
        """The agent kept its poses, as a member must have lied: it calls again, at most ``most`` times running."""
        self.optimised_at = len(self.state.keyframes)
        self._refused += 1
        if self._refused > most:
            self._used = set(self.state.accepted)

    def call_again(self) -> bool:
        """Some member missed the optimisation or its end: what was used is pending once more, a few times; whether it
        is."""
        again = self._called_again < self.state.config.link.retries
        if again:
            self._called_again += 1
            self._used = set()
        return again
