"""Input and output of one robot in a distributed optimisation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import BackendError
from ..geometry import Array
from ..pose_graph.graph import Edge, NodeId, PoseGraph, Prior
from .held import HeldPriors


@dataclass(frozen=True, eq=False)
class Share:
    """Input of one robot to its group.

    ``members``: all robots of the group, this one among them. ``poses`` ``T_O_i`` ``(4, 4)`` of its own nodes, in any
    frame; ``units``: the size of each node's own unit of length there (1 where not named). ``edges``: those between its
    own nodes, and every edge it shares with another member, exactly as that member holds it. ``arbitrary_scale``: the
    members whose units are their own (monocular), one for each node, as they drift; the others' are 1 and stay.
    ``members`` and ``arbitrary_scale`` are the same for everyone. ``priors``: of its own nodes, in one frame for all
    members, whose place is found; ``positions``: whether any member has priors, the same for everyone; ``held``: priors
    whose frame has its place already, of every member or of none. ``length_sigma``: deviation of the factor by which
    all odometry of a metric member may be too long or too short, the same for everyone; 0: of none.
    ``heading_sigma``: of the rate at which it turns too much, rad/m about each axis, known with lengths only. The
    elected solver alone knows both. ``believed``: of each edge, whether an earlier run of robust selection believed it,
    none: it begins with all.

    The first node of the :attr:`anchor` keeps its pose and unit: the result is in the frame of its poses. Where priors
    are ``held`` no node is given: these say where all are.
    """

    robot: int
    members: tuple[int, ...]
    poses: Mapping[NodeId, Array]
    edges: tuple[Edge, ...]
    arbitrary_scale: frozenset[int] = frozenset()
    dimension: int = 3
    units: Mapping[NodeId, float] = field(default_factory=dict)
    priors: tuple[Prior, ...] = ()
    length_sigma: float = 0.0
    heading_sigma: float = 0.0
    positions: bool = False
    held: HeldPriors | None = None
    believed: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        for prior in self.priors:
            if prior.node not in self.poses:
                raise BackendError(f"robot {self.robot}: a prior on {prior.node}, which is no node of its own")
        if self.robot not in self.members or tuple(sorted(set(self.members))) != self.members:
            raise BackendError(f"robot {self.robot}: members must be sorted and contain it, got {self.members}")
        if not self.poses:
            raise BackendError(f"robot {self.robot} brings no poses")
        strangers = [n for n in self.poses if n.robot != self.robot]
        if strangers:
            raise BackendError(f"robot {self.robot} brings a pose of another robot: {strangers[0]}")
        for edge in self.edges:
            for node in (edge.i, edge.j):
                if node.robot == self.robot and node not in self.poses:
                    raise BackendError(
                        f"robot {self.robot}, edge {edge.i} - {edge.j}: there is no pose for node {node}"
                    )
                if node.robot not in self.members:
                    raise BackendError(
                        f"robot {self.robot}, edge {edge.i} - {edge.j}: robot {node.robot} is not in the group"
                    )
            if self.robot not in (edge.i.robot, edge.j.robot):
                raise BackendError(f"robot {self.robot} brings an edge of others: {edge.i} - {edge.j}")

    @property
    def anchor(self) -> int:
        """The member whose first node stays where it is."""
        return anchor_of(self.members, self.arbitrary_scale)

    @property
    def scaled(self) -> bool:
        """Whether nodes' units are variables."""
        return bool(self.arbitrary_scale)

    def log_units(self, nodes: Sequence[NodeId]) -> Array:
        """Logarithms ``(n,)`` of the units of own nodes."""
        return np.log(np.array([self.units.get(n, 1.0) for n in nodes], dtype=np.float64))

    @property
    def neighbours(self) -> list[int]:
        """Members that share an edge with this robot, sorted."""
        return sorted({n.robot for e in self.edges for n in (e.i, e.j)} - {self.robot})

    def separators_with(self, neighbour: int) -> tuple[list[NodeId], list[NodeId]]:
        """Own nodes with an edge to ``neighbour``, and its nodes with an edge to this robot, each sorted: the order
        of messages.
        """
        pairs = [(e.i, e.j) for e in self.edges if {e.i.robot, e.j.robot} == {self.robot, neighbour}]
        nodes = {n for pair in pairs for n in pair}
        return sorted(n for n in nodes if n.robot == self.robot), sorted(n for n in nodes if n.robot == neighbour)


@dataclass(frozen=True)
class JudgedEdge:
    """Outcome of robust selection for an edge, the same at both owners: ``weight`` 0 (rejected) to 1, ``residual`` in
    standard deviations (the square root of its share of F at the end)."""

    i: NodeId
    j: NodeId
    weight: float
    residual: float

    @property
    def rejected(self) -> bool:
        """Whether the edge was left out: weight below one half."""
        return self.weight < 0.5


@dataclass(frozen=True)
class UndecidedEdges:
    """The ``rejected`` edges, by their nodes, hold where ``robots`` are moved against the rest, and the ``kept`` ones
    break then: nothing in the group's graph tells which are wrong."""

    robots: tuple[int, ...]
    kept: tuple[tuple[NodeId, NodeId], ...]
    rejected: tuple[tuple[NodeId, NodeId], ...]


@dataclass(frozen=True, eq=False)
class SolverOutcome:
    """Result of a node; acceptance, reason and costs are the same at every member, as are sweep counts where all
    work in rounds.

    ``poses`` of its own nodes in the anchor's frame, and ``units``, the size of each one's own unit there (all 1 for
    metric robots); where ``accepted`` is False, or in ``unreached``, the old ones. Costs: F over the group's edges;
    with robust selection each judged edge counts up to its bound only.
    ``unreached``: own nodes that no chain of edges joins to the anchor. ``judged``: every edge of its share that robust
    selection weighed; a rejected one stays in the graph as it was and is judged afresh in the next run.
    ``positions``: whether priors of members had a say. ``length``: what its odometry's lengths were found to have to be
    multiplied by, ``turn``: by how much more it is to turn, rad/m about each axis. ``capped``: it ended because no more
    passes are allowed, or because they lead nowhere (methods multifrontal, two-level, rbcd). ``undecided``: what robust
    selection by an elected robot leaves open, known to that robot alone.
    """

    robot: int
    accepted: bool
    reason: str
    poses: dict[NodeId, Array] = field(repr=False)
    units: dict[NodeId, float] = field(repr=False)
    cost_before: float
    cost_after: float
    rotation_sweeps: int
    pose_sweeps: int
    unreached: tuple[NodeId, ...]
    judged: tuple[JudgedEdge, ...] = field(default=(), repr=False)
    positions: bool = False
    length: float = 1.0
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capped: bool = False
    undecided: tuple[UndecidedEdges, ...] = field(default=(), repr=False)


def anchor_of(members: Iterable[int], arbitrary_scale: frozenset[int]) -> int:
    """The lowest metric member, or the lowest where there is none: its first node's unit is the common one."""
    members = list(members)
    return min([m for m in members if m not in arbitrary_scale] or members)


def shares(
    graph: PoseGraph,
    arbitrary_scale: frozenset[int] = frozenset(),
    length_sigma: float = 0.0,
    heading_sigma: float = 0.0,
) -> dict[int, Share]:
    """Cut a whole graph into its robots' shares, all in one group."""
    members = tuple(graph.robots)
    poses: dict[int, dict[NodeId, Array]] = {robot: {} for robot in members}
    edges: dict[int, list[Edge]] = {robot: [] for robot in members}
    priors: dict[int, list[Prior]] = {robot: [] for robot in members}
    for n in graph.nodes:
        poses[n.robot][n] = graph.poses[n]
    for e in graph.edges:
        for robot in {e.i.robot, e.j.robot}:
            edges[robot].append(e)
    for p in graph.priors:
        priors[p.node.robot].append(p)
    return {
        robot: Share(
            robot=robot,
            members=members,
            poses=poses[robot],
            edges=tuple(edges[robot]),
            arbitrary_scale=arbitrary_scale,
            dimension=graph.dimension,
            priors=tuple(priors[robot]),
            positions=bool(graph.priors),
            length_sigma=length_sigma,
            heading_sigma=heading_sigma,
        )
        for robot in members
    }
