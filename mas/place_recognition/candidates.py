"""Match candidates of an agent: vectors of its key-frames, candidate matches and their outcomes."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from maslam.backend.geometry import Sim3
from maslam.descriptors.search import NearestIndex

from ..protocol.ids import MatchId
from ..state.agent_state import AgentState
from ..state.keyframe import KeyFrame
from ..state.place_match import MatchOutcome, SkipReason
from .match_spacing import WORTH, DriftAlong, MeasuredDrift

# Matches with another agent before their spacing follows the drift.
_ENOUGH = 2


@dataclass(frozen=True, eq=False)
class MatchCheck:
    """What came of a candidate's verification: whether it was ``verified``; ``reason``: why not, in words that can be
    counted; ``detail``: with figures; tentative ``matches`` of points, of which ``inliers`` fit ``T_M_Q``, with
    ``rmse`` (degrees)."""

    verified: bool = False
    reason: str = ""
    detail: str = ""
    matches: int = 0
    inliers: int = 0
    rmse: float | None = None
    T_M_Q: Sim3 | None = None


@dataclass(frozen=True, eq=False)
class Candidate:
    """A place match on its way: a row of ``matches.csv``.

    ``distance`` of the vectors, None where nobody compared them; ``check``: its verification, as far as there was one;
    ``wider``: it lies beyond the strict distance, and was considered because the two agents are not in one frame;
    ``named_by``: a third agent that said so.
    """

    id: MatchId
    now_ns: int
    distance: float | None
    check: MatchCheck = MatchCheck()
    wider: bool = False
    named_by: int | None = None


@dataclass
class Candidates:
    """Candidates of the agent's own queries, and when it was last matched with whom. ``by_id``: all candidates;
    ``gaps``: own key-frames until a next match with that agent is worth it.

    ``recalled``: own key-frames that were sent to others later than they were made. ``lengths``: how many key-frames
    another agent has said that it has.

    ``whole``, ``kept``: vectors of its own key-frames, and what the place code keeps of them; one and the same where
    that is everything.
    """

    state: AgentState
    whole: NearestIndex = field(default_factory=NearestIndex)
    kept: NearestIndex = field(default_factory=NearestIndex)
    by_id: dict[MatchId, Candidate] = field(default_factory=dict)
    last_matched: dict[int, int] = field(default_factory=dict)
    gaps: dict[int, int] = field(default_factory=dict)
    verified: dict[int, list[int]] = field(default_factory=dict)
    recalled: set[int] = field(default_factory=set)
    lengths: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.measured = MeasuredDrift(self.state.config.optimisation)
        self._along: dict[int, DriftAlong | None] = {}
        self._along_of: set[MatchId] = set()
        self._share = 0.0
        if self.state.profile.coder.whole:
            self.kept = self.whole

    def remember(self, keyframe: KeyFrame) -> None:
        """Make a key-frame findable. One without texture is left out: its vector says nothing."""
        if not keyframe.textured:
            return
        self.whole.add(keyframe.index, keyframe.vector)
        if self.kept is not self.whole:
            self.kept.add(keyframe.index, self.state.profile.coder.cut(keyframe.vector[None])[0])

    def nearest(self, vector: NDArray[np.float32], below: int) -> tuple[int, float] | None:
        """Index and Euclidean distance (0 to 2) of the own key-frame nearest to an own vector, among those with index
        < ``below``; the older one of equals."""
        found = self.whole.nearest(vector, below)
        return None if found is None else (found[0], min(found[1], 2.0))

    def nearest_to_decoded(self, vector: NDArray[np.float32]) -> tuple[int, float] | None:
        """The same for another agent's vector as it was decoded, among all own key-frames; the distance is that
        between the uncoded vectors as far as the code lets it be known."""
        found = self.kept.nearest(vector)
        return None if found is None else (found[0], self.restored(found[1]))

    def nearest_of_new(self, vector: NDArray[np.float32], first: int) -> tuple[int, float] | None:
        """The same among own key-frames from ``first`` on: for the few that came since the last look."""
        new = [k for k in self.state.keyframes[first:] if k.textured]
        if not new:
            return None
        kept = self.state.profile.coder.cut(np.array([k.vector for k in new]))
        apart = np.linalg.norm(kept - vector, axis=1)
        best = int(apart.argmin())
        return new[best].index, self.restored(float(apart[best]))

    def restored(self, distance: float) -> float:
        """The distance between two uncoded vectors, 0 to 2, from that to a decoded one."""
        return min(self.state.profile.coder.restored(distance), 2.0)

    def propose(self, candidate: Candidate) -> bool:
        """Enter a candidate; whether it is worth a verification. If not, its reason says why."""
        if candidate.id in self.by_id:
            return False
        reason = self._why_not(candidate.id)
        self.by_id[candidate.id] = replace(candidate, check=MatchCheck(reason=reason or ""))
        return reason is None

    def insist(self, candidate: Candidate) -> None:
        """A candidate that was skipped is to be verified after all."""
        self.by_id[candidate.id] = replace(candidate, check=MatchCheck())

    def still_wanted(self, match: MatchId) -> bool:
        """Whether a candidate that waited is worth its verification by now. If not, its reason says why."""
        reason = self._why_not(match)
        if reason is not None and reason is not SkipReason.KNOWN:
            self.by_id[match] = replace(self.by_id[match], check=MatchCheck(reason=reason))
            return False
        return True

    def checked(self, match: MatchId, check: MatchCheck) -> None:
        """A candidate of the agent's own queries was checked; a match that others found is none, and is left out."""
        if match in self.by_id:
            self.by_id[match] = replace(self.by_id[match], check=check)
            if check.verified:
                self.verified.setdefault(match.match_agent, []).append(match.query)

    def noted_length(self, other: int, keyframes: int) -> None:
        """Another agent has said how many key-frames it has."""
        self.lengths[other] = max(keyframes, self.lengths.get(other, 0))

    def recall(self, keyframe: int) -> None:
        """An own key-frame is sent to others later than it was made."""
        self.recalled.add(keyframe)

    def matched(self, match: MatchId) -> None:
        """An accepted match: from now on the gap to the next verification with the other agent counts."""
        mine, other = match.end_of(self.state.me)
        self.last_matched[other] = max(mine, self.last_matched.get(other, mine))
        self.gaps[other] = self._gap_after(match)

    def drift_along(self, other: int) -> DriftAlong | None:
        """Expected drift along the own path since the matches with another agent; None without one."""
        if self._along_of != self.state.accepted:
            self._along_of, self._along = set(self.state.accepted), {}
            self._share = self.measured.share(self.state.accepted_matches(), self.state.me)
        if other not in self._along:
            self._along[other] = self._made_along(other)
        return self._along[other]

    def _made_along(self, other: int) -> DriftAlong | None:
        state, me = self.state, self.state.me
        matches = [m for m in state.accepted_matches() if other in m.id.agents]
        if not matches:
            return None
        ends = sorted((m.id.end_of(me)[0], m.id.end_of(other)[0]) for m in matches)
        noise = float(np.median([self.measured.noise(m, me) for m in matches]))
        step = state.travelled[-1] / max(len(state.keyframes) - 1, 1)
        depth, scaled = state.keyframes[ends[-1][0]].depth, matches[-1].scale_sigma is not None
        return DriftAlong(ends, noise, self._share, step, depth, state.config.optimisation, scaled)

    def _gap_after(self, match: MatchId) -> int:
        """Own key-frames until odometry is expected to have drifted so far that the next match is worth it."""
        config, other = self.state.config.places, match.end_of(self.state.me)[1]
        least = config.gap_keyframes if config.gap_least_keyframes is None else config.gap_least_keyframes
        most = config.gap_keyframes if config.gap_most_keyframes is None else config.gap_most_keyframes
        if least == most or other == self.state.me:
            return config.gap_keyframes
        drift = self.drift_along(other)
        if drift is None or len(drift.matched) < _ENOUGH:
            return config.gap_keyframes
        return next((gap for gap in range(least, most) if drift.over(gap, gap) >= WORTH), most)

    def outcome_of(self, candidate: Candidate) -> tuple[MatchOutcome, str]:
        """The outcome of a candidate, and why, as it stands now."""
        if candidate.id in self.state.accepted:
            return MatchOutcome.ACCEPTED, "accepted"
        if candidate.check.verified:
            return MatchOutcome.REJECTED, "no agreeing match"
        reason = candidate.check.reason or SkipReason.NOT_VERIFIED.value
        return (MatchOutcome.SKIPPED if reason in list(SkipReason) else MatchOutcome.REJECTED), reason

    def _why_not(self, match: MatchId) -> SkipReason | None:
        turned = MatchId(match.match_agent, match.match, match.query_agent, match.query)
        if turned in self.state.verified or turned in self.by_id:
            return SkipReason.KNOWN
        config = self.state.config.places
        # On both sides: an earlier key-frame may be asked about later.
        gap = min(config.gap_keyframes, self.gaps.get(match.match_agent, config.gap_keyframes))
        recent = [q for q in self.verified.get(match.match_agent, []) if abs(match.query - q) <= gap]
        if len(recent) > self.state.config.consistency.min_support:
            return SkipReason.CLOSE_TO_VERIFIED
        # What is asked late comes between matches that are there: not only the last one may be near.
        late = match.query in self.recalled
        beside = config.gap_keyframes if late else self.gaps.get(match.match_agent, config.gap_keyframes)
        near = any(self._near(match.query, k, beside) for k in self._matched_with(match.match_agent))
        return SkipReason.CLOSE_TO_ACCEPTED if near else None

    def _near(self, one: int, other: int, gap: int) -> bool:
        """Whether two own key-frames are within ``gap`` of each other, or within ``gap_m``."""
        way = self.state.travelled
        return abs(one - other) <= gap or abs(way[one] - way[other]) < self.state.config.places.gap_m

    def _matched_with(self, other: int) -> list[int]:
        """Own key-frames of the accepted matches with another agent."""
        return [m.end_of(self.state.me)[0] for m in self.state.accepted if other in m.agents]
