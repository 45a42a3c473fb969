"""The end of a stretch that two agents share: what comes after it hangs on its last match.

While they drive, a candidate close to an accepted match is skipped: the next one may be as good. At the end there is no
next one. So of what was skipped with each agent the pair since whose nearest matches odometry has drifted most, by what
is measured of it, is verified, and the next, as long as that is worth it.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..state.place_match import MatchOutcome, SkipReason
from .candidates import Candidate, Candidates

# Variance of drift, in variances of a match, from which on one is worth it.
_WORTH = 0.2
_CLOSE = (SkipReason.CLOSE_TO_ACCEPTED, SkipReason.CLOSE_TO_VERIFIED)


@dataclass(eq=False)
class OverlapEnds:
    """``candidates``: all of the agent's."""

    candidates: Candidates

    def due(self, ticks: int) -> list[Candidate]:
        """Skipped candidates that are worth it after all, one with each agent, ``ticks`` after the end: both agents
        may have some of one and the same stretch, and the one with the lower number comes first."""
        skipped: dict[int, list[Candidate]] = {}
        for candidate in self.candidates.by_id.values():
            other = candidate.id.match_agent
            if other == self._me or (other < self._me and ticks < 1):
                continue
            outcome, reason = self.candidates.outcome_of(candidate)
            if outcome is MatchOutcome.SKIPPED and reason in _CLOSE:
                skipped.setdefault(other, []).append(candidate)
        found = [self._worst(other, pairs) for other, pairs in sorted(skipped.items())]
        return [candidate for candidate in found if candidate is not None]

    @property
    def _me(self) -> int:
        return self.candidates.state.me

    def _worst(self, other: int, pairs: list[Candidate]) -> Candidate | None:
        """The pair where odometry may have drifted most, if a match is worth it there."""
        drift = self.candidates.drift_along(other)
        if drift is None:
            return None
        at = {c.id: drift.at(c.id.query, c.id.match) for c in pairs if not drift.close(c.id.query, self._same)}
        if not at:
            return None
        best = max(at, key=lambda match: at[match])
        return self.candidates.by_id[best] if at[best] > _WORTH else None

    @property
    def _same(self) -> int:
        """Key-frames beside a match that say the same as it."""
        config = self.candidates.state.config.places
        return config.gap_keyframes if config.gap_least_keyframes is None else config.gap_least_keyframes
