"""Ours: one agent keeps the place vectors of all, so that each key-frame travels once, and the rest as the default."""

from __future__ import annotations

from ..state.agent_state import AgentState, Ownership
from .base import Outlook, Policy, default_sellers, optimisation_due

# Key-frames that a new directory must have taken in before earlier ones are sent to it.
_SURE = 2


class Directory(Policy):
    """Every key-frame is sent to one agent, the lowest that answers, which knows whose key-frame looks most like it.

    A cluster of one, with an owner (compare :mod:`maslam.mas.policies.predecessor`): no two views of a place can fall
    into different clusters. It costs a place vector for each key-frame, whatever the number of agents; the directory
    learns vectors, no map. Where it falls silent the next one takes over and, once it has taken in some, gets
    earlier key-frames, too: one for each new one, so that a silence that soon ends at most doubles what is sent in the
    meantime, and the rest when there are no new ones any more.
    """

    ownership = Ownership.DIRECTORY

    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        return [_directory(state, outlook)]

    def recall(self, state: AgentState, outlook: Outlook, fresh: int) -> dict[int, int]:
        directory, everything = _directory(state, outlook), len(state.keyframes)
        if directory == state.me:
            return {directory: everything}
        sure = outlook.delivered.get(directory, 0) >= _SURE
        if outlook.closing:
            return {directory: everything if sure else 1}
        return {directory: fresh} if sure else {}

    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        return sorted(state.group) if optimisation_due(state, outlook) else []

    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        return default_sellers(state, outlook)


def _directory(state: AgentState, outlook: Outlook) -> int:
    return min({state.me, *outlook.reachable})
