"""The search for places grows wider while two agents are not in one frame.

Candidates within the strict distance are verified at once. Those beyond it, but within the candidate's, are kept, and
while nothing joins the two agents the likeliest of them are verified too: one for so many own key-frames, a few more
when all sequences are over. Of a match that geometry confirms and no other supports the neighbours are verified, also
where others join the two agents: what ties two tracks at one place only may close a loop of the whole team. So the
bytes are bounded whatever the images are; what counts as a match is what counted before.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from ..protocol.ids import MatchId
from ..state.agent_state import AgentState
from .candidates import Candidate, Candidates

# Key-frames between two candidates, at both ends, within which they support each other.
_NEAR = 5
# More supporters than this say nothing new.
_SUPPORTERS = 2
# Pairs beside one that geometry confirmed, at most; not before so many own key-frames have passed: most matches find
# their support by themselves.
_MORE, _PATIENCE = 3, 10
# Candidates more of a group once all sequences are over, one at least of each member.
_CLOSING = 8


@dataclass(eq=False)
class WiderSearch:
    """``candidates``: all of the agent's."""

    candidates: Candidates
    _kept: dict[MatchId, Candidate] = field(default_factory=dict)

    def keep(self, candidate: Candidate) -> None:
        """A candidate beyond the strict distance."""
        if self._every is not None:
            self._kept[candidate.id] = replace(candidate, wider=True)

    def due(self, closing: bool) -> list[Candidate]:
        """Candidates to be verified now: the likeliest of the agents that nothing joins to this one, and those beside
        evidence."""
        if self._every is None:
            return []
        chosen = {c.id.match_agent: c for c in reversed(self._beside_evidence(0 if closing else _PATIENCE))}
        # A group's members share what is tried at the end: each of them stands before the same other group.
        last = max(1, _CLOSING // len(self._state.group)) if closing else 0
        room = len(self._state.keyframes) // self._every + last - self._tried()
        kept = [c for c in self._unjoined() if c.id.match_agent not in chosen]
        if room > 0 and kept:
            best = min(kept, key=lambda c: (-_support(c, kept), c.distance or 0.0, c.id))
            chosen[best.id.match_agent] = best
        return [chosen[other] for other in sorted(chosen)]

    @property
    def _state(self) -> AgentState:
        return self.candidates.state

    @property
    def _every(self) -> int | None:
        return self._state.config.places.widen_keyframes

    def _tried(self) -> int:
        """Candidates verified so far, beside those near a match that geometry confirmed, which nobody compared."""
        return sum(match in self.candidates.by_id for match in self._kept)

    def _unjoined(self) -> list[Candidate]:
        """What is kept with agents that nothing joins to this one, and not tried yet."""
        waiting = [c for match, c in sorted(self._kept.items()) if match not in self.candidates.by_id]
        return [c for c in waiting if c.id.match_agent not in self._state.group]

    def _beside_evidence(self, patience: int) -> list[Candidate]:
        """Of each own verified match that no other supports, ``patience`` key-frames later: the next pair of
        neighbouring key-frames, a few in all. Views next to two that geometry joins overlap as well, however far apart
        their vectors are."""
        found, newest = [], len(self._state.keyframes) - 1 - patience
        mine = [m for m in self._state.verified if m.query_agent == self._state.me and m.query <= newest]
        unsupported = [m for m in mine if self._is_alone(m)]
        for match in sorted(unsupported):
            beside = [c for c in self.candidates.by_id if _apart(c, match) == 1]
            fresh = [m for m in self._neighbours(match) if m not in self.candidates.by_id]
            if fresh and len(beside) < _MORE:
                found.append(Candidate(fresh[0], 0, None, wider=True))
        return found

    def _is_alone(self, match: MatchId) -> bool:
        """Whether no match joins its two tracks yet: one that differs from accepted ones is wrong, not alone."""
        state, tracks = self._state, set(self._state.verified[match].tracks)
        return not any(set(m.tracks) == tracks for m in state.accepted_matches())

    def _neighbours(self, match: MatchId) -> list[MatchId]:
        """Pairs of the key-frames next to a match's that are known to exist."""
        mine, theirs = len(self._state.keyframes), self._known_of(match.match_agent)
        steps = [(1, 1), (-1, -1), (1, 0), (-1, 0), (0, -1), (0, 1), (1, -1), (-1, 1)]
        pairs = [(match.query + a, match.match + b) for a, b in steps]
        there = [(q, m) for q, m in pairs if 0 <= q < mine and 0 <= m < theirs]
        return [MatchId(match.query_agent, q, match.match_agent, m) for q, m in there]

    def _known_of(self, other: int) -> int:
        """Number of an agent's key-frames; of another's as far as its answers tell."""
        if other == self._state.me:
            return len(self._state.keyframes)
        named = [m.match for m in (*self.candidates.by_id, *self._kept) if m.match_agent == other]
        return max(max(named, default=-1) + 1, self.candidates.lengths.get(other, 0))


def _support(candidate: Candidate, kept: list[Candidate]) -> int:
    """Other candidates that say the same of neighbouring key-frames, up to a few."""
    return min(sum(_apart(candidate.id, c.id) <= _NEAR for c in kept if c is not candidate), _SUPPORTERS)


def _apart(one: MatchId, other: MatchId) -> float:
    """Key-frames between two candidates of the same two agents, at the end where there are more."""
    if (one.query_agent, one.match_agent) != (other.query_agent, other.match_agent):
        return float("inf")
    return max(abs(one.query - other.query), abs(one.match - other.match))
