"""Decisions of an agent: which agents to ask, when to optimise and with which, when to buy maps and from which.

A policy sees its own agent's state and nothing else, and changes nothing: its answers are wishes that the agent turns
into calls for proposals. The thesis's agent logic and selection (sections 3.9.1 and 3.9.2) are policies of this kind.
A user's own derives from :class:`Policy` and is given as ``maslam.run(..., policy=...)`` or by an entry point of the
group ``maslam.policies``.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field

from ..protocol.messages import Bid
from ..state.agent_state import AgentState, Ownership
from .utility import utility


@dataclass(frozen=True)
class Outlook:
    """Facts that a policy may use beside the state.

    ``pending_matches``: accepted matches that no optimisation has used yet; ``since_optimised``, ``since_bought``: own
    key-frames since the last optimisation, and since the last purchase from each agent (absent: never);
    ``since_matched``: likewise since the last accepted match; ``stale``: agents whose maps should be newer since the
    last purchase (a match or an optimisation came between); ``distances``: how near each agent's last answer to a place
    query came, 0 to 2; ``reachable``: others that are worth a question; ``closing``: all sequences have ended;
    ``delivered``: place queries that each agent answered since the last that it did not.
    """

    pending_matches: int
    since_optimised: int
    since_bought: dict[int, int]
    since_matched: dict[int, int]
    stale: frozenset[int]
    distances: dict[int, float]
    reachable: frozenset[int]
    closing: bool
    delivered: dict[int, int] = field(default_factory=dict)


class Policy(ABC):
    """Decisions of one agent; each agent has a policy of its own. Deterministic: what is drawn comes from a generator
    seeded with ``[state.config.seed, state.me]``.

    ``ownership``: who keeps the place vectors of others. Agents are numbered from 0; ``state.me`` is this one,
    ``state.profile.others`` are the others, ``state.group`` those that share its frame, itself included.
    """

    ownership: Ownership = Ownership.NONE

    @abstractmethod
    def ask(self, state: AgentState, outlook: Outlook, keyframe: int) -> list[int]:
        """Agents to ask whether they know the place of this key-frame."""

    def recall(self, state: AgentState, outlook: Outlook, fresh: int) -> dict[int, int]:
        """Agents to tell of earlier key-frames that they do not know, and of how many, after ``fresh`` new ones; no
        policy of the thesis does."""
        return {}

    @abstractmethod
    def optimise(self, state: AgentState, outlook: Outlook) -> list[int]:
        """Agents to optimise with, itself included; empty: not now."""

    def peer_to_peer(self, state: AgentState, outlook: Outlook) -> bool:
        """Whether to bid for an optimisation with its manager only, instead of the group's (thesis sections 3.6,
        3.9.1); without agent logic never."""
        return False

    @abstractmethod
    def buy(self, state: AgentState, outlook: Outlook) -> list[int]:
        """Agents to buy maps from; empty: not now."""

    def worth(self, reputation: float, benefit: float, bid: Bid, deadline_ns: int) -> float:
        """Worth of a bid for a map: of several sellers the one whose bid is worth most is awarded, and none whose bid
        is worth nothing. ``reputation``: of the bidder with this agent, 0 to 1; ``benefit``: new
        key-frames."""
        return utility(reputation, benefit, bid, deadline_ns)


def optimisation_due(state: AgentState, outlook: Outlook) -> bool:
    """Whether there is something new and it is time: ``period_keyframes`` after the last optimisation, lower numbers
    first. Members of a group are due at the same time, and one call is enough."""
    config = state.config.optimisation
    rank = sorted(state.group).index(state.me)
    wait = config.period_keyframes + min(rank, config.period_keyframes)
    due = (outlook.closing and config.closing) or outlook.since_optimised >= wait
    return bool(outlook.pending_matches) and due


def default_sellers(state: AgentState, outlook: Outlook) -> list[int]:
    """Partners whose maps should be newer, each at most once in ``period_keyframes``; at the end all."""
    config = state.config.merge
    if not config.enabled:
        return []
    if outlook.closing:
        return state.partners()
    ready = config.period_keyframes
    return [a for a in state.partners() if a in outlook.stale and outlook.since_bought.get(a, ready) >= ready]
