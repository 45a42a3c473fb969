"""Ours: one agent keeps the place vectors of all, so that each key-frame travels once, and the rest as the default."""

from __future__ import annotations

from mas.policy.base import Outlook, default_sellers, optimisation_due
from mas.state import AgentState


class Directory:
    """Every key-frame is told to one agent, the lowest that answers, which knows whose key-frame looks most like it.

    A cluster of one, with an owner (compare :mod:`mas.policy.predecessor`): no two views of a place can fall into
    different clusters. It costs a place vector for each key-frame, whatever the number of agents; the directory learns
    vectors, no map. Where it falls silent the next one takes over, and knows what it was told from then on.
    """

    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        return [min({state.me, *outlook.reachable})]

    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        return sorted(state.group) if optimisation_due(state, outlook) else []

    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        return default_sellers(state, outlook)
