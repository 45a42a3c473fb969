"""Which node runs which method."""

from __future__ import annotations

from backend.config import SolverConfig
from backend.distributed.descent_node import DescentNode
from backend.distributed.node import Node
from backend.distributed.rounds import Rounds
from backend.distributed.share import Share


def node_for(share: Share, config: SolverConfig) -> Rounds:
    """One robot's part in the method that ``config`` names: start, handle, tick, outcome."""
    return DescentNode(share, config) if config.method == "rbcd" else Node(share, config)
