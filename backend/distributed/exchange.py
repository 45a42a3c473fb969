"""All nodes of a group in one process, every message encoded, counted, and decoded again."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..central.origin import OriginPriors, origin_of
from ..components import parts
from ..config import RobustConfig, SolverConfig
from ..errors import BackendError
from ..geometry import Array
from ..pose_graph.graph import EdgeKind, NodeId, PoseGraph
from ..robust.undecided import Undecided, undecided_edges
from .envelope import Envelope
from .messages import Coded, Decision, Deltas, NodeMessage, SeparatorState, Values
from .methods import node_for
from .share import JudgedEdge, Share, SolverOutcome, shares
from .solver_stage import SolverStage
from .wire import from_whole, whole
from .with_priors.in_run import InRun

# Ticks of a group that works without rounds, for each version a robot may make, before it counts as stuck.
_MOST_TICKS = 20


@dataclass(frozen=True)
class GroupTraffic:
    """``payload_bytes``: rotations and poses of separators as they were sent: 8 bytes per number in the two-stage
    sweeps (as published tables count, which leave the exchange of starting poses out); all separators that block
    descent sends, of which most numbers take one byte; all that an elected robot gathers and sends back.
    ``wire_bytes``: all. ``trace``: (payload bytes until then, the group's cost) whenever members learned of it: at the
    start, at the end, and after each sweep of block descent."""

    messages: int
    payload_bytes: int
    wire_bytes: int
    trace: tuple[tuple[int, float], ...] = ()

    def then(self, other: GroupTraffic) -> GroupTraffic:
        """This and another group's, which knows nothing of this one: their costs add up."""
        before = self.trace[-1][1] if self.trace else 0.0
        open_ = other.trace[0][1] if other.trace else 0.0
        trace = [(sent, cost + open_) for sent, cost in self.trace]
        trace += [(self.payload_bytes + sent, before + cost) for sent, cost in other.trace]
        return GroupTraffic(
            self.messages + other.messages,
            self.payload_bytes + other.payload_bytes,
            self.wire_bytes + other.wire_bytes,
            tuple(trace),
        )


@dataclass(frozen=True, eq=False)
class GroupResult:
    """Result of a group of nodes: ``graph`` in one unit of length, that of the anchor's first node, or the metre;
    ``units``: the size of each node's own unit there, 1 for metric robots; ``lengths``: what odometry of these robots
    was found to have to be multiplied by, ``turns`` ``(3,)``: by how much more it is to turn, rad/m about the axes of a
    step's end; none where they were not asked for or are right; ``confidence`` of robust
    selection, None: there was none."""

    graph: PoseGraph
    outcomes: Mapping[int, SolverOutcome]
    traffic: GroupTraffic
    units: Mapping[NodeId, float] = field(default_factory=dict)
    lengths: Mapping[int, float] = field(default_factory=dict)
    turns: Mapping[int, Array] = field(default_factory=dict)
    confidence: float | None = None

    @property
    def undecided(self) -> tuple[Undecided, ...]:
        """What selection leaves open, by rows of ``graph.edges``: rejected edges with as many behind them as the kept
        ones that they contradict. Found anew each time it is asked for; rigid graphs only."""
        if self.confidence is None:
            return ()
        weights = [0.0 if verdict is not None and verdict.rejected else 1.0 for verdict in self.judged]
        kept = self.graph.with_weights(np.array(weights))
        return undecided_edges(kept, RobustConfig(confidence=self.confidence))

    @property
    def judged(self) -> tuple[JudgedEdge | None, ...]:
        """Outcome of robust selection for each edge, in the order of ``graph.edges``, the same at both owners; None:
        not judged."""
        verdicts = {robot: iter(outcome.judged) for robot, outcome in self.outcomes.items()}
        out: list[JudgedEdge | None] = []
        for edge in self.graph.edges:
            verdict = None
            if edge.kind is not EdgeKind.ODOMETRY:
                for robot in {edge.i.robot, edge.j.robot}:
                    verdict = next(verdicts[robot], None)
            out.append(verdict)
        return tuple(out)


class _Post:
    """Messages in transit, as bytes, and the count of them."""

    def __init__(self, method: str) -> None:
        self.queue: deque[bytes] = deque()
        self._descends = method.startswith("rbcd")
        self._messages = self._payload = self._wire = 0
        self._trace: list[tuple[int, float]] = []

    def send(self, messages: Sequence[Any]) -> None:
        for message in messages:
            data = whole(message)
            self.queue.append(data)
            self._messages, self._wire = self._messages + 1, self._wire + len(data)
            inner = message.message if isinstance(message, InRun) else message
            if isinstance(inner, Envelope):
                self._payload += inner.payload_bytes
            else:
                self._count(inner)

    def next(self) -> Any:
        """The oldest message in transit."""
        return from_whole(self.queue.popleft())

    def _count(self, message: NodeMessage) -> None:
        stage = message.round.stage
        if isinstance(message, Values | Deltas | SeparatorState):
            if self._descends or stage in (SolverStage.ROTATION, SolverStage.POSE):
                self._payload += message.payload_bytes
        elif isinstance(message, Coded):
            self._payload += message.payload_bytes
        elif isinstance(message, Decision) and (
            stage in (SolverStage.START, SolverStage.COST) or (stage is SolverStage.DESCENT and message.round.step == 0)
        ):
            self._note(message.cost)

    def traffic(self) -> GroupTraffic:
        return GroupTraffic(self._messages, self._payload, self._wire, tuple(self._trace))

    def _note(self, cost: float) -> None:
        """The group's cost, which every member passes on."""
        if np.isfinite(cost) and (not self._trace or self._trace[-1][1] != cost):
            self._trace.append((self._payload, cost))


def solve_group(group: Mapping[int, Share], config: SolverConfig) -> tuple[dict[int, SolverOutcome], GroupTraffic]:
    """Run one node a share until all have ended; first sent, first delivered, so the same every time."""
    nodes = {robot: node_for(group[robot], config) for robot in sorted(group)}
    post, ticks = _Post(config.method), 0
    for node in nodes.values():
        post.send(node.start())
    while True:
        while post.queue:
            message = post.next()
            post.send(nodes[message.receiver].handle(message))
        # Without rounds, time makes nodes work: all at once, the hardest case.
        waiting = any(node.outcome is None for node in nodes.values())
        if not waiting or config.method != "rbcd-async" or ticks > _MOST_TICKS * config.descent_sweeps:
            break
        ticks += 1
        for node in nodes.values():
            post.send(node.tick())
    outcomes = {robot: node.outcome for robot, node in nodes.items() if node.outcome is not None}
    if len(outcomes) != len(nodes):
        stuck = sorted(set(nodes) - set(outcomes))
        raise BackendError(
            f"robots {stuck} wait for messages that nobody will send: the members' shares do not fit together"
        )
    return outcomes, post.traffic()


def optimise_distributed(
    graph: PoseGraph, config: SolverConfig, arbitrary_scale: frozenset[int] = frozenset()
) -> GroupResult:
    """Cut ``graph`` into its robots' shares and solve it by messages alone; robots that no edge joins are groups of
    their own, each in the frame of its own anchor. ``arbitrary_scale``: robots whose unit of length is their own."""
    outcomes: dict[int, SolverOutcome] = {}
    traffic = GroupTraffic(0, 0, 0)
    deviations = config.length_sigma, float(np.radians(config.heading_sigma_deg))
    for group in joined_robots(graph):
        inside = replace(
            graph,
            poses={n: T for n, T in graph.poses.items() if n.robot in group},
            edges=tuple(e for e in graph.edges if e.i.robot in group),
            priors=tuple(p for p in graph.priors if p.node.robot in group),
        )
        found, more = solve_group(shares(inside, arbitrary_scale & group, *deviations), config)
        outcomes |= found
        traffic = traffic.then(more)
    units = {node: unit for outcome in outcomes.values() for node, unit in outcome.units.items()}
    poses = {node: T for outcome in outcomes.values() for node, T in outcome.poses.items()}
    solved = graph.in_one_unit(poses, units)
    for group in joined_robots(graph) if graph.priors else []:
        if all(outcomes[robot].accepted for robot in group):
            solved = in_frame_of_priors(solved, units, outcomes, group, group <= arbitrary_scale)
    lengths = {robot: outcome.length for robot, outcome in outcomes.items() if outcome.length != 1.0}
    turns = {robot: np.array(outcome.turn) for robot, outcome in outcomes.items() if any(outcome.turn)}
    judges = config.robust != "none" and not arbitrary_scale
    return GroupResult(solved, outcomes, traffic, units, lengths, turns, config.gnc_confidence if judges else None)


def joined_robots(graph: PoseGraph) -> list[frozenset[int]]:
    """The groups of robots that edges join, by their lowest robot."""
    robots = graph.robots
    row = {robot: k for k, robot in enumerate(robots)}
    between = [(row[e.i.robot], row[e.j.robot]) for e in graph.edges if e.is_separator]
    label = parts(np.array(between, dtype=np.intp).reshape(-1, 2), len(robots))
    groups = [frozenset(r for r, k in zip(robots, label, strict=True) if k == one) for one in np.unique(label)]
    return sorted(groups, key=min)


def in_frame_of_priors(
    graph: PoseGraph,
    units: Mapping[NodeId, float],
    outcomes: Mapping[int, SolverOutcome],
    group: Set[int],
    free_unit: bool,
) -> PoseGraph:
    """A group of robots moved to where its priors fit best: robots keep the frame of their anchor, a reader of the
    whole graph wants that of the priors. Poses that were not reached stay, and groups without priors."""
    unreached = {n for robot in group for n in outcomes[robot].unreached}
    nodes = [n for n in graph.nodes if n.robot in group and n not in unreached]
    priors = [p for p in graph.priors if p.node.robot in group and p.node not in unreached]
    if not priors:
        return graph
    poses = np.array([graph.poses[n] for n in nodes])
    log_units = np.log([units.get(n, 1.0) for n in nodes])
    row = {n: k for k, n in enumerate(nodes)}
    origin, _ = origin_of(OriginPriors.of(priors, graph.dimension), row, poses, log_units, free_unit)
    moved = origin.inverse().transform_poses(poses)
    return graph.with_poses(dict(zip(nodes, moved, strict=True)))
