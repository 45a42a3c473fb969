"""Updates: matches that come after an optimisation, among those whom it solved for, without a new one.

The agent that an optimisation has elected keeps the group's graph. At each tick an agent gives it the matches that it
has accepted since, with its odometry up to them; both of a match's agents must. The elected one corrects those whom it
matters to. Where that cannot go on, all members learn of it, their matches are pending again, and an optimisation is
called for (:mod:`maslam.backend.distributed.incremental.update_node`).
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from maslam.backend.distributed.elected import ElectedNode
from maslam.backend.distributed.incremental.update_node import UpdateNode
from maslam.backend.distributed.share import SolverOutcome
from maslam.backend.distributed.update_messages import UpdateKind, UpdateMessage, stranger_to
from maslam.backend.errors import BackendError
from maslam.backend.pose_graph.graph import Edge, NodeId

from ..contracts.context import AgentContext
from ..contracts.effects import NOTHING, Effects, total
from ..protocol.ids import ContractId, MatchId
from ..protocol.solver_messages import SolverBody
from ..state.pose_graph import believable, match_edge, odometry_edges, take_over
from .session import OptimisationSession


@dataclass
class _SolvedGroup:
    """What the last optimisation has solved, and what was added to it: ``matches``, less those ``withdrawn``, and, by
    track, key-frames below ``known``. ``revision``, ``solved``: of the node, as the agent has them. ``sent_ns``,
    ``tries``: when messages were sent last, and how often again. ``reported``: why updates have ended."""

    identity: ContractId
    node: UpdateNode
    members: frozenset[int]
    matches: set[MatchId]
    known: dict[int, int]
    withdrawn: set[MatchId] = field(default_factory=set)
    revision: int = 0
    solved: int = 0
    sent_ns: int = 0
    tries: int = 0
    reported: str | None = field(default=None)


class GroupUpdates:
    """One agent's part in updates of its group. ``repeated``: how many messages were sent again."""

    def __init__(self, context: AgentContext) -> None:
        self.context = context
        self.repeated = 0
        self._group: _SolvedGroup | None = None

    @property
    def matches(self) -> frozenset[MatchId]:
        """Matches that the last optimisation and updates of it have taken in; none where updates cannot go on."""
        group = self._group
        return frozenset() if group is None or group.node.lost else frozenset(group.matches)

    @property
    def considered(self) -> frozenset[MatchId]:
        """These, and those that updates have withdrawn: no optimisation is needed for either."""
        return self.matches | self._group.withdrawn if self._group is not None and self.matches else frozenset()

    @property
    def settled(self) -> bool:
        """Whether the agent waits for nothing."""
        return self._group is None or self._group.node.settled

    def begin(self, session: OptimisationSession, outcome: SolverOutcome) -> Effects:
        """An optimisation was adopted: updates go on from it, if they can."""
        self._group, node, state = None, session.node, self.context.state
        if session.identity is None or type(node) is not ElectedNode or not state.config.optimisation.updates:
            return NOTHING
        try:
            solver = state.config.optimisation.solver
            updating = UpdateNode(node.share, outcome, node.settled, solver, careful=True)
        except BackendError as error:
            return self.context.event("no_updates", reason=str(error))
        task = session.task
        known = {track: state.members(track).start for track in task.tracks}
        for track in task.tracks:
            mine = [i for i in state.members(track) if NodeId(state.me, i) in node.share.poses]
            known[track] = max(mine) + 1
        self._group = _SolvedGroup(
            session.identity, updating, frozenset(task.members), set(task.matches), known, sent_ns=self.context.now_ns
        )
        return NOTHING

    def end(self, reason: str) -> Effects:
        """The group is to be solved anew."""
        return NOTHING if self._group is None else self._after(self._group, self._group.node.lose(reason))

    def pursue(self) -> Effects:
        """Take in the matches that were accepted since, and withdraw those that are not believed any more."""
        group, state = self._group, self.context.state
        if group is None or group.node.lost is not None:
            return NOTHING
        withdrawn = sorted(group.matches - state.accepted)
        new = [m for m in sorted(state.accepted - group.matches) if self._inside(group, m)]
        if not new and not withdrawn:
            return NOTHING
        group.matches = (group.matches - set(withdrawn)) | set(new)
        group.withdrawn = (group.withdrawn | set(withdrawn)) - set(new)
        edges, nodes = self._driven_since(group, new)
        edges += [match_edge(state.verified[m], state.config.optimisation) for m in new]
        poses = {n: state.poses[n.index] for n in nodes}
        units = {} if state.profile.metric else {n: state.units[n.index] for n in nodes}
        try:
            gone = [(NodeId(m.match_agent, m.match), NodeId(m.query_agent, m.query)) for m in withdrawn]
            return self._after(group, group.node.add(edges, poses, units, gone))
        except BackendError as error:
            return self.end(str(error))

    def _inside(self, group: _SolvedGroup, match: MatchId) -> bool:
        """Whether both agents of a match are members, and this one's key-frames on tracks that were solved for."""
        state = self.context.state
        mine = [i for a, i in ((match.match_agent, match.match), (match.query_agent, match.query)) if a == state.me]
        return group.members.issuperset(match.agents) and all(state.piece_of(i).track in group.known for i in mine)

    def _driven_since(self, group: _SolvedGroup, matches: Iterable[MatchId]) -> tuple[list[Edge], list[NodeId]]:
        """Odometry, and the key-frames that it leads to, up to those of these matches."""
        state = self.context.state
        edges: list[Edge] = []
        nodes: list[NodeId] = []
        ends = [(m.match_agent, m.match) for m in matches] + [(m.query_agent, m.query) for m in matches]
        for track in sorted(group.known):
            upto = max([i for a, i in ends if a == state.me and i in state.members(track)], default=-1) + 1
            if upto <= group.known[track]:
                continue
            nodes += [NodeId(state.me, i) for i in range(group.known[track], upto)]
            edges += [e for e in odometry_edges(state, track) if group.known[track] <= e.j.index < upto]
            group.known[track] = upto
        return edges, nodes

    def handle(self, identity: ContractId | None, message: UpdateMessage) -> Effects:
        """A message of another member."""
        group = self._group
        if group is None or group.identity != identity:
            return self._send(identity, stranger_to(message))
        try:
            return self._after(group, group.node.handle(message))
        except BackendError as error:
            return self.context.refuse(message.sender, f"update of agent {message.sender}: {error}")

    def resend(self) -> Effects:
        """Send again what others have not received, if answers take longer than they should."""
        group, rtt = self._group, self.context.retransmitter.rtt
        if group is None or group.node.settled:
            return NOTHING
        others = group.members - {self.context.me}
        wait_ns = max((rtt.wait_ns(member, group.tries) for member in others), default=0)
        if self.context.now_ns - group.sent_ns < wait_ns:
            return NOTHING
        tries = group.tries + 1
        messages = group.node.tick()
        self.repeated += len(messages)
        effects = self._after(group, messages)
        group.tries = tries
        return effects

    def _after(self, group: _SolvedGroup, messages: list[UpdateMessage]) -> Effects:
        """Send messages, and take over what the node has found."""
        group.sent_ns, group.tries = self.context.now_ns, 0
        node, state = group.node, self.context.state
        moved = node.revision != group.revision
        if moved and not believable(node.poses.values(), np.exp(np.clip([*node.log_units.values()], -99, 99))):
            group.revision = node.revision
            return self._after(group, node.lose("the solution is not finite"))
        effects = self._send(group.identity, messages)
        if node.lost is not None and group.reported is None:
            group.reported = node.lost
            effects += self.context.event("updates_ended", reason=node.lost)
        if moved:
            group.revision = node.revision
            taken = take_over(state, group.known, node.poses, node.log_units)
            effects += Effects(changes=(taken,))
        if node.solved != group.solved and node.lost is None:
            group.solved = node.solved
            corrected = [m.receiver for m in messages if m.kind is UpdateKind.CORRECTION]
            effects += self.context.event("updated", corrected=corrected, cost=node.cost, optimum=node.optimum)
        return effects

    def _send(self, identity: ContractId | None, messages: Iterable[UpdateMessage]) -> Effects:
        return total(self.context.tell(m.receiver, identity, SolverBody.of(m)) for m in messages)
