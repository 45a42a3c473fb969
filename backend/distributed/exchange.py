"""All nodes of a group in one process, every message encoded, counted, and decoded again."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from backend.config import SolverConfig
from backend.distributed.elected_exchange import solve_elected
from backend.distributed.messages import Message, Stage, Values, decode, encode
from backend.distributed.node import Node
from backend.distributed.share import Outcome, Share, shares
from backend.errors import BackendError
from backend.graph import PoseGraph


@dataclass(frozen=True)
class Traffic:
    """``payload_bytes``: rotations and poses of separators, 8 bytes a number, as published tables count;
    ``wire_bytes``: all of it.
    """

    messages: int
    payload_bytes: int
    wire_bytes: int


@dataclass(frozen=True, eq=False)
class GroupResult:
    """What a group of nodes ended with."""

    graph: PoseGraph
    outcomes: Mapping[int, Outcome]
    traffic: Traffic


def solve_group(group: Mapping[int, Share], config: SolverConfig) -> tuple[dict[int, Outcome], Traffic]:
    """Run one node a share until all have ended; first sent, first delivered, so the same every time."""
    if config.method == "elected":
        outcomes, counts = solve_elected(group, config)
        return outcomes, Traffic(*counts)
    nodes = {robot: Node(group[robot], config) for robot in sorted(group)}
    queue: deque[bytes] = deque()
    count = payload = wire = 0

    def post(messages: list[Message]) -> None:
        nonlocal count, payload, wire
        for message in messages:
            data = encode(message)
            queue.append(data)
            count, wire = count + 1, wire + len(data)
            if isinstance(message, Values) and message.round.stage in (Stage.ROTATION, Stage.POSE):
                payload += message.payload_bytes

    for node in nodes.values():
        post(node.start())
    while queue:
        message = decode(queue.popleft())
        post(nodes[message.receiver].handle(message))
    outcomes = {robot: node.outcome for robot, node in nodes.items() if node.outcome is not None}
    if len(outcomes) != len(nodes):
        stuck = sorted(set(nodes) - set(outcomes))
        raise BackendError(
            f"robots {stuck} wait for messages that nobody will send: the members' shares do not fit together"
        )
    return outcomes, Traffic(count, payload, wire)


def optimise_distributed(
    graph: PoseGraph, config: SolverConfig, arbitrary_scale: frozenset[int] = frozenset()
) -> GroupResult:
    """A whole graph, cut into its robots' shares and solved by message alone."""
    outcomes, traffic = solve_group(shares(graph, arbitrary_scale), config)
    scales = {robot: outcome.scales[robot] for robot, outcome in outcomes.items()}
    poses = {node: T for outcome in outcomes.values() for node, T in outcome.poses.items()}
    return GroupResult(graph.rescaled(scales).with_poses(poses), outcomes, traffic)
