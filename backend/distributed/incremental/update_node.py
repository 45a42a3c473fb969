"""One robot's part in updates of a group that an elected robot has solved.

Whoever finds a match, or closes a loop, sends the new edges to the elected robot. That one still has the whole graph:
it solves it, and corrects the shared poses of as few robots as keep the cost at its optimum (up to a share). A
corrected robot places the rest of its poses by its own edges; all others receive nothing. Incremental in what is sent,
as iSAM2 (Kaess et al., 2012) is in what is computed.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

import numpy as np

from ...config import SolverConfig
from ...errors import BackendError
from ...geometry import Array
from ...pose_graph.graph import Edge, NodeId
from ..compact import CompactReader
from ..condense import Known, OwnGraph
from ..contribution import Between
from ..settled import Settled
from ..share import Share, SolverOutcome
from ..update_messages import UpdateKind, UpdateMessage, stranger_to
from .additions import between_of, decode_edges, decode_pairs, encode_edges, encode_pairs
from .belief import contradicts
from .corrections import chained, decode_correction
from .estimate import GroupEstimate
from .estimated_graph import Pair

_CHAIN = struct.Struct("<H")
_COST = struct.Struct("<f")
# Of a robot's messages of edges, or of its corrections; then the group is solved anew.
_MOST = 0xFFFF


class UpdateNode:
    """``add`` new edges, ``handle`` every message addressed to it, in any order; send what they return.

    ``lost`` is the reason why updates cannot go on, None as long as they do: then the group is solved anew; all learn
    of it. ``revision`` counts corrections of own poses, ``solved`` solutions as the elected robot. ``tick()`` sends
    again what was not received, and counts silence as the elected solver does.
    """

    def __init__(
        self, share: Share, outcome: SolverOutcome, settled: Settled, config: SolverConfig, careful: bool = False
    ) -> None:
        """``share``, ``outcome``, ``settled``: of the solution that updates go on from. ``careful``, the same for all:
        an edge between two robots counts once both have given it, and what other edges contradict ends updates."""
        if share.priors or outcome.positions:
            raise BackendError("updates know no priors (GPS): the group is solved anew for each match")
        if not outcome.accepted:
            raise BackendError(f"robot {share.robot} has no solution for updates to go on from: {outcome.reason}")
        self.lost: str | None = None
        self.revision = self.solved = 0
        self.optimum = self.cost = outcome.cost_after
        if outcome.length != 1.0 or any(outcome.turn):
            raise BackendError(
                "updates know no lengths or headings of odometry: the group is solved anew for each match"
            )
        if share.robot == settled.leader and set(settled.contributions) != set(share.members):
            raise BackendError("updates need all members, and some were left out")
        self._share = replace(share, poses=outcome.poses, units=outcome.units, length_sigma=0.0, heading_sigma=0.0)
        self._config, self._careful = config, careful
        self._own = OwnGraph(self._share)
        self._fineness = config.elected_fineness * self._own.exactness()
        self._leader = settled.leader
        self._epoch = zlib.crc32(struct.pack("<dd", outcome.cost_before, outcome.cost_after)) & 0xFFFF
        self._places = Known(dict(outcome.poses), self._logs(outcome.units))
        self._silent = 0
        # A member's: places it knows, whatever their age, the corrections it has had, and edges on their way.
        self._known = settled.places
        self._version, self._chain = 0, self._epoch
        self._unreceived: dict[int, UpdateMessage] = {}
        self._added = 0
        # The elected robot's: the group, and by robot what it has had and sent.
        self._group: GroupEstimate | None = None
        if share.robot == settled.leader:
            self._group = GroupEstimate(share, settled, careful)
        self._taken = dict.fromkeys(share.members, 0)
        self._corrected = dict.fromkeys(share.members, 0)
        self._chains = dict.fromkeys(share.members, self._epoch)
        self._underway: dict[int, UpdateMessage] = {}
        self._late = False

    @property
    def poses(self) -> dict[NodeId, Array]:
        """Own poses ``T_O_i`` as they are now."""
        return dict(self._places.poses)

    @property
    def log_units(self) -> dict[NodeId, float]:
        """Logarithms of own poses' units as they are now."""
        return dict(self._places.log_units)

    @property
    def leads(self) -> bool:
        """Whether this is the elected robot."""
        return self._group is not None

    @property
    def settled(self) -> bool:
        """Whether this robot waits for nothing."""
        waits = self._group is not None and self.lost is None and self._group.graph.waits
        return not (self._unreceived or self._underway or self._late or waits)

    def add(
        self,
        edges: Iterable[Edge],
        poses: Mapping[NodeId, Array] | None = None,
        units: Mapping[NodeId, float] | None = None,
        withdrawn: Collection[Pair] = (),
    ) -> list[UpdateMessage]:
        """Take new edges in: own ones, and those with other members, which these have as well.

        ``poses``, ``units``: of own nodes that are new, in this robot's present frame. An edge between two members is
        sent by the lower one, and never to an elected robot that has it. ``withdrawn``: earlier ones, by their nodes,
        that this robot does not believe any more (of careful nodes).
        """
        given, me, new = tuple(edges), self._share.robot, dict(poses or {})
        self._share = replace(
            self._share,
            poses={**self._places.poses, **new},
            units={**{n: float(np.exp(u)) for n, u in self._places.log_units.items()}, **(units or {})},
            edges=(*(e for e in self._share.edges if (e.i, e.j) not in withdrawn), *given),
        )
        self._own = OwnGraph(self._share)
        self._places = self._places.also(Known(new, {**dict.fromkeys(new, 0.0), **self._logs(units or {})}))
        used = [e for e in given if e.weight > 0]
        mine = [e for e in used if self._answers_for(e)]
        named = [(e.i, e.j) for e in used if not self._answers_for(e)] if self._careful else []
        if self.lost is not None or not (mine or named or withdrawn):
            return []
        between = between_of(mine, self._share.dimension)
        if self._group is not None:
            return self._take(between, me, named, withdrawn)
        self._added += 1
        if self._added > _MOST:
            return self._lose("more updates than are counted")
        body = encode_edges(between, self._fineness, self._share.scaled) if mine else b""
        body = encode_pairs(named, sorted(withdrawn)) + body if self._careful else body
        message = self._to(self._leader, UpdateKind.EDGES, self._added, body)
        self._unreceived[self._added] = message
        return [message]

    def handle(self, message: UpdateMessage) -> list[UpdateMessage]:
        """Receive a message; returns the messages to send because of it."""
        me, sender = self._share.robot, message.sender
        if message.receiver != me or sender not in self._share.members or sender == me:
            raise BackendError(f"robot {me} was handed an update from {sender} for {message.receiver}")
        leads = self._group is not None
        if not leads and sender != self._leader:
            raise BackendError(f"robot {me} was handed an update from {sender}, which is not elected")
        if message.epoch != self._epoch:  # of an older solution, or one that this robot has not taken part in
            return stranger_to(message)
        if message.kind is UpdateKind.LOST:
            more = [] if self.lost else self._lose(f"robot {sender} no longer has what updates go on from", sender)
            return [self._to(sender, UpdateKind.RECEIVED, 0), *more]
        self._silent = 0
        if message.kind is UpdateKind.RECEIVED:
            return self._received(message)
        if self.lost is not None:
            return [self._to(sender, UpdateKind.LOST, 0)]
        if leads:
            return self._take_edges(message) if message.kind is UpdateKind.EDGES else []
        return self._take_correction(message) if message.kind is UpdateKind.CORRECTION else []

    def tick(self) -> list[UpdateMessage]:
        """Send again what was not received; out of patience, give up."""
        waiting = [*self._unreceived.values(), *self._underway.values()]
        if self.settled:
            return []
        self._silent += 1
        if self._silent <= 2 * self._config.elected_patience:
            return [*waiting, *(self._correct() if self._late else [])]
        if self.lost is not None:
            self._underway = {}
            return []
        silent = f"robot {waiting[0].receiver} does not answer" if waiting else ""
        return self._lose(silent or "poses that a match names do not come")

    def lose(self, reason: str) -> list[UpdateMessage]:
        """Give up for a reason of this robot's own: the messages by which the others learn of it."""
        return [] if self.lost is not None else self._lose(reason)

    def _answers_for(self, edge: Edge) -> bool:
        """Whether this robot, and not the edge's other one, tells the elected robot of it."""
        me, leads = self._share.robot, self._group is not None
        other = edge.j.robot if edge.i.robot == me else edge.i.robot
        return other == me or leads or (other != self._leader and me < other)

    def _take_edges(self, message: UpdateMessage) -> list[UpdateMessage]:
        sender, serial = message.sender, message.serial
        if serial > self._taken[sender] + 1:
            return []  # One before it is on its way still, or will be sent again.
        out = [self._to(sender, UpdateKind.RECEIVED, serial)]
        if serial <= self._taken[sender]:
            return out
        named, withdrawn, edges = decode_pairs(message.body) if self._careful else ((), (), message.body)
        between = decode_edges(edges, self._share.scaled) if edges else between_of((), self._share.dimension)
        self._taken[sender] = serial
        corrections = self._take(between, sender, named, withdrawn)
        return corrections if self.lost is not None else [*out, *corrections]

    def _take(
        self, between: Between, sender: int, named: Iterable[Pair] = (), withdrawn: Collection[Pair] = ()
    ) -> list[UpdateMessage]:
        """As the elected robot: what new edges change."""
        assert self._group is not None
        try:
            fewer = bool(withdrawn) and self._group.graph.withdraw(withdrawn, sender)
            more = self._group.graph.add(between, sender, named)
        except BackendError as error:
            return self._lose(str(error))
        return self._correct() if fewer or more or self._late else []

    def _lose(self, reason: str, known_by: int | None = None) -> list[UpdateMessage]:
        """Give up, and send all others who need to know a message until they have received it."""
        self.lost, self._silent, self._late = reason, 0, False
        me, self._unreceived = self._share.robot, {}
        others = self._share.members if self._group is not None else (self._leader,)
        self._underway = {r: self._to(r, UpdateKind.LOST, 0) for r in others if r not in (me, known_by)}
        return list(self._underway.values())

    def _correct(self) -> list[UpdateMessage]:
        """As the elected robot: corrections to those for whom it matters, except who has not received its last one."""
        assert self._group is not None
        try:
            found = self._group.corrected(self._config.update_tolerance, frozenset(self._underway))
        except BackendError as error:
            return self._lose(str(error))
        self.solved += 1
        self.optimum, self.cost, self._late = found.optimum, found.cost, bool(found.late)
        if found.moved:
            self.revision += 1
            self._places = self._places.also(self._group.graph.place(sorted(self._places.poses)))
        out = []
        for c in found.corrections:
            self._corrected[c.robot] += 1
            if self._corrected[c.robot] > _MOST:
                return self._lose("more updates than are counted")
            cost = _COST.pack(c.cost) if self._careful else b""
            body = _CHAIN.pack(self._chains[c.robot]) + cost + c.body
            self._chains[c.robot] = chained(self._chains[c.robot], body)
            message = self._to(c.robot, UpdateKind.CORRECTION, self._corrected[c.robot], body)
            self._underway[c.robot] = message
            out.append(message)
        return out

    def _received(self, message: UpdateMessage) -> list[UpdateMessage]:
        if self._group is None:
            self._unreceived.pop(message.serial, None)
            if self.lost is not None:
                self._underway = {}
            return []
        on_its_way = self._underway.get(message.sender)
        if on_its_way is None or on_its_way.serial != message.serial:
            return []
        del self._underway[message.sender]
        return self._correct() if self._late and not self._underway else []

    def _take_correction(self, message: UpdateMessage) -> list[UpdateMessage]:
        received = self._to(message.sender, UpdateKind.RECEIVED, message.serial)
        if message.serial <= self._version:
            return [received]
        if message.serial != self._version + 1 or message.body[:2] != _CHAIN.pack(self._chain):
            return self._lose("corrections of this robot do not fit what it has")
        me, body, expected = self._share.robot, message.body[_CHAIN.size :], None
        if self._careful:
            expected, body = CompactReader(body).rough(), body[_COST.size :]
        read = decode_correction(body, me, self._known, self._share.scaled)
        strangers = [n for n in read.poses if n not in self._own.row]
        if strangers:
            raise BackendError(f"a correction of {strangers[0]}, which robot {me} does not have")
        held = read.also(self._own.known(self._own.nodes[:1])) if me == self._share.anchor else read
        poses, log_units, _ = self._own.completed(held)
        if self._careful:
            # The elected robot does not know what is on its way to it, and a condensed graph costs something else.
            known = not self._unreceived and self._config.elected_longest == 1
            before, after = self._own.costs(self._places), self._own.edges.costs(poses, log_units)
            off = 0.5 * (7 if self._share.scaled else 6) ** 0.5 / self._fineness
            contradiction = contradicts(before, after, expected if known else None, off)
            if contradiction:
                return self._lose(contradiction)
        self._version, self._chain = message.serial, chained(self._chain, message.body)
        self._known = self._known.also(read)
        self.revision += 1
        nodes = self._own.nodes
        self._places = Known(dict(zip(nodes, poses, strict=True)), dict(zip(nodes, log_units.tolist(), strict=True)))
        return [received]

    def _to(self, receiver: int, kind: UpdateKind, serial: int, body: bytes = b"") -> UpdateMessage:
        return UpdateMessage(kind, self._epoch, serial, self._share.robot, receiver, body)

    def _logs(self, units: Mapping[NodeId, float]) -> dict[NodeId, float]:
        nodes = sorted(units)
        return dict(zip(nodes, self._share.log_units(nodes).tolist(), strict=True))
