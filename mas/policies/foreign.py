"""Policies from outside this folder: a user's object, or an entry point of the group ``maslam.policies``.

Each agent gets a policy of its own, and what it answers is checked: an agent that does not exist is the policy's error,
not that of the message which would be sent to it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable
from copy import deepcopy
from numbers import Integral

from maslam.extensions import ExtensionGroup, load_extension, made, name_of

from ..errors import MasError
from ..protocol.messages import Bid
from ..state.agent_state import AgentState
from .base import Outlook, Policy

PolicyLike = Policy | type[Policy] | Callable[[], Policy]
"""A policy, of which each agent gets a copy, or what makes one for each agent."""


def foreign_policy(given: PolicyLike | str) -> Policy:
    """A new policy for one agent, with its answers checked; a ``str`` names an entry point."""
    if isinstance(given, str):
        name, extension = given, load_extension(ExtensionGroup.POLICIES, given)
    else:
        name, extension = name_of(given), given
    policy = made(extension, Policy, f"policy {name}")  # type: ignore[type-abstract]
    return CheckedPolicy(name, deepcopy(policy) if policy is extension else policy)


class CheckedPolicy(Policy):
    """``inner`` with its answers checked; ``MasError`` names it by ``name``."""

    def __init__(self, name: str, inner: Policy) -> None:
        self.name, self.inner = name, inner
        self.ownership = inner.ownership

    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        return self._agents("ask", self.inner.ask(state, outlook, keyframe), {state.me, *state.profile.others})

    def recall(self, state: AgentState, outlook: Outlook, fresh: int) -> dict[int, int]:
        counts = self.inner.recall(state, outlook, fresh)
        agents = self._agents("recall", counts, {state.me, *state.profile.others})
        return {agent: int(counts[agent]) for agent in agents}

    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        members = self._agents("optimise", self.inner.optimise(state, outlook), state.group)
        if members and state.me not in members:
            raise MasError(f"policy {self.name}: optimise() of agent {state.me} leaves the agent itself out: {members}")
        return sorted(members)

    def peer_to_peer(self, state: AgentState, outlook: Outlook) -> bool:
        return bool(self.inner.peer_to_peer(state, outlook))

    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        return self._agents("buy", self.inner.buy(state, outlook), set(state.profile.others))

    def worth(self, reputation: float, benefit: float, bid: Bid, deadline_ns: int) -> float:
        value = float(self.inner.worth(reputation, benefit, bid, deadline_ns))
        if not math.isfinite(value):
            raise MasError(f"policy {self.name}: worth() gave {value}; a finite number is meant")
        return value

    def _agents(self, method: str, answer: Iterable[int], known: Collection[int]) -> list[int]:
        """The answer as plain numbers, each once."""
        if not isinstance(answer, Iterable) or not all(isinstance(agent, Integral) for agent in answer):
            raise MasError(f"policy {self.name}: {method}() gave {answer!r}; numbers of agents are meant")
        agents = list(dict.fromkeys(int(agent) for agent in answer))
        strange = [agent for agent in agents if agent not in known]
        if strange:
            there = ", ".join(map(str, sorted(known))) or "none"
            raise MasError(f"policy {self.name}: {method}() named agent {strange[0]}; it may name {there}")
        return agents
