"""Matches one by one: the first ones, which join the robots, in a whole solution, each later one as an update.

What each costs, in bytes and in logical time until all robots have what they will get, beside solving anew with it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ...config import LinkModel, SolverConfig
from ...errors import BackendError
from ...pose_graph.graph import Edge, NodeId, PoseGraph
from ...pose_graph.node import robot_name
from ..elected import ElectedNode
from ..elected_messages import ElectedMessage
from ..exchange import joined_robots
from ..share import SolverOutcome, shares
from ..update_messages import UpdateKind, UpdateMessage
from .timed_link import TimedLink
from .update_node import UpdateNode


@dataclass(frozen=True)
class SolveCost:
    """What a solution or an update took: ``bytes_sent``, of which ``payload_bytes`` are no headers, in ``messages``;
    ``seconds`` of logical time until the last robot had its answer; ``corrected``: robots that were sent one; ``cost``:
    F afterwards, and at best, as the elected robot has it."""

    bytes_sent: int
    payload_bytes: int
    messages: int
    seconds: float
    corrected: int
    cost: float
    optimum: float


@dataclass(frozen=True, eq=False)
class OneByOne:
    """``first``: of the whole solution at the start, the first in which robots' poses got better; ``updates``: of each
    match after it; ``anew``: of whole solutions with some of these matches, by their number; ``graph``: after the last,
    with ``units``."""

    graph: PoseGraph
    units: Mapping[NodeId, float]
    first: SolveCost
    updates: tuple[SolveCost, ...]
    anew: Mapping[int, SolveCost]


def in_order(graph: PoseGraph) -> tuple[list[Edge], list[Edge]]:
    """The matches that join robots which nothing joined before, and the others; both in the order of their later pose.

    Matches are edges between robots; loops of one robot's own are known to it from the start.
    """
    group = {robot: robot for robot in graph.robots}

    def root(robot: int) -> int:
        while group[robot] != robot:
            robot = group[robot]
        return robot

    between = [e for e in graph.edges if e.is_separator]
    between.sort(key=lambda e: (max(e.i.index, e.j.index), min(e.i.index, e.j.index), e.i, e.j))
    joining: list[Edge] = []
    later: list[Edge] = []
    for e in between:
        a, b = root(e.i.robot), root(e.j.robot)
        (later if a == b or e.weight <= 0 else joining).append(e)
        if e.weight > 0:
            group[max(a, b)] = min(a, b)
    return joining, later


def matches_one_by_one(
    graph: PoseGraph,
    config: SolverConfig,
    link: LinkModel,
    arbitrary_scale: frozenset[int] = frozenset(),
    tick: Callable[[int, int], None] = lambda done, total: None,
) -> OneByOne:
    """Run it on ``graph``, whose robots must all be joined; ``tick`` is called with what is done, and of
    how much."""
    if graph.priors:
        raise BackendError("matches one by one: updates know no priors (GPS); with them the group is solved at once")
    if len(graph.robots) == 1:
        raise BackendError("matches one by one: the graph has one robot, and no match between robots")
    groups = joined_robots(graph)
    if len(groups) > 1:
        apart = ", ".join(map(robot_name, sorted(groups[1])))
        whose = f"robot{'s'[len(groups[1]) == 1 :]} {apart}"
        raise BackendError(f"matches one by one: no edge joins {whose} to the others; give each group alone")
    joining, later = in_order(graph)
    within = [e for e in graph.edges if not e.is_separator]
    begun = 0
    nodes, first = _whole(replace(graph, edges=(*within, *joining)), config, link, arbitrary_scale)
    while not nodes and begun < len(later):
        # Where poses are odometry's, and nothing closes a loop, they cannot get better.
        begun += 1
        edges = (*within, *joining, *later[:begun])
        nodes, first = _whole(replace(graph, edges=edges), config, link, arbitrary_scale)
    if not nodes:
        raise BackendError("matches one by one: the poses are at their optimum, no match changes anything")
    updates: list[SolveCost] = []
    compared = chosen(len(later) - begun, link.solved_anew)
    total = len(later) - begun + len(compared)
    for match in later[begun:]:
        updates.append(_update(nodes, match, link))
        tick(len(updates), total)
    anew: dict[int, SolveCost] = {}
    for k in compared:
        present = replace(graph, edges=(*within, *joining, *later[: begun + k + 1]))
        anew[k] = _whole(present, config, link, arbitrary_scale)[1]
        tick(len(updates) + len(anew), total)
    poses = {n: T for node in nodes.values() for n, T in node.poses.items()}
    units = {n: float(np.exp(u)) for node in nodes.values() for n, u in node.log_units.items()}
    return OneByOne(graph.in_one_unit(poses, units), units, first, tuple(updates), anew)


def chosen(count: int, most: int) -> list[int]:
    """At most ``most`` of ``count`` matches, evenly spread, the last among them."""
    return sorted({round((k + 1) * count / min(most, count)) - 1 for k in range(min(most, count))})


def _whole(
    graph: PoseGraph, config: SolverConfig, link: LinkModel, arbitrary_scale: frozenset[int]
) -> tuple[dict[int, UpdateNode], SolveCost]:
    """Solve the whole group; its robots ready for updates."""
    given = shares(graph, arbitrary_scale)
    nodes = {robot: ElectedNode(share, config) for robot, share in given.items()}
    air = TimedLink(link.delay_s, link.rate_kbit)
    payload, now_s = 0, 0.0
    for node in nodes.values():
        for message in node.start():
            air.send(message.sender, message.encode(), now_s)
    while (arrival := air.next()) is not None:
        now_s = arrival.at_s
        received = ElectedMessage.decode(arrival.data)
        payload += received.payload_bytes
        for message in nodes[received.receiver].handle(received):
            air.send(message.sender, message.encode(), now_s)
    outcomes = {robot: node.outcome for robot, node in nodes.items()}
    ended: dict[int, SolverOutcome] = {robot: o for robot, o in outcomes.items() if o is not None}
    if len(ended) != len(nodes):
        raise BackendError("the members' shares do not fit together")
    some = ended[graph.robots[0]]
    cost = SolveCost(air.bytes_sent, payload, air.messages, now_s, len(nodes), some.cost_after, some.cost_after)
    ready = {r: UpdateNode(given[r], ended[r], nodes[r].settled, config) for r in nodes} if some.accepted else {}
    return ready, cost


def _update(nodes: Mapping[int, UpdateNode], match: Edge, link: LinkModel) -> SolveCost:
    """Give a match to the two robots that found it, and carry messages until all is done."""
    air, now_s, done_s = TimedLink(link.delay_s, link.rate_kbit), 0.0, 0.0
    corrected: set[int] = set()
    payload = 0

    def post(messages: Sequence[UpdateMessage]) -> None:
        for message in messages:
            air.send(message.sender, message.encode(), now_s)

    for robot in sorted({match.i.robot, match.j.robot}):
        post(nodes[robot].add([match]))
    while (arrival := air.next()) is not None:
        now_s = arrival.at_s
        received = UpdateMessage.decode(arrival.data)
        payload += received.payload_bytes
        post(nodes[received.receiver].handle(received))
        if received.kind is UpdateKind.CORRECTION:
            corrected.add(received.receiver)
        if received.kind is not UpdateKind.RECEIVED:
            done_s = now_s
    lost = next((node.lost for node in nodes.values() if node.lost is not None), None)
    if lost is not None:
        raise BackendError(f"an update with the match {match.i} - {match.j} failed: {lost}")
    elected = next(node for node in nodes.values() if node.leads)
    return SolveCost(air.bytes_sent, payload, air.messages, done_s, len(corrected), elected.cost, elected.optimum)
