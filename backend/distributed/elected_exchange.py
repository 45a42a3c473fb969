"""An elected group in one process, every message encoded, counted, and decoded again."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping

from backend.config import SolverConfig
from backend.distributed.elected import ElectedNode
from backend.distributed.elected_messages import ElectedMessage
from backend.distributed.share import Outcome, Share
from backend.errors import BackendError


def solve_elected(
    group: Mapping[int, Share], config: SolverConfig
) -> tuple[dict[int, Outcome], tuple[int, int, int]]:
    """Outcomes, and numbers of messages, of payload bytes (all but the headers) and of all bytes."""
    nodes = {robot: ElectedNode(group[robot], config) for robot in sorted(group)}
    queue = deque(m.encode() for node in nodes.values() for m in node.start())
    count = payload = wire = 0
    while queue:
        data = queue.popleft()
        message = ElectedMessage.decode(data)
        count, payload, wire = count + 1, payload + message.payload_bytes, wire + len(data)
        queue.extend(m.encode() for m in nodes[message.receiver].handle(message))
    outcomes = {robot: node.outcome for robot, node in nodes.items() if node.outcome is not None}
    if len(outcomes) != len(nodes):
        raise BackendError(f"robots {sorted(set(nodes) - set(outcomes))} wait for messages that nobody will send")
    return outcomes, (count, payload, wire)
