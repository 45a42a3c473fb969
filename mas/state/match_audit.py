"""Whether what another agent reported agrees with everything else that is known."""

from __future__ import annotations

from .agent_state import AgentState

# So many matches between two tracks, none of which agrees with another: all but one must be wrong.
_NONE_AGREE = 3


def judged(state: AgentState, other: int) -> tuple[int, int]:
    """Count the matches that ``other`` verified for this agent: those borne out, and those contradicted.

    Borne out: in the largest set between the two tracks that agrees. Contradicted: such a set exists without it; or the
    group's other matches say otherwise (:mod:`maslam.mas.optimisation.cycle_consistency`); or there is none that agrees
    although there are several matches, of which at most one can be true: that one is forgiven.
    """
    borne_out = contradicted = 0
    for agreeing, all_of_pair in state.agreements_with(other):
        reported = {m for m in all_of_pair if m.match_agent == other}
        if agreeing:
            good = reported & agreeing - state.contradicted
            borne_out += len(good)
            contradicted += len(reported - good)
        elif len(all_of_pair) >= _NONE_AGREE:
            contradicted += max(len(reported) - 1, 0)
    return borne_out, contradicted
