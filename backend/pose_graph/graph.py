"""Pose graphs of one or many robots: small values without a solver in them.

Conventions: ``T_i_j`` maps node j's frame to node i's; the graph's poses map a node's frame to one common origin
frame O, ``T_O_i``; information matrices are ``(6, 6)``, translation first, of ``log(T_measured^-1 @ T_estimated)``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

import numpy as np

from ..errors import BackendError
from ..geometry import Array, is_se3, se3_inverse
from .edge_arrays import EdgeArrays
from .landmarks import Landmark
from .node import NodeId


class EdgeKind(StrEnum):
    """Source of an edge: odometry, a loop closure of one robot, or a place match between two (a separator edge)."""

    ODOMETRY = "odometry"
    LOOP = "loop"
    SEPARATOR = "separator"


def _check(what: str, T: Array, information: Array, weight: float) -> None:
    if not is_se3(T):
        raise BackendError(f"{what}: the relative pose is not a rigid transform")
    if information.shape != (6, 6) or not np.isfinite(information).all():
        raise BackendError(f"{what}: the information must be 6x6 and finite")
    if not 0.0 <= weight <= 1.0:
        raise BackendError(f"{what}: weight {weight} is outside 0 to 1")


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured relative pose.

    ``T_i_j`` ``(4, 4)`` rigid; ``information`` ``(6, 6)``; ``scale``: size of j's unit of length in i's (1 unless a
    monocular robot takes part; ``T_i_j``'s translation is in i's unit); ``scale_sigma``: standard deviation of the log
    of ``scale``, None: that of the settings for its kind; ``weight`` in [0, 1] multiplies the information: the hook by
    which robust selection (GNC, switchable edges) turns an edge down without dropping it.
    """

    i: NodeId
    j: NodeId
    T_i_j: Array
    information: Array = field(default_factory=lambda: np.eye(6))
    kind: EdgeKind = EdgeKind.ODOMETRY
    scale: float = 1.0
    weight: float = 1.0
    scale_sigma: float | None = None

    def __post_init__(self) -> None:
        if self.i == self.j:
            raise BackendError(f"edge {self.i} - {self.j}: an edge joins two different nodes")
        _check(f"edge {self.i} - {self.j}", self.T_i_j, self.information, self.weight)
        if not (self.scale > 0 and np.isfinite(self.scale)):
            raise BackendError(f"edge {self.i} - {self.j}: scale {self.scale} is not positive")
        if self.scale_sigma is not None and not (self.scale_sigma > 0 and np.isfinite(self.scale_sigma)):
            raise BackendError(f"edge {self.i} - {self.j}: a scale's sigma of {self.scale_sigma} is not positive")

    @property
    def is_separator(self) -> bool:
        """Whether it joins two robots."""
        return self.i.robot != self.j.robot


@dataclass(frozen=True, eq=False)
class Prior:
    """A pose measured against the origin frame itself: an anchor, or GPS (whose information on rotation is 0).

    ``T_O_i`` ``(4, 4)`` rigid; ``information`` ``(6, 6)`` as an edge's; ``weight`` in [0, 1] multiplies it. ``lever``
    ``(3,)``: the point of the node's frame whose position was measured (an antenna), in the node's unit; ``bound``:
    standard deviations beyond which a residual counts less and less, None: never.
    """

    node: NodeId
    T_O_i: Array
    information: Array = field(default_factory=lambda: np.eye(6))
    weight: float = 1.0
    lever: Array = field(default_factory=lambda: np.zeros(3))
    bound: float | None = None

    def __post_init__(self) -> None:
        _check(f"prior on {self.node}", self.T_O_i, self.information, self.weight)
        if self.lever.shape != (3,) or not np.isfinite(self.lever).all():
            raise BackendError(f"prior on {self.node}: the lever must be 3 finite numbers")
        if self.bound is not None and not (self.bound > 0 and np.isfinite(self.bound)):
            raise BackendError(f"prior on {self.node}: a bound of {self.bound} standard deviations is not positive")


@dataclass(frozen=True, eq=False)
class PoseGraph:
    """Poses ``T_O_i`` ``(4, 4)`` by node, edges, and priors (which fix the frame O: without any it is free).
    ``dimension`` is 2 for planar data held in 3-D (z, roll, pitch zero). ``symbols``: robots are letters of gtsam's
    symbols in the file that this was read from, also where there is one robot only. ``landmarks``: kept along.
    ``fixed``: nodes that keep their poses in any solution.
    """

    poses: Mapping[NodeId, Array]
    edges: tuple[Edge, ...]
    dimension: int = 3
    priors: tuple[Prior, ...] = ()
    symbols: bool = False
    landmarks: tuple[Landmark, ...] = ()
    fixed: frozenset[NodeId] = frozenset()

    def __post_init__(self) -> None:
        for node in sorted(self.fixed - set(self.poses)):
            raise BackendError(f"there is no pose for the fixed node {node}")
        for edge in self.edges:
            for node in (edge.i, edge.j):
                if node not in self.poses:
                    raise BackendError(f"edge {edge.i} - {edge.j}: there is no pose for node {node}")
        for prior in self.priors:
            if prior.node not in self.poses:
                raise BackendError(f"prior on {prior.node}: there is no pose for this node")

    def __repr__(self) -> str:
        """The counts: all numbers of a graph fill pages of a notebook."""
        parts = (
            f"{len(self.robots)} robots, {len(self.poses)} poses, {len(self.edges)} edges, {len(self.priors)} priors"
        )
        return f"<PoseGraph: {parts}, {self.dimension}-D>"

    def arrays(self) -> EdgeArrays:
        """Edges and poses as arrays, nodes in sorted order."""
        nodes = self.nodes
        row = {n: k for k, n in enumerate(nodes)}
        poses = [self.poses[n] for n in nodes] + [np.eye(4)] * bool(self.priors)
        ends = [(row[e.i], row[e.j]) for e in self.edges] + [(len(nodes), row[p.node]) for p in self.priors]
        measurements: list[Edge | Prior] = [*self.edges, *self.priors]
        weight = np.array([e.weight for e in measurements], dtype=np.float64)
        information = np.array([e.information for e in measurements]).reshape(-1, 6, 6)
        return EdgeArrays(
            nodes=nodes,
            poses=np.array(poses).reshape(-1, 4, 4),
            ends=np.array(ends, dtype=np.intp).reshape(-1, 2),
            measured=np.array([e.T_i_j for e in self.edges] + [p.T_O_i for p in self.priors]).reshape(-1, 4, 4),
            information=weight[:, None, None] * information,
            weight=weight,
            origin=len(nodes) if self.priors else None,
            fixed=tuple(row[n] for n in sorted(self.fixed)),
        )

    @property
    def nodes(self) -> list[NodeId]:
        """All nodes, sorted."""
        return sorted(self.poses)

    @property
    def robots(self) -> list[int]:
        """All robots, sorted."""
        return sorted({node.robot for node in self.poses})

    def with_poses(self, poses: Mapping[NodeId, Array]) -> PoseGraph:
        """The same edges with ``poses`` put over the old ones; nodes not named keep theirs."""
        return replace(self, poses={**self.poses, **poses})

    def in_one_unit(self, poses: Mapping[NodeId, Array], units: Mapping[NodeId, float]) -> PoseGraph:
        """The graph with ``poses`` in the origin's unit and every edge's translation brought into it: ``units`` holds
        the size of each node's own unit there (1 where not named). An edge's ``scale`` becomes what is left of it.
        """
        edges = []
        for e in self.edges:
            u_i, u_j = units.get(e.i, 1.0), units.get(e.j, 1.0)
            stretched, information = _stretched(e.T_i_j, u_i), _of_longer_unit(e.information, u_i)
            edges.append(replace(e, T_i_j=stretched, information=information, scale=e.scale * u_i / u_j))
        # Their measurements are in the units of the poses that made them.
        landmarks = self.landmarks if all(unit == 1.0 for unit in units.values()) else ()
        return replace(self, poses={**self.poses, **poses}, edges=tuple(edges), landmarks=landmarks)

    def with_weights(self, weights: Iterable[float]) -> PoseGraph:
        """The same graph with one weight in [0, 1] an edge, in the order of ``edges``."""
        return replace(self, edges=tuple(replace(e, weight=float(w)) for e, w in zip(self.edges, weights, strict=True)))

    @property
    def is_unweighted(self) -> bool:
        """Whether every edge's information is the identity: nobody measured how good the edges are."""
        return all(np.array_equal(e.information, np.eye(6)) for e in self.edges)

    def with_unit_weights(self) -> PoseGraph:
        """The same graph with information that makes both isotropic weights 1: cost F is then twice cost U. So is the
        weight of a scale, unless nobody knows it."""
        rotation = 2.0 if self.dimension == 3 else 1.0
        information = np.diag([1.0, 1.0, 1.0, rotation, rotation, rotation])
        return replace(
            self,
            edges=tuple(
                replace(e, information=information, scale_sigma=max(e.scale_sigma or 1.0, 1.0)) for e in self.edges
            ),
            priors=tuple(replace(p, information=information) for p in self.priors),
        )

    def of_robot(self, robot: int) -> PoseGraph:
        """A robot's own poses and every edge it takes part in; the other ends' poses are kept too."""
        edges = tuple(e for e in self.edges if robot in (e.i.robot, e.j.robot))
        kept = {n for e in edges for n in (e.i, e.j)} | {n for n in self.poses if n.robot == robot}
        priors = tuple(p for p in self.priors if p.node.robot == robot)
        own = [n for n in self.poses if n.robot == robot] if self.landmarks else []
        seen = (mark.seen_by(own, self.poses) for mark in self.landmarks)
        landmarks = tuple(mark for mark in seen if mark is not None)
        poses = {n: self.poses[n] for n in sorted(kept)}
        fixed = frozenset(n for n in self.fixed if n.robot == robot)
        return replace(self, poses=poses, edges=edges, priors=priors, landmarks=landmarks, fixed=fixed)

    def partitioned(self, robots: int) -> PoseGraph:
        """A graph of one robot cut into ``robots`` blocks of consecutive nodes, equally long (the last may be
        shorter; where that would leave none for it, some are shorter by one).
        """
        nodes = self.nodes
        if len(self.robots) != 1 or not 1 <= robots <= len(nodes):
            raise BackendError(f"cannot cut {len(nodes)} poses of {len(self.robots)} robots into {robots} parts")
        size = -(-len(nodes) // robots)
        block = np.arange(len(nodes)) // size
        if block[-1] + 1 < robots:
            block = np.arange(len(nodes)) * robots // len(nodes)
        new = {n: NodeId(int(k), n.index) for n, k in zip(nodes, block, strict=True)}
        edges = []
        for e in self.edges:
            i, j = new[e.i], new[e.j]
            edges.append(replace(e, i=i, j=j, kind=EdgeKind.SEPARATOR if i.robot != j.robot else e.kind))
        priors = tuple(replace(p, node=new[p.node]) for p in self.priors)
        landmarks = tuple(mark.renamed(new) for mark in self.landmarks)
        poses = {new[n]: T for n, T in self.poses.items()}
        fixed = frozenset(new[n] for n in self.fixed)
        return replace(self, poses=poses, edges=tuple(edges), priors=priors, landmarks=landmarks, fixed=fixed)

    def rescaled(self, scales: Mapping[int, float]) -> PoseGraph:
        """Robots' units of length multiplied out: translations of robot r times ``scales[r]`` (1 where not named).

        An edge's own ``scale`` becomes what is left of it: 1 where it agreed with ``scales``.
        """
        poses = {n: _stretched(T, scales.get(n.robot, 1.0)) for n, T in self.poses.items()}
        edges = []
        for e in self.edges:
            s_i, s_j = scales.get(e.i.robot, 1.0), scales.get(e.j.robot, 1.0)
            stretched, information = _stretched(e.T_i_j, s_i), _of_longer_unit(e.information, s_i)
            edges.append(replace(e, T_i_j=stretched, information=information, scale=e.scale * s_i / s_j))
        priors = []
        for p in self.priors:
            s_p = scales.get(p.node.robot, 1.0)
            stretched, information = _stretched(p.T_O_i, s_p), _of_longer_unit(p.information, s_p)
            priors.append(replace(p, T_O_i=stretched, information=information))
        return replace(self, poses=poses, edges=tuple(edges), priors=tuple(priors))


def _of_longer_unit(information: Array, scale: float) -> Array:
    out = information.copy()
    out[:3] /= scale
    out[:, :3] /= scale
    return out


def _stretched(transform: Array, scale: float) -> Array:
    out = transform.copy()
    out[:3, 3] *= scale
    return out


def spread_poses(known: Mapping[NodeId, Array], edges: Iterable[Edge]) -> dict[NodeId, Array]:
    """``known`` poses and those that edges lead to from there, breadth first; odometry is followed before other edges.

    In each connected part without a known pose, its first node stands at the identity.
    """
    edges = list(edges)
    poses = dict(known)
    for kinds in ({EdgeKind.ODOMETRY}, set(EdgeKind)):
        links: dict[NodeId, list[tuple[NodeId, Array]]] = {}
        for e in edges:
            if e.kind in kinds:
                links.setdefault(e.i, []).append((e.j, e.T_i_j))
                links.setdefault(e.j, []).append((e.i, se3_inverse(e.T_i_j)))
        if not poses and edges:
            poses[min(min(e.i, e.j) for e in edges)] = np.eye(4)
        _walk(poses, links, sorted(poses))
    for node in sorted({n for e in edges for n in (e.i, e.j)}):
        if node not in poses:
            poses[node] = np.eye(4)
            _walk(poses, links, [node])
    return poses


def _walk(poses: dict[NodeId, Array], links: Mapping[NodeId, list[tuple[NodeId, Array]]], queue: list[NodeId]) -> None:
    for node in queue:  # grows while it is read: breadth first
        for other, T_node_other in links.get(node, []):
            if other not in poses:
                poses[other] = poses[node] @ T_node_other
                queue.append(other)
