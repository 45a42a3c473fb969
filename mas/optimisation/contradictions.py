"""Matches that the rest of a group contradicts, held against the agents that reported them."""

from __future__ import annotations

from ..contracts.context import AgentContext
from ..contracts.effects import Effects, total
from ..protocol.ids import MatchId
from ..state.match_audit import judged


def hold_against(context: AgentContext, contradicted: frozenset[MatchId]) -> Effects:
    """Matches that a whole group's matches contradict count against the agent that reported them, as long as that is
    so. Where several agents may have reported the wrong ones nobody is blamed."""
    state = context.state
    reporters = sorted({m.match_agent for m in contradicted})
    before = {m.match_agent for m in state.contradicted}
    state.contradicted = contradicted if len(reporters) == 1 else frozenset()
    effects = total(context.judged(a, *judged(state, a)) for a in sorted(before | set(reporters)))
    if not reporters:
        return effects
    return effects + context.event("contradicted", reported_by=reporters, matches=len(contradicted))
