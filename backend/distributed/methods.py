"""Which node runs which method."""

from __future__ import annotations

from backend.config import SolverConfig
from backend.distributed.descent_node import DescentNode
from backend.distributed.elected import ElectedNode
from backend.distributed.free_node import FreeNode
from backend.distributed.node import Node
from backend.distributed.rounds import Rounds
from backend.distributed.share import Share
from backend.errors import BackendError


def node_for(share: Share, config: SolverConfig) -> Rounds | ElectedNode:
    """One robot's part in the method that ``config`` names: start, handle, tick, outcome."""
    if config.robust != "none" and config.method != "rbcd":
        raise BackendError(f"robust selection ({config.robust}) works with method rbcd, not {config.method}")
    match config.method:
        case "rbcd":
            return DescentNode(share, config)
        case "rbcd-async":
            return FreeNode(share, config)
        case "elected":
            return ElectedNode(share, config)
        case _:
            return Node(share, config)
