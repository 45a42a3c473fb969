"""All nodes of a group in one process, every message encoded, counted, and decoded again."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from backend.config import SolverConfig
from backend.distributed.elected_messages import ElectedMessage
from backend.distributed.messages import Deltas, Message, Stage, State, Values, decode, encode
from backend.distributed.methods import node_for
from backend.distributed.share import Outcome, Share, shares
from backend.errors import BackendError
from backend.graph import PoseGraph

# Ticks of a group that works without rounds, for each version a robot may make, before it counts as stuck.
_MOST_TICKS = 20


@dataclass(frozen=True)
class Traffic:
    """``payload_bytes``: rotations and poses of separators as they were sent: 8 bytes a number in the two-stage sweeps
    (as published tables count, which leave the exchange of starting poses out), all separators that block descent
    sends, of which most numbers take one byte; all that an elected robot gathers and sends back. ``wire_bytes``: all.
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
    nodes = {robot: node_for(group[robot], config) for robot in sorted(group)}
    language = _language(config)
    queue: deque[bytes] = deque()
    count = payload = wire = ticks = 0

    def post(messages: Sequence[Any]) -> None:
        nonlocal count, payload, wire
        for message in messages:
            data = language.encode(message)
            queue.append(data)
            count, payload, wire = count + 1, payload + language.payload(message), wire + len(data)

    for node in nodes.values():
        post(node.start())
    while True:
        while queue:
            message = language.decode(queue.popleft())
            post(nodes[message.receiver].handle(message))
        if config.method != "rbcd-async" or all(node.outcome is not None for node in nodes.values()):
            break
        # Without rounds, time makes nodes work: all at once, the hardest case.
        ticks += 1
        if ticks > _MOST_TICKS * config.descent_sweeps:
            break
        for node in nodes.values():
            post(node.tick())
    outcomes = {robot: node.outcome for robot, node in nodes.items() if node.outcome is not None}
    if len(outcomes) != len(nodes):
        stuck = sorted(set(nodes) - set(outcomes))
        raise BackendError(
            f"robots {stuck} wait for messages that nobody will send: the members' shares do not fit together"
        )
    return outcomes, Traffic(count, payload, wire)


@dataclass(frozen=True)
class _Language:
    """How the nodes of a method speak, and what of a message counts as payload."""

    encode: Callable[[Any], bytes]
    decode: Callable[[bytes], Any]
    payload: Callable[[Any], int]


def _language(config: SolverConfig) -> _Language:
    if config.method == "elected":
        return _Language(lambda m: m.encode(), ElectedMessage.decode, lambda m: m.payload_bytes)
    stages = set(Stage) if config.method.startswith("rbcd") else {Stage.ROTATION, Stage.POSE}

    def payload(message: Message) -> int:
        counted = isinstance(message, Values | Deltas | State) and message.round.stage in stages
        return message.payload_bytes if counted else 0

    return _Language(encode, decode, payload)


def optimise_distributed(
    graph: PoseGraph, config: SolverConfig, arbitrary_scale: frozenset[int] = frozenset()
) -> GroupResult:
    """A whole graph, cut into its robots' shares and solved by message alone."""
    outcomes, traffic = solve_group(shares(graph, arbitrary_scale), config)
    scales = {robot: outcome.scales[robot] for robot, outcome in outcomes.items()}
    poses = {node: T for outcome in outcomes.values() for node, T in outcome.poses.items()}
    return GroupResult(graph.rescaled(scales).with_poses(poses), outcomes, traffic)
