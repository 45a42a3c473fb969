"""Own loop closures: an agent recognises a place of its own, which takes no message (thesis section 3.5)."""

from __future__ import annotations

import numpy as np

from ..contracts.context import AgentContext
from ..contracts.effects import NOTHING, Effects
from ..protocol.ids import MatchId
from ..state.agent_state import AgentState
from ..state.keyframe import KeyFrame
from ..state.place_match import Match
from .candidates import Candidate, Candidates, MatchCheck
from .comparison import kind_of, match_end, verify, view_of
from .verification import Verification

FARTHEST = 2.0
"""Distance of unit vectors that are opposite to each other."""
_BEGINNING = 3
"""Key-frames at the beginning of a track, and at the end of the one before, that are compared with each other."""
_APART_DEPTHS = 4.0
"""Path in median depths after which a camera that comes back closes a loop, however few key-frames it made."""
_SCALE_SIGMAS = 4.0
"""Standard deviations of the unit's drift that a loop may correct."""


class OwnLoops:
    """Compares key-frames with the agent's own much earlier ones, and verifies the nearest."""

    def __init__(self, context: AgentContext, candidates: Candidates, verification: Verification) -> None:
        self.context, self.candidates, self.verification = context, candidates, verification
        self.state = context.state

    def close(self, keyframe: KeyFrame, strict: float, wide: float) -> Effects:
        """Have the nearest own key-frame verified that is nearer than ``strict``; where nothing joins the two tracks,
        nearer than ``wide``."""
        newest = candidates_below(self.state, keyframe)
        if not keyframe.textured or not newest:
            return NOTHING
        effects = self._join_track_before(keyframe)
        found = self.candidates.nearest(keyframe.vector, below=newest)
        if found is None or found[1] >= wide:
            return effects
        wider = found[1] >= strict
        if wider and self.state.piece_of(found[0]).frame == self.state.piece_of(keyframe.index).frame:
            return effects
        return effects + self.consider(keyframe, self.state.keyframes[found[0]], found[1], wider)

    def consider(self, query: KeyFrame, match: KeyFrame, distance: float | None, wider: bool) -> Effects:
        """Verify a pair, unless it is known or close to one that is."""
        me = self.state.me
        candidate = Candidate(MatchId(me, query.index, me, match.index), self.context.now_ns, distance, wider=wider)
        return self._verified(candidate, query, match) if self.candidates.propose(candidate) else NOTHING

    def _join_track_before(self, keyframe: KeyFrame) -> Effects:
        """A track's first key-frames may still see what the last ones of the track before saw, however different the
        images are: they are verified whatever their vectors say."""
        first = self.state.piece_of(keyframe.index).first
        widened = self.state.config.places.widen_keyframes is not None
        if not widened or not first or keyframe.index - first >= _BEGINNING:
            return NOTHING
        effects = NOTHING
        for earlier in reversed(self.state.keyframes[max(first - _BEGINNING, 0) : first]):
            if earlier.track == keyframe.track - 1:
                apart = float(np.linalg.norm(earlier.vector - keyframe.vector))
                effects += self.consider(keyframe, earlier, min(apart, FARTHEST), wider=True)
        return effects

    def _verified(self, candidate: Candidate, query: KeyFrame, match: KeyFrame) -> Effects:
        verdict = verify(self.state, candidate.id, view_of(self.state, query), match)
        reason, learned = verdict.reason, None
        full = verdict.full_information
        if verdict.accepted and verdict.T_M_Q is not None and full is not None:
            ends = match_end(self.state, query), match_end(self.state, match)
            learned = Match.of(candidate.id, *ends, verdict.T_M_Q, full, verdict.inliers, match.depth)
            objection = implausible(self.state, learned)
            if objection:
                learned, reason = None, objection
        check = MatchCheck(
            verified=learned is not None,
            reason=kind_of(reason),
            detail=reason,
            matches=verdict.matches,
            inliers=verdict.inliers,
            rmse=float(verdict.rmse) if np.isfinite(verdict.rmse) else None,
            T_M_Q=verdict.T_M_Q,
        )
        self.candidates.checked(candidate.id, check)
        return NOTHING if learned is None else self.verification.learn(learned)


def candidates_below(state: AgentState, keyframe: KeyFrame) -> int:
    """Number of first key-frames that are loop candidates: all of earlier tracks, which no odometry links to this one;
    those many key-frames older; and those old enough in time that the camera has left since: a pause, of the camera or
    of the recording, makes no loop of its neighbours."""
    config, index = state.config.places, keyframe.index
    times = [k.time_ns for k in state.keyframes]
    old = int(np.searchsorted(times, keyframe.time_ns - round(config.own_age_s * 1e9), side="right"))
    if config.own_apart_keyframes is not None:
        way = state.travelled[index] - _APART_DEPTHS * keyframe.depth
        far = int(np.searchsorted(state.travelled[:index], way, side="right"))
        old = min(old, max(far, index - config.own_apart_keyframes + 1))
    many = 0 if config.own_age_keyframes is None else index - config.own_age_keyframes + 1
    return min(max(old, many, state.piece_of(index).first), index)


def implausible(state: AgentState, match: Match) -> str:
    """Why odometry cannot have drifted as far as an own loop says; empty where it can, and between tracks.

    The query may not move farther than a share of the path between. With one camera the unit drifts by a random walk
    on the way: each step adds its variance.
    """
    if match.query.track != match.match.track:
        return ""
    config = state.config.consistency
    way = state.travelled[match.id.query] - state.travelled[match.id.match]
    moved = match.joins() @ match.query.T_T_C[:3, 3] - match.query.T_T_C[:3, 3]
    if float(np.linalg.norm(moved)) > config.depth_share * match.depth + config.loop_drift * way:
        return "beyond odometry's drift"
    if state.profile.metric or match.scale_sigma is None:
        return ""
    steps = match.id.query - match.id.match
    drift = state.config.optimisation.odometry_sigma_scale * np.sqrt(steps)
    noise = np.hypot(match.scale_sigma, state.config.optimisation.match_sigma_scale)
    allowed, found = _SCALE_SIGMAS * float(np.hypot(drift, noise)), abs(float(np.log(match.T_M_Q.scale)))
    if found <= allowed:
        return ""
    return f"beyond the unit's drift: log scale {found:.2f}, {allowed:.2f} at most in {steps} key-frames"
