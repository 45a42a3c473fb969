"""The thesis's default system (sections 3.5 to 3.8, 4.2): ask all, optimise with the whole group, buy from those one
has met."""

from __future__ import annotations

from ..state.agent_state import AgentState
from .base import Outlook, Policy, default_sellers, optimisation_due


class QueryAll(Policy):
    """No logic beyond the order of operations: place recognition, then optimisation, then map merging.

    With ``ask_again`` off, an agent that was matched within the last ``gap_keyframes`` key-frames is not asked: its
    answer could not lead to a verification anyway.
    """

    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        others = list(state.profile.others)
        if state.config.ask_again:
            return others
        gap = state.config.places.gap_keyframes
        return [a for a in others if outlook.since_matched.get(a, gap + 1) > gap]

    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        return sorted(state.group) if optimisation_due(state, outlook) else []

    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        return default_sellers(state, outlook)
