"""One robot's share of a distributed pose-graph optimisation: a state machine without I/O.

It holds its own poses and edges, and of its neighbours only the separator poses they send. The same code runs in one process, in
tests that lose or repeat messages, and over a network.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from backend.config import SolverConfig
from backend.distributed.messages import Message
from backend.geometry import Array
from backend.graph import Edge, NodeId, PoseGraph


@dataclass(frozen=True, eq=False)
class Share:
    """What one robot brings to its group.

    ``members``: all robots of the group, this one among them, the same for everyone; the lowest is the anchor: the result is in the
    frame of its poses. ``poses`` ``T_O_i`` ``(4, 4)`` of its own nodes, in any frame; ``edges``: those between its own nodes, and
    every edge it shares with another member (which that member must hold too). ``metric`` False: its unit of length is its own, and
    is found from the separator edges' ``scale``.
    """

    robot: int
    members: tuple[int, ...]
    poses: Mapping[NodeId, Array]
    edges: tuple[Edge, ...]
    metric: bool = True


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a node ends with; the same verdict, costs and sweep counts at every member.

    ``poses`` of its own nodes in the anchor's frame (the old ones where ``accepted`` is False); ``scale``: its unit in metres or in
    the anchor's unit (1 if metric); costs: sum over the group's edges of ``kappa |R_j - R_i R_ij|^2 + tau |t_j - t_i - R_i t_ij|^2``.
    """

    robot: int
    accepted: bool
    reason: str
    poses: dict[NodeId, Array]
    scale: float
    cost_before: float
    cost_after: float
    rotation_sweeps: int
    pose_sweeps: int


def shares(graph: PoseGraph, arbitrary_scale: frozenset[int] = frozenset()) -> dict[int, Share]:
    """Cut a whole graph into its robots' shares, all in one group."""
    raise NotImplementedError


class Node:
    """``start()`` once, then ``handle`` every message addressed to it, in any order; what these return is to be sent.

    ``outcome`` is None while it works. Messages that come twice or too early do no harm; a message that contradicts its graph
    raises :class:`BackendError`. ``tick`` sends again what neighbours may have missed.
    """

    def __init__(self, share: Share, config: SolverConfig) -> None:
        self.share = share
        self.config = config
        self.outcome: Outcome | None = None

    def start(self) -> list[Message]:
        raise NotImplementedError

    def handle(self, message: Message) -> list[Message]:
        raise NotImplementedError

    def tick(self) -> list[Message]:
        raise NotImplementedError
