"""An agent's memory of an optimisation: the tender before the award, the session after it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from maslam.backend.distributed.methods import SolverNode, node_for
from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.distributed.wire import SolverMessage
from maslam.backend.errors import BackendError

from ..config import LinkConfig
from ..contracts.contract import Contract
from ..contracts.operation import WorkError
from ..contracts.rtt import RttEstimator
from ..protocol.ids import ContractId, MatchId
from ..protocol.messages import Bid
from ..protocol.tasks import OptimiseTask
from ..state.agent_state import AgentState
from ..state.pose_graph import UnknownPart, share_of
from .solver_retransmission import SolverLink

_REMEMBERED = 16
# Messages of a member that are kept until the beginning.
_EARLY = 64


@dataclass
class OptimisationTender:
    """The manager's side until the award: who still has to answer, what was bid, who did not bid; alone: no
    contract. ``fresh``: matches that no optimisation has used yet."""

    identity: ContractId | None
    pending: set[int]
    bids: dict[int, Bid]
    missing: set[int] = field(default_factory=set)
    fresh: frozenset[MatchId] = frozenset()

    def complete_with(self, contractor: int) -> bool:
        """A contractor has answered, or never will; whether all have now."""
        self.pending.discard(contractor)
        if contractor not in self.bids:
            self.missing.add(contractor)
        return not self.pending


@dataclass(frozen=True)
class SolverReply:
    """To a solver message: what the node sends next, or what it sends ``again`` to a member that missed it."""

    messages: tuple[SolverMessage, ...] = ()
    again: tuple[SolverMessage, ...] = ()


@dataclass(frozen=True)
class SessionStart:
    """The node's first ``messages``, and those of other members that came ``early``: to be received now."""

    messages: tuple[SolverMessage, ...]
    early: tuple[SolverMessage, ...]


@dataclass
class OptimisationSession:
    """One optimisation this agent takes part in. ``unconfirmed``: members the manager waits for before it begins;
    ``link``: what the others may have missed; ``sent_bytes``, ``began_ns``: what it cost, for the next bid;
    ``elsewhere``: matches of the group that join other tracks, as far as the manager knows; ``agreed_ns``: when the
    contractor confirmed; ``received_ns``: when each member has sent something last."""

    identity: ContractId | None
    task: OptimiseTask
    node: SolverNode
    contract: Contract | None = None
    unconfirmed: set[int] = field(default_factory=set)
    elsewhere: frozenset[MatchId] = frozenset()
    begun: bool = False
    sent_bytes: int = 0
    began_ns: int = 0
    agreed_ns: int = 0
    link: SolverLink = field(default_factory=SolverLink)
    received_ns: dict[int, int] = field(default_factory=dict)
    _early: list[SolverMessage] = field(default_factory=list)

    def keep(self, message: SolverMessage) -> None:
        """A message came before the start; of each member a few are kept, who begins sends the rest again."""
        if sum(m.sender == message.sender for m in self._early) < _EARLY:
            self._early.append(message)

    def begin(self, now_ns: int) -> SessionStart:
        """Start the node."""
        self.begun, self.began_ns = True, now_ns
        out = tuple(self.node.start())
        self.link.goes_on(out, now_ns)
        return SessionStart(out, tuple(self._early))

    def receive(self, message: SolverMessage, now_ns: int, rtt: RttEstimator) -> SolverReply:
        """Hand a message to the node; :class:`~maslam.backend.errors.BackendError` where it makes no sense."""
        self.received_ns[message.sender] = now_ns
        try:
            with np.errstate(over="ignore", invalid="ignore"):  # what comes of it is judged, and refused
                out = self.node.handle(message)
        except (ArithmeticError, AssertionError, LookupError, TypeError, ValueError) as error:
            # Each number was in its bounds, and yet they lead nowhere: no message ends an agent.
            raise BackendError(f"what it sent leads nowhere: {type(error).__name__}: {error}") from error
        if message.asks:  # an answer is larger than the question, and brings this node no further
            return SolverReply(again=tuple(self.link.answered(message.sender, out, now_ns, rtt)))
        if out:
            self.link.goes_on(out, now_ns)
        return SolverReply(messages=tuple(out))

    def silent(self, now_ns: int, patience_ns: int) -> list[int]:
        """Members that share edges with this one and have sent nothing for longer than ``patience_ns``: those that are
        silent longest. An elected group goes on without silent members by itself."""
        if hasattr(self.node, "leader") or now_ns - self.began_ns <= patience_ns:
            return []
        since = {n: self.received_ns.get(n, -1) for n in self.node.share.neighbours}
        longest = min(since.values(), default=now_ns)
        return [n for n, at in sorted(since.items()) if at == longest] if now_ns - longest > patience_ns else []

    def late(self, message: SolverMessage, now_ns: int, rtt: RttEstimator) -> list[SolverMessage]:
        """Answer to another member that still works on what is over here. All it can lack is the last decision: nobody
        ends before all have reported. Decisions are not answered, or two that are done would exchange them for ever."""
        if message.sender not in self.task.members or message.decides:
            return []
        try:
            return [m for m in self.link.again(self.node, message, now_ns, rtt) if m.decides]
        except BackendError:  # of another method, or nonsense
            return []

    def figures(self, outcome: SolverOutcome) -> dict[str, Any]:
        """Of how it ended: for the event."""
        return {
            "members": list(self.task.members),
            "matches": len(self.task.matches),
            "sweeps": outcome.rotation_sweeps + outcome.pose_sweeps,
            "improved": outcome.accepted,
            "reason": outcome.reason,
            "cost_before": outcome.cost_before,
            "cost_after": outcome.cost_after,
        }


class SessionHistory(dict[ContractId, OptimisationSession | None]):
    """The last optimisations, None where this agent left before the end: to tell late messages from wrong ones, and to
    help who is still in one."""

    def remember(self, identity: ContractId | None, session: OptimisationSession | None) -> None:
        """Keep a session (None: it was left) under its contract; the oldest of too many is forgotten."""
        if identity is not None:
            self[identity] = session
            if len(self) > _REMEMBERED:
                del self[next(iter(self))]


class Backoff:
    """Number of failed optimisations, and the time to call for the next."""

    def __init__(self, config: LinkConfig, rtt: RttEstimator) -> None:
        self.config = config
        self._rtt = rtt
        self.failures = 0
        self.not_before_ns = 0

    def failed(self, now_ns: int, me: int) -> None:
        """It is tried again, later each time; not all who failed together try at the same time."""
        self.failures += 1
        least_ns = max(self.config.repeat_max_s * 1e9, float(self._rtt.slowest_ns))
        self.not_before_ns = now_ns + round(min(self.failures, 8) * least_ns * (1.0 + me % 8 / 4.0))

    def succeeded(self) -> None:
        """One came to its end."""
        self.failures = 0

    @property
    def hopeless(self) -> bool:
        """Whether it was tried so often in vain that there is no more waiting for it at the end."""
        return self.failures > 2 * (1 + self.config.retries)


def node_of(state: AgentState, task: OptimiseTask) -> SolverNode:
    """This agent's part, in the method that is set."""
    return node_for(share_of(state, task), state.config.optimisation.solver)


def checked_node(state: AgentState, contract: Contract, task: OptimiseTask) -> SolverNode:
    """The same of a task that a manager awards; :class:`WorkError` where this agent can take no part in it."""
    if state.me not in task.members or contract.manager not in task.members:
        raise WorkError("not an optimisation of this agent with the manager")
    if not state.profile.everyone.issuperset(task.members):
        raise WorkError("with an agent that there is not")
    try:
        return node_of(state, task)
    except (BackendError, UnknownPart) as error:
        raise WorkError(f"cannot take part: {error}") from error
