"""The thesis's optimised system (section 3.9): agents that decide how many others each operation is worth, and with
Algorithm 4 also whom to ask."""

from __future__ import annotations

import math

import numpy as np

from ..state.agent_state import AgentState
from .base import Outlook, Policy, default_sellers, optimisation_due
from .linear_program import Numbers, Situation, decide
from .peer_sampling import draw, weights

# Agents in an optimisation peer-to-peer.
_PAIR = 2


class Autonomous(Policy):
    """Algorithms 2 and 3 decide anew at each key-frame; with a generator, Algorithm 4 draws whom to ask, without one
    those whom it asked least often come first: the thesis does not say, and nobody may be left out for good.

    The number of maps to buy stands until it is used, because map merging follows the optimisation (3.9.1) and is
    decided before it. When all sequences are over nothing is asked any more: optimise what is new with all, and buy
    until nothing is new, the final round of section 4.3.
    """

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        self._rng = rng
        self._numbers = Numbers(1, 0, 0)
        self._merge = 0
        self._matches = 0
        self._group = 1
        self._previous: frozenset[int] = frozenset()
        self._times_asked: dict[int, int] = {}

    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        self._decide(state)
        count = self._numbers.ask
        others = state.profile.others
        if self._rng is None:
            chosen = sorted(sorted(others, key=lambda a: (self._times_asked.get(a, 0), a))[:count])
        else:
            likely = weights(others, state.group, self._previous, outlook.distances)
            chosen = draw(others, likely, count, self._rng)
        self._times_asked.update({a: self._times_asked.get(a, 0) + 1 for a in chosen})
        if chosen:
            self._previous = frozenset(chosen)
        return chosen

    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        if not optimisation_due(state, outlook):
            return []
        if outlook.closing:
            return sorted(state.group)
        # Who shares a match with this agent has most to gain, the last one most of all; then lower numbers.
        partners, since = set(state.partners()), outlook.since_matched
        others = sorted(state.group - {state.me}, key=lambda a: (a not in partners, since.get(a, math.inf), a))
        # It may have met the first other agent since it decided, and alone there is nothing to optimise.
        return sorted([state.me, *others[: max(self._numbers.optimise, _PAIR) - 1]])

    def peer_to_peer(self, state: AgentState, outlook: Outlook) -> bool:
        """The number decided at the last key-frame holds for its bids too: two are the manager and itself."""
        return not outlook.closing and self._numbers.optimise <= _PAIR

    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        sellers = default_sellers(state, outlook)
        if outlook.closing or not sellers:
            return sellers
        sellers.sort(key=lambda a: (-outlook.since_bought.get(a, len(state.keyframes)), a))
        chosen, self._merge = sorted(sellers[: self._merge]), 0
        return chosen

    def _decide(self, state: AgentState) -> None:
        matches, group = len(state.accepted), len(state.group)
        agents = len(state.profile.others) + 1
        situation = Situation(agents, group - 1, matches > self._matches, group > self._group)
        self._numbers = decide(situation)
        self._merge = max(self._merge, self._numbers.merge)
        self._matches, self._group = matches, group
