"""The end of a stretch that two agents share: what comes after it hangs on its last match.

While they drive, a candidate close to an accepted match is skipped: the next one may be as good. At the end there is no
next one. So of what was skipped with each agent the one farthest from all matches is verified, where odometry may have
drifted by more than a match is off since then.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..state.place_match import MatchOutcome, SkipReason
from .candidates import Candidate, Candidates

# Of the way after which another match was worth it; that asked for a drift of a few times a match's noise.
_SHARE = 0.33
# Key-frames beside a match that say the same as it.
_SAME = 3
_CLOSE = (SkipReason.CLOSE_TO_ACCEPTED, SkipReason.CLOSE_TO_VERIFIED)


@dataclass(eq=False)
class OverlapEnds:
    """``candidates``: all of the agent's."""

    candidates: Candidates

    def due(self, ticks: int) -> list[Candidate]:
        """Skipped candidates that are worth it after all, one with each agent, ``ticks`` after the end: both agents
        may have some of one and the same stretch, and the one with the lower number comes first."""
        farthest: dict[int, tuple[int, Candidate]] = {}
        for candidate in self.candidates.by_id.values():
            other = candidate.id.match_agent
            if other == self._me or (other < self._me and ticks < 1):
                continue
            outcome, reason = self.candidates.outcome_of(candidate)
            ends = self._matched_with(other)
            if outcome is not MatchOutcome.SKIPPED or reason not in _CLOSE or not ends:
                continue
            apart = min(abs(candidate.id.query - end) for end in ends)
            if apart > self._near(other) and apart > farthest.get(other, (0, candidate))[0]:
                farthest[other] = (apart, candidate)
        return [candidate for _, (_, candidate) in sorted(farthest.items())]

    @property
    def _me(self) -> int:
        return self.candidates.state.me

    def _near(self, other: int) -> float:
        """Key-frames within which an accepted match says enough."""
        config = self.candidates.state.config.places
        return max(_SHARE * self.candidates.ways.get(other, config.gap_keyframes), _SAME)

    def _matched_with(self, other: int) -> list[int]:
        """Own key-frames of accepted matches with another agent."""
        accepted = self.candidates.state.accepted
        return [m.end_of(self._me)[0] for m in accepted if other in m.agents]
